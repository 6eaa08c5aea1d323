"""What the actuators make of a command: how fast the wheel turns, how hard tyres are loaded, a brake that holds."""

from __future__ import annotations

import math

from pydantic import Field

from lanebound.integrity.core.config import Config

__all__ = ["HOLD", "ActuatorConfig", "Actuators"]

HOLD = "hold"  # in a command: the brake works, with so many m/s2 at most
STANDING_MPS, STANDING_MPS2 = 0.05, 0.05  # shown by the wheels and asked for, at which a car is to stand


class ActuatorConfig(Config):
    """Limits of steering, None leaves it free as in highway-env itself; and the brake of a standing car."""

    lateral_acceleration_mps2: float | None = Field(
        4.0, gt=0, description="largest v^2 / R that steering may ask for; dry road, passenger comfort ends earlier"
    )
    steering_rate_radps: float | None = Field(
        0.7,
        gt=0,
        description="rate of the road wheels; a driver's 500 deg/s at the wheel over a ratio of 13, rounded up",
    )
    hold_mps2: float | None = Field(
        4.0, gt=0, description="brake that holds a car whose wheels show standstill; what RSS takes as sure"
    )


class Actuators:
    """Steering with a limited rate and lateral acceleration, for a car with its centre half way between the axles.

    Where the wheels show standstill and no acceleration is asked for, the brake is put on (``HOLD`` in the command).
    """

    def __init__(self, config: ActuatorConfig, step_s: float, length_m: float) -> None:
        self.config, self.step_s, self.length_m = config, step_s, length_m
        self.steering_rad = 0.0

    def limit(self, action: dict[str, float], speed_mps: float) -> dict[str, float]:
        """The command as carried out at the speed that the wheels show; steering in radians."""
        c, steering = self.config, float(action["steering"])
        if c.lateral_acceleration_mps2 is not None:
            steering = _clip(steering, self._grip_rad(c.lateral_acceleration_mps2, speed_mps))
        if c.steering_rate_radps is not None:
            turn = _clip(steering - self.steering_rad, c.steering_rate_radps * self.step_s)
            steering = self.steering_rad + turn
        self.steering_rad = steering
        out = {**action, "steering": steering}
        standing = abs(speed_mps) < STANDING_MPS and abs(float(action["acceleration"])) < STANDING_MPS2
        if c.hold_mps2 is not None and standing:
            out[HOLD] = c.hold_mps2
        return out

    def _grip_rad(self, lateral_mps2: float, speed_mps: float) -> float:
        """Steering at which ``v^2 sin(beta) / (L / 2)`` reaches the limit, ``tan(steering) = 2 tan(beta)``."""
        sine = lateral_mps2 * 0.5 * self.length_m / max(speed_mps * speed_mps, 1e-9)
        return math.pi / 2 if sine >= 1.0 else math.atan(2.0 * math.tan(math.asin(sine)))


def _clip(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)
