"""Version 1 of the ids, in which to stop has a price; version 0 stays as it is.

Alert limits are of a budget, an alert permits the speed that follows from the level, a car that is slower than others
drive there blocks, and a body beyond its lane costs at rest as well. ``cost_limit`` is the 0.7 quantile of
``integrity_aware`` over the 20 training seeds from 1000 on, rounded up. The other ids have no version 1: in Racetrack
the car cannot slow down; elsewhere a car that stands or crawls would keep such a limit too often
(docs/results/degenerate-policies.md), or that was not measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from lanebound.envs.ids.highway import Highway, Merge
from lanebound.envs.ids.preset import Preset
from lanebound.envs.ids.streets import CarFollowing, LaneKeeping
from lanebound.integrity.core.presets import deep_merge

__all__ = ["PRICED", "VERSION_1"]

PRICED: dict[str, Any] = {
    "alert_limit": "budget",
    "cost": {"blocking": 1.0, "standing_speed_mps": 2.0, "alert_speed": "level"},
}
"""What all of them change; the figures are chosen. 2 m/s: a body that stands beyond its lane is exposed as one that
walks."""


def _priced(kind: type[Preset], cost_limit: float, **changes: Any) -> dict[str, Any]:
    """The configuration of an id with prices."""
    return deep_merge(deep_merge(kind.PRESET, PRICED), {"cost_limit": cost_limit, **changes})


class LaneKeepingV1(LaneKeeping):
    """LaneKeeping with a price of stopping."""

    ID: ClassVar[str | None] = "lanebound/LaneKeeping-v1"
    PRESET: ClassVar[Mapping[str, Any]] = _priced(LaneKeeping, 36.0)


class CarFollowingV1(CarFollowing):
    """CarFollowing with a price of stopping; behind the vehicle ahead a stop is right."""

    ID: ClassVar[str | None] = "lanebound/CarFollowing-v1"
    PRESET: ClassVar[Mapping[str, Any]] = _priced(CarFollowing, 42.0)


class HighwayV1(Highway):
    """Highway with a price of stopping, and two followers that react late."""

    ID: ClassVar[str | None] = "lanebound/Highway-v1"
    PRESET: ClassVar[Mapping[str, Any]] = _priced(Highway, 10.0, traffic={"behind": 2})


class MergeV1(Merge):
    """Merge with a price of stopping."""

    ID: ClassVar[str | None] = "lanebound/Merge-v1"
    PRESET: ClassVar[Mapping[str, Any]] = _priced(Merge, 4.0)


VERSION_1: tuple[type[Preset], ...] = (
    LaneKeepingV1,
    CarFollowingV1,
    HighwayV1,
    MergeV1,
)
