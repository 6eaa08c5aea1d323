"""Odometry of a four-wheeled vehicle: yaw rate, speed and slip at its reference point (S4 section II-C4).

S4's geometrical centre lies in the middle between the axles; here the reference point lies ``axle_m`` ahead of the rear
axle, which makes S4's formulas a case of ours. S4 turns to the left; here angles are positive to the right.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["CAR", "WheelOdometry", "from_front_wheel", "rolling_slip"]

SLOWEST_MPS = 1.0  # below, the slip follows from the geometry badly
CAR = record(
    wheelbase="front axle ahead of the rear axle [m]",
    track="distance between the wheels of an axle [m]",
    axle="reference point ahead of the rear axle [m]",
)


class WheelOdometry(NamedTuple):
    """Observed yaw rate [rad/s], speed [m/s] and slip [rad] of the reference point, and their 1-sigma."""

    rate: float
    speed: float
    slip: float
    sigma_rate: float
    sigma_speed: float
    sigma_slip: float


@jit
def from_front_wheel(car: Any, speed: float, angle: float, sigma_speed: float, sigma_angle: float) -> WheelOdometry:
    """S4 eq 3 and the formulas around it, from speed [m/s] and angle [rad] of the front left wheel.

    ``rate = v_fl sin(delta) / l``, ``tan(slip) = a / d`` with ``d = l / tan(delta) - b / 2``,
    ``v = v_fl cos(Delta + delta) / cos(Delta + slip)`` with ``tan(Delta) = (b / 2) / (l - a)``.
    """
    length, half, ahead, tangent = car.wheelbase, 0.5 * car.track, car.wheelbase - car.axle, math.tan(angle)
    slip = math.atan(car.axle * tangent / (length - half * tangent))
    diagonal = math.atan2(half, ahead)
    ratio = math.cos(diagonal + angle) / math.cos(diagonal + slip)
    of_angle = abs(speed) * math.cos(angle) / length
    return WheelOdometry(
        speed * math.sin(angle) / length, speed * ratio, slip,
        math.hypot(math.sin(angle) / length * sigma_speed, of_angle * sigma_angle),
        math.hypot(ratio * sigma_speed, speed * math.sin(angle - slip) * sigma_angle),
        sigma_angle * car.axle / length,
    )  # fmt: skip


@jit
def rolling_slip(axle: float, rate: float, speed: float) -> float:
    """Slip of the reference point where the rear axle does not slip: ``sin(slip) = a rate / v`` [rad].

    0 below 1 m/s. For vehicles without a steering sensor.
    """
    if abs(speed) < SLOWEST_MPS:
        return 0.0
    return math.asin(min(max(axle * rate / abs(speed), -0.7), 0.7))
