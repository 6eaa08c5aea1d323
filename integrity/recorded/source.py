"""What all readers of recordings share: lines of text files, scales of time, and checks of the times of a series.

A file may be compressed, truncated, very large or binary; it is read with bounded time and memory.

A row that repeats another one, values and all, is left out and counted. So is a row whose time is not later than all
before it; where a tenth of the rows would be, the file is refused, because it is not sorted or one wrong time is far
ahead. A file whose clock was set back by more than a second is refused, unless the rows repeat times that are there
(files that were joined). A gap, or a jump of the clock, is an interval that is longer than the usual one by more than
half of it, but at least 0.15 s and at most 1 s.
"""

from __future__ import annotations

import codecs
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.packed import open_unpacked

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MAX_BYTES = 256 * 2**20  # of uncompressed text; its arrays and the temporary lists need less than 1 GiB
MAX_LINE = 65_536  # bytes; the longest line of the formats has some thousands


@dataclass(frozen=True)
class Stop:
    """Place and reason of an end of reading before the end of the file: line, or row of an array, from 1."""

    line: int
    reason: str

    def __str__(self) -> str:
        return f"stopped at line {self.line}: {self.reason}"


class Lines:
    """Numbered lines of a file, plain or gzip (detected by its first bytes), as Latin-1 text without line ends.

    ``stop`` is set if the file ends unexpectedly: a damaged compressed stream, a line that is too long, or a last line
    without a line end. Such a last line is left out, because its last number may have lost digits.

    Raises
    ------
    InputError
        The file cannot be opened, is packed in another form, or holds more than ``max_bytes``.
    """

    def __init__(self, path: str | Path, max_bytes: int = MAX_BYTES) -> None:
        self.path = Path(path)
        self.max_bytes = max_bytes
        self.number = 0
        self.read = 0
        self.stop: Stop | None = None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the lines; ``number`` is the number of the latest line, ``read`` the bytes up to its end."""
        try:
            with open_unpacked(self.path) as stream:
                while raw := stream.readline(MAX_LINE):
                    if not self.number:
                        raw = raw.removeprefix(codecs.BOM_UTF8)  # which tags that count bytes do not know
                    self.number += 1
                    self.read += len(raw)
                    if self.read > self.max_bytes:
                        raise InputError(
                            f"{self.path} must hold at most {self.max_bytes} bytes of text, has more: split it"
                        )
                    if not raw.endswith(b"\n"):
                        endless = len(raw) == MAX_LINE
                        reason = f"it is longer than {MAX_LINE} bytes" if endless else "it has no line end"
                        self.stop = Stop(self.number, reason)
                        return
                    yield raw.decode("latin-1").rstrip("\r\n")
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            self.stop = Stop(self.number + 1, f"the compressed stream is damaged ({error})")
        except OSError as error:
            raise InputError(
                f"{self.path} must be a readable file, got {error.strerror or error}: correct the path"
            ) from error

    def where(self) -> str:
        """File and line, for the start of messages."""
        return f"{self.path}, line {self.number}"


def finite_number(text: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Convert text to a finite number within bounds.

    Raises
    ------
    ValueError
        The text is not such a number; readers put file, line and field in front of the message.
    """
    try:
        value = float(text)
    except ValueError:
        comma = ": write decimal points, not commas" if re.fullmatch(r"[-+]?\d+,\d+", text.strip()) else ""
        raise ValueError(f"must be a number, got {text[:40]!r}{comma}") from None
    if not math.isfinite(value) or not low <= value <= high:
        raise ValueError(f"must lie in [{low:g}, {high:g}], got {text[:40].strip()!r}")
    return value


def whole_number(text: str, low: int, high: int) -> int:
    """Convert text to an integer within bounds.

    Raises
    ------
    ValueError
        As :func:`finite_number`.
    """
    value = finite_number(text, low, high)
    if value != int(value):
        raise ValueError(f"must be a whole number, got {text[:40].strip()!r}")
    return int(value)


WEEK_S = 604_800.0
GPS_EPOCH_S = 315_964_800.0  # 1980-01-06 in seconds since 1970
BDT_BEHIND_GPS_S = 14.0  # BeiDou time starts at 2006-01-01 without the leap seconds before that date
# First days with one leap second more between UTC and GPS time; IERS Bulletin C, none after 2017 until 2026
LEAP_DAYS = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
LEAP_S = np.array([datetime(year, month, 1, tzinfo=UTC).timestamp() - GPS_EPOCH_S for year, month in LEAP_DAYS])


def leap_seconds(utc_s: Array) -> Array:
    """GPS time less UTC [s] at times (...,) of UTC, in seconds since 1980-01-06 without leap seconds."""
    return np.searchsorted(LEAP_S, utc_s, side="right").astype(np.float64)


def unrolled(tow_s: Array) -> Array:
    """Times of week (N,) [s] that continue beyond the end of a week: 604,800 s are added where the week begins anew."""
    return np.asarray(tow_s + WEEK_S * np.cumsum(np.diff(tow_s, prepend=tow_s[:1]) < -0.5 * WEEK_S))


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


def interpolated(at_s: Array, time_s: Array, value: Array) -> Array:
    """Values (N,) or (N, k) of times (N,) at others (T,): linear between samples, constant beyond them."""
    if value.ndim == 1:
        return np.interp(at_s, time_s, value)
    return np.stack([np.interp(at_s, time_s, column) for column in value.T], -1)


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
