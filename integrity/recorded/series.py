"""Times of a recorded series, checked alike by all readers: rows that go back, and gaps.

A row that repeats another one, values and all, is left out and counted. So is a row whose time is not later than all
before it; where a tenth of the rows would be, the file is refused, because it is not sorted or one wrong time is far
ahead. A file whose clock was set back by more than a second is refused, unless the rows repeat times that are there
(files that were joined). A gap, or a jump of the clock, is an interval that is longer than the usual one by more than
half of it, but at least 0.15 s and at most 1 s.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import Stop

__all__ = ["UNTIMED", "Timing", "in_order", "notes", "require_degrees"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_BACK = 0.1  # share of rows that go back beyond which a file is refused
FEWEST_ANGLES, LOW_DEG = 20, 2.0  # elevations whose size shows a unit
SET_BACK_S, LEAST_ROWS = 1.0, 3
SHORTEST_GAP_S, LONGEST_USUAL_S, USUAL_SHARE = 0.15, 1.0, 0.5  # beyond the usual interval
MUCH_MISSING = 0.1  # share of rows; clocks of logs jitter by some percent


@dataclass(frozen=True)
class Timing:
    """What the times of a series show: number of rows, rows left out because their time is not later, or because they
    repeat another row, the start and end of each gap (G, 2) [s], and the share of rows missing in shorter holes."""

    name: str = ""
    rows: int = 0
    left_out: int = 0
    gaps_s: Array = field(default_factory=lambda: np.zeros((0, 2)))
    missing: float = 0.0
    repeated: int = 0

    @property
    def note(self) -> str:
        """What a user should know, "" for nothing."""
        again = f"{self.repeated} of {self.rows} rows left out that repeat another" * bool(self.repeated)
        late = f"{self.left_out} of {self.rows} rows left out that are not later than one before" * bool(self.left_out)
        count, longest = len(self.gaps_s), np.diff(self.gaps_s, axis=1).max(initial=0.0)
        gaps = f"{count} gap{'s' * (count > 1)}, the longest of {longest:.2f} s" * bool(count)
        holes = f"{100.0 * self.missing:.0f} % of its rows are missing in short holes" * (self.missing > MUCH_MISSING)
        return "; ".join(text for text in (again, late, gaps, holes) if text)

    def bridged(self, time_s: Array, before_s: float = 0.0, after_s: float = 0.0) -> Bools:
        """Whether times (T,) lie in a gap that is widened by ``before_s`` and ``after_s``."""
        near = (time_s > self.gaps_s[:, :1] - before_s) & (time_s < self.gaps_s[:, 1:] + after_s)
        return np.asarray(near.any(0))


UNTIMED = Timing()


def in_order(
    name: str | Path, time_s: Array, repeated: bool = False, rows: Array | None = None
) -> tuple[Bools, Timing]:
    """Rows (N,) to keep and what their times show; rows of the same time are kept if ``repeated``.

    Of equal ``rows`` (N, k), if they are given, the first is kept.

    Raises
    ------
    InputError
        More than a tenth of the rows are not later than one before, or a clock was set back.
    """
    if not time_s.size:
        return np.ones(0, np.bool_), Timing(str(name))
    if rows is not None and (np.diff(time_s) <= 0.0).any():
        first = np.zeros(time_s.size, np.bool_)
        first[np.unique(np.nan_to_num(rows), axis=0, return_index=True)[1]] = True
        keep, timing = in_order(name, time_s[first], repeated)
        first[first] = keep
        return first, replace(timing, rows=time_s.size, repeated=time_s.size - keep.size)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(time_s)[:-1]])
    keep = time_s >= before if repeated else time_s > before
    back = np.flatnonzero(~keep)
    alone = ~keep & (before - time_s > SET_BACK_S) & ~np.isin(time_s, time_s[keep])
    set_back = np.convolve(alone, np.ones(LEAST_ROWS), "same") >= LEAST_ROWS  # one stray time is no clock
    many = back.size > MOST_BACK * time_s.size
    if many or set_back.any():  # most would be lost, or later times are wrong
        k = int(back[0]) if many else int(np.argmax(set_back)) - LEAST_ROWS // 2
        by_s = before[k] - time_s[k]
        how = f"go back, row {k + 1} by {by_s:.3f} s" if by_s else f"repeat a time with other values, row {k + 1} first"
        raise InputError(
            f"{name} must have times that increase, {back.size} of {time_s.size} rows {how}: sort the rows by time, "
            "cut the file where its clock was set back, or write its times with more digits"
        )
    return keep, Timing(str(name), time_s.size, back.size, *_gaps(np.unique(time_s[keep])))


def _gaps(time_s: Array) -> tuple[Array, float]:
    """Start and end of the intervals (G, 2) that are too long between ascending times (N,), and the share of times
    that are missing in the others."""
    step = np.diff(time_s)
    usual = float(np.median(step)) if step.size else 0.0
    long = step - usual > min(max(USUAL_SHARE * usual, SHORTEST_GAP_S), LONGEST_USUAL_S)
    k, rest = np.flatnonzero(long), step[~long]
    missing = 1.0 - usual * rest.size / float(rest.sum()) if rest.size else 0.0
    return np.stack([time_s[k], time_s[k + 1]], -1), missing


def notes(*series: tuple[str, Stop | str | None, Timing]) -> dict[str, str]:
    """By name, what of a series was not used or is missing, for those of which something is."""
    texts = ((name, "; ".join(filter(None, (str(stop or ""), timing.note)))) for name, stop, timing in series)
    return {name: text for name, text in texts if text}


def require_degrees(what: str, angle_deg: Array, low_deg: float = LOW_DEG) -> None:
    """Raise InputError where all angles (N,) are small in degrees, as only radians are; by default elevations."""
    largest = float(np.abs(angle_deg).max(initial=0.0))
    if angle_deg.size >= FEWEST_ANGLES and largest <= low_deg:
        raise InputError(
            f"{what} must be in degrees, the largest of {angle_deg.size} is {largest:.2f}: are they in radians? "
            "Convert them"
        )
