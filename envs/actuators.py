"""Limits of the actuators: how fast the wheels turn, how hard tyres are loaded, a brake that holds.

The formulas are :func:`lanebound.envs.batch.ego_kernel.actuate`.
"""

from __future__ import annotations

from pydantic import Field

from lanebound.integrity.core.config import Config

__all__ = ["ActuatorConfig"]


class ActuatorConfig(Config):
    """Limits of steering, None leaves it free as in highway-env itself; and the brake of a standing car."""

    lateral_acceleration_mps2: float | None = Field(
        4.0, gt=0, description="largest v^2 / R that steering may command; dry road, passenger comfort ends earlier"
    )
    steering_rate_radps: float | None = Field(
        0.7,
        gt=0,
        description="rate of the road wheels; a driver's 500 deg/s at the wheel over a ratio of 13, rounded up",
    )
    hold_mps2: float | None = Field(
        4.0, gt=0, description="brake that holds a car whose wheels show standstill; what RSS takes as sure"
    )
