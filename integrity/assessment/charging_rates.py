"""Two applications that trust a matched link: road tolls, and pay-as-you-speed; with and without the monitor.

A toll is due once for each passage of a tolled link. A speed charge is due for each second above the limit of the link.
Charged is what the verdicts say: the matched link, the average Doppler speed; *guarded* charges only where the driver
is not warned. A wrong charge was not due; a missed one was due and not charged.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK, RoadMap

__all__ = ["ChargingConfig", "charging_counts", "passages", "toll_counts"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class ChargingConfig(Config):
    """What is charged."""

    every: int = Field(4, ge=1, description="every how many links is tolled, by identity [-]; chosen")
    least_points: int = Field(
        3, ge=1, description="points on a link, one after another, that make a passage [-]; chosen"
    )
    tolerance: float = Field(0.1, ge=0, description="share of the limit by which it may be exceeded [-]; chosen")
    least_mps: float = Field(1.0, ge=0, description="and speed by which it may be exceeded at least [m/s]; chosen")


def passages(link: Ints, seen: Bools, least_points: int) -> list[tuple[int, int, int]]:
    """Runs of one link among the points (T,) that are seen: link, first and last point; short runs are left out."""
    out: list[tuple[int, int, int]] = []
    at = np.flatnonzero(seen & (link != NO_LINK))
    for group in np.split(at, np.flatnonzero(np.diff(link[at]) != 0) + 1) if at.size else []:
        if group.size >= least_points:
            out.append((int(link[group[0]]), int(group[0]), int(group[-1])))
    return out


def toll_counts(
    config: ChargingConfig, link: Ints, charged_at: Bools, true_link: Ints, driving: Bools
) -> dict[str, int]:  # fmt: skip
    """Tolls due, charged, charged wrongly and missed.

    A charge is right if the vehicle passed that link while it was charged, and the first for that passage.
    """
    due = [p for p in passages(true_link, driving, config.least_points) if p[0] % config.every == 0]
    charged = [p for p in passages(link, driving & charged_at, config.least_points) if p[0] % config.every == 0]
    paid: set[int] = set()
    wrong = 0
    for name, first, last in charged:
        fits = [i for i, (own, a, b) in enumerate(due) if own == name and first <= b and last >= a and i not in paid]
        if fits:
            paid.add(fits[0])
        else:
            again = any(own == name and first <= b and last >= a for own, a, b in due)
            wrong += not again  # a passage that was cut in two is charged once
    return {"due": len(due), "charged": len(paid) + wrong, "wrong": wrong, "missed": len(due) - len(paid)}


def charging_counts(
    config: ChargingConfig,
    road_map: RoadMap,
    *,
    link: Ints,
    warn: Bools,
    speed_mps: Array,
    true_link: Ints,
    true_speed_mps: Array,
    driving: Bools,
) -> dict[str, Any]:
    """Tolls and speed charges of one drive of T points, plain and guarded by the warnings; links by identity."""
    limit = np.append(road_map.limit_mps, np.inf)
    row = np.full(int(road_map.identity.max()) + 2, road_map.links)
    row[road_map.identity] = np.arange(road_map.links)

    def over(name: Ints, speed: Array) -> Bools:
        allowed = limit[row[name]]
        return np.asarray(speed > allowed + np.maximum(config.tolerance * allowed, config.least_mps))

    due = over(true_link, true_speed_mps) & driving
    out: dict[str, Any] = {}
    for kind, charged_at in (("plain", np.ones_like(warn)), ("guarded", ~warn)):
        charged = over(link, speed_mps) & driving & charged_at
        out[kind] = {
            "toll": toll_counts(config, link, charged_at, true_link, driving),
            "speed": {
                "due": int(due.sum()), "charged": int(charged.sum()), "wrong": int((charged & ~due).sum()),
                "missed": int((due & ~charged).sum()),
            },
        }  # fmt: skip
    return out
