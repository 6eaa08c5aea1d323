"""Ids in which to stop has a price, beside those that they extend.

Alert limits are of a budget, an alert permits the speed that follows from the level, a car that is slower than others
drive there blocks, and a body beyond its lane costs at rest as well. ``cost_limit`` is for a mean, as learners compare
it: the mean cost of ``integrity_aware`` without crashes over 40 training seeds, and 1 % of a crash, rounded up
(docs/results/cost-limits.md); its mean with all crashes keeps it. The other ids have none: in Racetrack the
car cannot slow down; elsewhere a car that stands or crawls would keep such a limit too often
(docs/results/degenerate-policies.md), or that was not measured. A version -v1 would make Gymnasium call each -v0 out of
date.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.highway import Highway, Merge
from lanebound.envs.ids.preset import Preset
from lanebound.envs.ids.streets import CarFollowing, LaneKeeping
from lanebound.integrity.core.presets import deep_merge

__all__ = ["PRICED", "PRICES"]

PRICES: dict[str, Any] = {
    "alert_limit": "budget",
    "cost": {"blocking": 1.0, "standing_speed_mps": 2.0, "alert_speed": "level"},
}
"""What all of them change; the figures are chosen. 2 m/s: a body that stands beyond its lane is exposed as one that
walks."""


def _priced(kind: type[Preset], cost_limit: float, **changes: Any) -> dict[str, Any]:
    """The configuration of an id with prices."""
    return deep_merge(deep_merge(kind.PRESET, PRICES), {"cost_limit": cost_limit, **changes})


class LaneKeepingPriced(LaneKeeping):
    """LaneKeeping with a price of stopping."""

    PRESET: ClassVar[Mapping[str, Any]] = _priced(LaneKeeping, 30.0)


class CarFollowingPriced(CarFollowing):
    """CarFollowing with a price of stopping; behind the vehicle ahead a stop is right."""

    PRESET: ClassVar[Mapping[str, Any]] = _priced(CarFollowing, 40.0)


class HighwayPriced(Highway):
    """Highway with a price of stopping, and two followers that react late."""

    PRESET: ClassVar[Mapping[str, Any]] = _priced(Highway, 6.0, traffic={"behind": 2})


class MergePriced(Merge):
    """Merge with a price of stopping."""

    PRESET: ClassVar[Mapping[str, Any]] = _priced(Merge, 5.0)


PRICED: tuple[type[Preset], ...] = (
    LaneKeepingPriced,
    CarFollowingPriced,
    HighwayPriced,
    MergePriced,
)
