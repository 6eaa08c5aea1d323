"""Weights of the reward's terms, each of about 1 per second at its best.

The formulas are in :mod:`lanebound.envs.batch.score_kernel`.
"""

from __future__ import annotations

from pydantic import Field

from lanebound.envs.batch.records_kernel import TERMS
from lanebound.integrity.core.config import Config

__all__ = ["TERMS", "RewardConfig"]


class RewardConfig(Config):
    """Weights of the terms; costs are kept apart and never part of the reward."""

    progress: float = Field(1.0, ge=0, description="weight of progress along the lane [-]")
    lane_centre: float = Field(0.2, ge=0, description="weight of driving in the middle of the lane [-]")
    comfort: float = Field(0.1, ge=0, description="weight of gentle acceleration [-]")
    collision: float = Field(-5.0, le=0, description="of a crash, once [-]")
    base: float = Field(0.0, description="weight of the wrapped world's own reward [-]")
    toll: float = Field(1.0, ge=0, description="of each geo-object with a right claim; only Tolling has some [-]")
