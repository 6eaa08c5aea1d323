"""What driving well is worth: named terms, each of about 1 per second at its best, and their weighted sum."""

from __future__ import annotations

import math

from highway_env.vehicle.kinematics import Vehicle
from pydantic import Field

from lanebound.integrity.core.config import Config

__all__ = ["TERMS", "RewardConfig", "rewards_of", "total"]

TERMS = ("progress", "lane_centre", "comfort", "collision", "base")
CENTRE_SCALE_M = 0.5  # offset at which the credit for the middle of the lane is halved
COMFORT_MPS2 = 2.0  # ISO 2631-1: uncomfortable from 1.25 to 2.5 m/s2


class RewardConfig(Config):
    """Weights of the terms; costs are kept apart and never part of the reward."""

    progress: float = Field(1.0, ge=0, description="weight of progress along the lane [-]")
    lane_centre: float = Field(0.2, ge=0, description="weight of driving in the middle of the lane [-]")
    comfort: float = Field(0.1, ge=0, description="weight of gentle acceleration [-]")
    collision: float = Field(-5.0, le=0, description="of a crash, once [-]")
    base: float = Field(0.0, description="weight of the wrapped world's own reward [-]")


def rewards_of(
    vehicle: Vehicle, acceleration_mps2: float, lateral_mps2: float, crashed_now: bool, base: float, dt_s: float
) -> dict[str, float]:
    """The terms of one policy step of the true car.

    ``progress``  ``v cos(psi) / v_limit dt`` between -dt and dt: reversing takes back, speeding earns nothing.
    ``lane_centre``  ``1 / (1 + (d / 0.5 m)^2) * progress``: none for standing in the middle.
    ``comfort``  ``-min(1, (|a| / 2 m/s2)^2) dt``, a the acceleration along and across.
    ``collision``  1 in the step of a crash. ``base``  the wrapped world's own reward.
    """
    s, d = vehicle.lane.local_coordinates(vehicle.position)
    limit = float(vehicle.lane.speed_limit or vehicle.MAX_SPEED)
    along = float(vehicle.speed) * math.cos(vehicle.lane.local_angle(vehicle.heading, s)) / limit
    progress = min(max(along, -1.0), 1.0) * dt_s
    roughness = math.hypot(acceleration_mps2, lateral_mps2) / COMFORT_MPS2
    return {
        "progress": progress,
        "lane_centre": max(progress, 0.0) / (1.0 + (float(d) / CENTRE_SCALE_M) ** 2),
        "comfort": -min(roughness * roughness, 1.0) * dt_s,
        "collision": float(crashed_now),
        "base": base,
    }


def total(c: RewardConfig, terms: dict[str, float]) -> float:
    """The weighted sum of the terms."""
    return float(sum(getattr(c, name) * terms[name] for name in TERMS))
