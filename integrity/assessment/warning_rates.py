"""Rates of warnings against the truth, as S5 section 4.3 counts them, and what those rates hide.

With N points: false alarm rate FAR = f / N, missed detection rate MDR = m / N, OCDR = 1 - (FAR + MDR). All three are
shares of *all* points: where faults are rare, a monitor that never warns has an OCDR near 1. ``per_right`` and
``per_wrong`` are the shares of the points that are right or wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.bounding import clopper_pearson
from lanebound.integrity.core.errors import InputError

__all__ = ["PUBLISHED_COUNTS", "WarningCounts", "WarningSweep", "sweep_thresholds"]

Array = NDArray[np.float64]

PUBLISHED_COUNTS = {"urban": (14, 8, 1245), "rural": (10, 16, 3335), "mixed": (11, 19, 1105)}
"""False alarms, missed detections, points; S5 Tables 2 and 3."""


@dataclass(frozen=True)
class WarningCounts:
    """Points, of which ``wrong`` need a warning; ``false_alarms`` of the others have one, ``missed`` of them do not."""

    points: int
    wrong: int
    false_alarms: int
    missed: int

    def __post_init__(self) -> None:
        if min(self.missed, self.false_alarms) < 0 or self.false_alarms + self.missed > self.points:
            raise InputError(
                f"false_alarms and missed must be >= 0 and at most points = {self.points} together, got "
                f"{self.false_alarms} and {self.missed}: count each point once"
            )

    @classmethod
    def of(cls, warn: ArrayLike, wrong: ArrayLike, judged: ArrayLike = True) -> Self:
        """Counts of points (...,), of those that are ``judged``."""
        w, bad, take = np.broadcast_arrays(np.asarray(warn, bool), np.asarray(wrong, bool), np.asarray(judged, bool))
        return cls(int(take.sum()), int((bad & take).sum()), int((w & ~bad & take).sum()), int((~w & bad & take).sum()))

    def __add__(self, other: WarningCounts) -> WarningCounts:
        return WarningCounts(
            self.points + other.points, self.wrong + other.wrong, self.false_alarms + other.false_alarms,
            self.missed + other.missed,
        )  # fmt: skip

    @property
    def far(self) -> float | None:
        """False alarms over all points, S5 equation 16; None without points."""
        return self.false_alarms / self.points if self.points else None

    @property
    def mdr(self) -> float | None:
        """Missed detections over all points, S5 equation 17; None without points."""
        return self.missed / self.points if self.points else None

    @property
    def ocdr(self) -> float | None:
        """Overall correct detection rate, S5 equation 15; None without points."""
        return 1.0 - (self.false_alarms + self.missed) / self.points if self.points else None

    @property
    def per_right(self) -> float | None:
        """False alarms over the points that are right; None without one."""
        right = self.points - self.wrong
        return self.false_alarms / right if right > 0 else None

    @property
    def per_wrong(self) -> float | None:
        """Missed detections over the points that are wrong; None without one."""
        return self.missed / self.wrong if self.wrong > 0 else None

    def interval(self, events: int, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of ``events`` over all points: for independent points, which those of a drive are
        not; the spread over drives is wider."""
        return clopper_pearson(events, self.points, confidence) if self.points else (0.0, 1.0)


@dataclass(frozen=True)
class WarningSweep:
    """False alarms and missed detections of each threshold, S5 figure 8: arrays (T,) and the number of points."""

    threshold: Array
    false_alarms: NDArray[np.int64]
    missed: NDArray[np.int64]
    points: int

    def __add__(self, other: WarningSweep) -> WarningSweep:
        return WarningSweep(
            self.threshold, self.false_alarms + other.false_alarms, self.missed + other.missed,
            self.points + other.points,
        )  # fmt: skip

    def crossing(self) -> float | None:
        """Least threshold at which there are at least as many false alarms as missed detections; None without one.

        False alarms grow and missed detections fall with the threshold.
        """
        over = np.flatnonzero(self.false_alarms >= self.missed)
        return float(self.threshold[over[0]]) if over.size else None

    def best(self) -> tuple[float, float]:
        """The threshold of the largest OCDR, and that OCDR."""
        total = self.false_alarms + self.missed
        k = int(np.argmin(total))
        return float(self.threshold[k]), 1.0 - float(total[k]) / max(self.points, 1)


def sweep_thresholds(
    score: ArrayLike, wrong: ArrayLike, threshold: ArrayLike, judged: ArrayLike = True
) -> WarningSweep:
    """Counts when points with a score below each threshold (T,) are warned of."""
    s, bad, take = np.broadcast_arrays(np.asarray(score, float), np.asarray(wrong, bool), np.asarray(judged, bool))
    at = np.asarray(threshold, np.float64)
    right, fault = np.sort(s[take & ~bad]), np.sort(s[take & bad])
    warned, caught = (np.searchsorted(values, at, side="left") for values in (right, fault))
    return WarningSweep(at, warned.astype(np.int64), (fault.size - caught).astype(np.int64), int(take.sum()))
