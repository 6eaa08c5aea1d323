"""Alert limits of an environment: fixed ones, or what is left of a budget at each decision.

The formulas are in :mod:`lanebound.envs.batch.budget_kernel`.
"""

from __future__ import annotations

from enum import Enum
from typing import Self

from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError

__all__ = ["AlertLimit", "BudgetConfig"]


class AlertLimit(Enum):
    """Where alert limits come from."""

    FIXED = "fixed"
    BUDGET = "budget"


class BudgetConfig(Config):
    """Figures of the budget of alert limits."""

    tracking_m: float = Field(
        0.1,
        ge=0,
        description="how far the car's own control may leave the middle of the lane; 99 % of nominal in LaneKeeping",
    )
    bend_share: float = Field(
        0.25, ge=0, lt=1, description="share of the room across that an error along may take in bends [-]; chosen"
    )
    crossing_m: float = Field(1.5, gt=0, description="limit along where courses cross: half of a 3 m lane, S2 5.3")
    least_m: float = Field(0.29, gt=0, description="lower bound of both limits: of cars on local streets, Reid 2019")
    most_m: float = Field(
        10.0, gt=0, description="upper bound of both limits: as far as observations show; S5 has 15 m"
    )
    hold_s: float = Field(1.0, ge=0, description="an alert clears after levels have kept the limits so long; chosen")

    @model_validator(mode="after")
    def _bounds_ascend(self) -> Self:
        for name in ("most_m", "crossing_m"):
            if self.least_m > getattr(self, name):
                raise ConfigError(f"least_m must be <= {name} = {getattr(self, name)}, got {self.least_m}: lower it")
        return self
