"""Weights of the costs, the constraints of an agent, the figures of their formulas, and limits by group of causes.

The formulas are in :mod:`lanebound.envs.batch.costs_kernel`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.envs.batch.records_kernel import CAUSES
from lanebound.integrity.core.config import Config

__all__ = ["CAUSES", "GROUPS", "AlertSpeed", "CostConfig", "CostLimits"]

GROUPS: Mapping[str, tuple[str, ...]] = {
    "lane": ("cost_lane", "cost_lane_integrity"),
    "headway": ("cost_headway",),
    "conflict": ("cost_conflict",),
    "alert": ("cost_alert",),
    "hmi": ("cost_hmi",),
    "blocking": ("cost_blocking",),
    "guidance": ("cost_speeding", "cost_route", "cost_gore"),
    "overcharge": ("cost_overcharge",),
    "undercharge": ("cost_undercharge",),
}
"""Groups of causes whose weighted sum over an episode may have a limit of its own. A crash, an end off the road and the
warnings of the context monitor are in none: they count in the whole cost alone."""


class AlertSpeed(Enum):
    """Where the speed permitted under an alert comes from."""

    SHARE = "share"
    LEVEL = "level"
    ROADS = "roads"

    @property
    def is_shown(self) -> bool:
        """Whether the speed has an entry in the observation: it is not a share of the limit, which has one."""
        return self is not AlertSpeed.SHARE


class CostConfig(Config):
    """Weights of the causes and the figures of their formulas."""

    collision: float = Field(
        200.0, ge=0, description="weight of cost_collision [-]; more than any cost_limit, not than every careless drive"
    )
    off_road: float = Field(200.0, ge=0, description="weight of cost_off_road [-]; as a crash")
    lane: float = Field(1.0, ge=0, description="weight of cost_lane [1/m^2]")
    lane_integrity: float = Field(0.1, ge=0, description="weight of cost_lane_integrity [1/m^2]; a risk, no harm yet")
    headway: float = Field(0.5, ge=0, description="weight of cost_headway [1/s]")
    conflict: float = Field(
        10.0, ge=0, description="weight of cost_conflict [-]; as 10 m driven a metre beyond the lane, chosen"
    )
    alert: float = Field(0.5, ge=0, description="weight of cost_alert [1/s]")
    hmi: float = Field(5.0, ge=0, description="weight of cost_hmi [1/s]; what integrity is to prevent")
    context: float = Field(0.0, ge=0, description="weight of cost_context [1/s]; 0: a warning costs nothing")
    blocking: float = Field(0.0, ge=0, description="weight of cost_blocking [1/s]; 0: to stand costs nothing")
    speeding: float = Field(0.0, ge=0, description="weight of cost_speeding [1/s]; 0: highway-env has no such rule")
    route: float = Field(
        0.0, ge=0, description="weight of cost_route [-]; only worlds with a goal of a network have it"
    )
    gore: float = Field(0.0, ge=0, description="weight of cost_gore [1/s]; 0: to change late costs nothing")
    overcharge: float = Field(0.0, ge=0, description="weight of cost_overcharge [-]; only worlds with tolls have it")
    undercharge: float = Field(0.0, ge=0, description="weight of cost_undercharge [-]; likewise")
    gore_m: float = Field(
        50.0, gt=0, le=500, description="before and behind a fork, where a change of lanes is late; chosen"
    )
    blocking_share: float = Field(
        0.7,
        gt=0,
        le=1,
        description="share of the speed of the flow below which a car blocks without an alert [-]; chosen",
    )
    standing_speed_mps: float = Field(
        0.0, ge=0, le=40, description="speed that time beyond the lane counts for at least; 0: none at rest"
    )
    conflict_s: float = Field(
        1.5, gt=0, le=5, description="T2 below which a crossing is a conflict; Hyden 1987, FHWA-RD-03-050"
    )
    response_s: float = Field(0.5, gt=0, le=3, description="response time rho of the RSS distance; Shalev-Shwartz 2017")
    accelerate_mps2: float = Field(2.0, ge=0, description="acceleration during the response; RSS, comfort")
    brake_min_mps2: float = Field(4.0, gt=0, description="braking that the ego is sure to reach; RSS, IEEE 2846 survey")
    brake_max_mps2: float = Field(6.0, gt=0, description="braking of the leader at most; our leads brake 2.5 to 6")
    alert_speed: AlertSpeed = Field(
        AlertSpeed.SHARE,
        description="speed permitted under an alert: a share of the limit, or less as levels grow, or with a "
        "lane sensor the least limit of the roads that levels leave possible",
    )
    alert_speed_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of the lane's speed limit permitted while an alert is on [-]; of level, where PL = AL",
    )
    alert_speed_least: float = Field(
        0.25,
        ge=0,
        le=1,
        description="share of the limit that level always permits; a level lost between buildings stays so at rest",
    )
    time_to_alert_s: float = Field(
        1.0,
        ge=0,
        description="time allowed for a reaction to an alert [s]; chosen (the TTA of S3 II.A ends with the alert)",
    )

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each cause, by its name in ``info``, in the order of ``CAUSES``."""
        return {cause: getattr(self, cause.removeprefix("cost_")) for cause in CAUSES}

    def weights_of(self, group: str) -> NDArray[np.float64]:
        """What ``info["costs"]`` is multiplied by for the part of ``info["cost"]`` that a group is, (C,)."""
        return np.array([weight * (cause in GROUPS[group]) for cause, weight in self.weights.items()])

    def of_group(self, group: str, costs: Mapping[str, float]) -> float:
        """Weighted sum of the causes of a group; ``costs``: unweighted, by cause, those that lack are 0."""
        return float(sum(self.weights[cause] * costs.get(cause, 0.0) for cause in GROUPS[group]))


class CostLimits(Config):
    """Limits of an episode's weighted costs by group, each within ``cost_limit`` of the whole; not enforced."""

    lane: float | None = Field(None, ge=0, description="of cost_lane and cost_lane_integrity; None: none of its own")
    headway: float | None = Field(None, ge=0, description="of cost_headway; None: none of its own")
    conflict: float | None = Field(None, ge=0, description="of cost_conflict; None: none of its own")
    alert: float | None = Field(None, ge=0, description="of cost_alert; None: none of its own")
    hmi: float | None = Field(None, ge=0, description="of cost_hmi; None: none of its own")
    blocking: float | None = Field(None, ge=0, description="of cost_blocking; None: none of its own")
    guidance: float | None = Field(
        None, ge=0, description="of cost_speeding, cost_route and cost_gore; None: none of its own"
    )
    overcharge: float | None = Field(None, ge=0, description="of cost_overcharge; None: none of its own")
    undercharge: float | None = Field(None, ge=0, description="of cost_undercharge; None: none of its own")

    @property
    def given(self) -> dict[str, float]:
        """The limits that are set, by group, in the order of ``GROUPS``."""
        return {group: limit for group in GROUPS if (limit := getattr(self, group)) is not None}
