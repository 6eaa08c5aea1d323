"""Readers of recorded RTK drives: RTKLIB solution files, and a reference trajectory with ECEF positions.

RTKLIB's ``.pos`` (manual 2.4.2, section B.1) is read in all forms of ``out-solformat`` (llh in degrees or in degrees,
minutes and seconds, xyz, enu), ``out-timeform`` (week and time of week, or date and time), ``out-timesys`` and
``out-fieldsep``, with or without velocities (``out-outvel``). Which they are, the line with the names of the columns
says; without it llh in GPS time is assumed. Baselines (enu) need ``ref pos`` of the head. The reference is a table with
a header, as in the MatRTKLIB examples: columns ``GPS TOW (s)``, ``ECEF X (m)``, ``ECEF Y (m)`` and ``ECEF Z (m)`` among
others, and ``GPS Week`` and ``Heading (deg)`` if known; ``GPS time``, ``X``, ``Y`` and ``Z`` are
short names of the first four.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic, enu_axes
from lanebound.integrity.recorded.source import (
    GPS_EPOCH_S,
    WEEK_S,
    Lines,
    Stop,
    Timing,
    finite_number,
    in_order,
    leap_seconds,
    unrolled,
)

__all__ = ["FIXED", "FLOAT", "MATCHED_S", "ReferenceTrack", "RtkSolution", "read_reference", "read_rtk_solution"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Row = Callable[[list[str]], list[float]]

COMMENT = "%"
DECIMAL_COMMA = re.compile(r"\d,\d")
FIXED, FLOAT = 1, 2  # values of Q
SCALES = ("GPST", "UTC", "JST")
JST_AHEAD_S = 9 * 3600.0
DEG, DMS, XYZ, ENU = "latitude and longitude in degrees", "degrees, minutes, seconds", "ECEF", "baselines"
ANGLES = (("latitude", -90.0, 90.0), ("longitude", -180.0, 360.0))
SIXTIETHS = (("minutes", 0.0, 60.0), ("seconds", 0.0, 60.0))
HEIGHT = ("height", -1e4, 1e5)
PLACES = {
    DEG: (*ANGLES, HEIGHT),
    DMS: (ANGLES[0], *SIXTIETHS, ANGLES[1], *SIXTIETHS, HEIGHT),
    XYZ: tuple((f"{axis}-ecef", -1e8, 1e8) for axis in "xyz"),
    ENU: tuple((f"{axis}-baseline", -1e7, 1e7) for axis in "enu"),
}
# after the position: Q, ns, six deviations and age, which are not used, ratio, velocities
QUALITY = (("Q", 0.0, 10.0), ("ns", 0.0, 1000.0))
RATIO_AT, SPEED_AT = 9, 10
RATIO, SPEEDS = ("ratio", 0.0, 1e9), tuple((f"velocity {axis}", -1e3, 1e3) for axis in "123")
# Of a solution from its base, and of most epochs; what is farther or faster is of another form
FARTHEST_M, FASTEST_MPS = 1e6, 400.0
FEWEST_DECIMALS = 5  # of degrees, 1 m; RTKLIB writes nine, and four of metres
REFERENCE_COLUMNS = {
    "GPS TOW (s)": (0.0, 604_800.0), "ECEF X (m)": (-1e8, 1e8), "ECEF Y (m)": (-1e8, 1e8), "ECEF Z (m)": (-1e8, 1e8),
}  # fmt: skip
OPTIONAL_COLUMNS = {"GPS Week": (0.0, 1e4), "Heading (deg)": (-360.0, 360.0)}
SHORT_NAMES = {"GPS time": "GPS TOW (s)", "X": "ECEF X (m)", "Y": "ECEF Y (m)", "Z": "ECEF Z (m)"}  # of other sources
EARTH_M = 6.371e6
MATCHED_S = 0.02  # largest time between a solution and its reference


@dataclass(frozen=True)
class RtkSolution:
    """Epochs (T,) of a solution file: GPS time [s since 1980-01-06], position (T, 3) ECEF [m], quality (1 fixed, 2
    float), number of satellites, ratio of the integer search, velocity (T, 3) in North, East, Up [m/s] or None;
    ``stopped`` is the place where a truncated file ends."""

    gps_time_s: Array
    position_ecef_m: Array
    quality: Ints
    satellites: Ints
    ratio: Array
    velocity_neu_mps: Array | None
    stopped: Stop | None
    timing: Timing


@dataclass(frozen=True)
class ReferenceTrack:
    """True positions: time of week (K,) [s], which goes on beyond the end of a week, GPS week of the first or None,
    position (K, 3) ECEF [m], heading (K,) [rad], NaN where the file has none; ``stopped`` as of a solution."""

    tow_s: Array
    week: int | None
    position_ecef_m: Array
    heading_rad: Array
    stopped: Stop | None
    timing: Timing

    def since_start(self, gps_time_s: Array) -> Array:
        """GPS times (T,) as times of week of this track; without a week it is that of the first time."""
        week = self.week if self.week is not None else round((float(gps_time_s[0]) - self.tow_s[0]) / WEEK_S)
        return np.asarray(gps_time_s - week * WEEK_S)

    def at(self, gps_time_s: Array) -> Array:
        """True positions (T, 3) ECEF [m] at GPS times (T,): those within MATCHED_S, NaN where there is none."""
        time = self.since_start(gps_time_s)
        last = self.tow_s.size - 1
        after = np.clip(np.searchsorted(self.tow_s, time), 0, last)
        near = np.where(np.abs(self.tow_s[after] - time) <= np.abs(self.tow_s[after - 1] - time), after, after - 1)
        known = np.abs(self.tow_s[near] - time) <= MATCHED_S
        return np.where(known[:, None], self.position_ecef_m[near], np.nan)


@dataclass
class _Head:
    """What the comments of a solution say: form of positions, scale of times, position of the base ECEF (3,) [m]; and
    the largest number of decimals of its first two coordinates."""

    form: str = DEG
    scale: str = "GPST"
    base_m: Array | None = None
    named: bool = field(default=False, repr=False)
    decimals: int = 0

    def take(self, comment: str) -> None:
        """Read a comment line."""
        text = comment.lstrip("% ").strip()
        if text.startswith("ref pos"):
            self.base_m = _base(text.partition(":")[2])
        elif not self.named and text.startswith("obs start"):
            self.scale = next((scale for scale in SCALES if re.search(rf"\b{scale}\b", text)), self.scale)
        elif text.startswith(SCALES):
            names = text.lower()
            forms = {"latitude(d'": DMS, "x-ecef": XYZ, "e-baseline": ENU}
            found = text.split()[0].strip(","), next((form for name, form in forms.items() if name in names), DEG)
            if self.named and found != (self.scale, self.form):
                raise InputError(
                    f"all heads of a solution must be alike, got {self.scale}, {self.form}, then {', '.join(found)}: "
                    "split the file there, or set out-solformat and out-timesys of RTKLIB alike"
                )
            (self.scale, self.form), self.named = found, True


def read_rtk_solution(path: str | Path) -> RtkSolution:
    """Read a solution file of RTKLIB in any of its forms, plain or gzip.

    Raises
    ------
    InputError
        The file cannot be read, a line before the last is malformed, there is no solution, positions cannot be of the
        form of the head (``out-solformat``), or times go back.
    """
    head = _Head()

    def row(words: list[str]) -> list[float]:
        if words[0].startswith("$"):
            raise ValueError(f"must be a solution, got NMEA ({words[0][:10]}): set out-solformat of RTKLIB to llh")
        time, rest = _time(words)
        places = PLACES[head.form]
        try:
            values = [_cell(rest, i, *column) for i, column in enumerate((*places, *QUALITY))]
        except ValueError as error:
            raise ValueError(f"{error}; read as {head.form} by the head (out-solformat)") from None
        head.decimals = max(head.decimals, *(len(word.partition(".")[2]) for word in rest[:2]))
        more = rest[len(places) :]
        if len(more) <= RATIO_AT:
            least = len(words) - len(more) + RATIO_AT
            raise ValueError(f"must have more than {least} columns, got {len(words)}: the line is truncated")
        ratio = _cell(more, RATIO_AT, *RATIO)
        fast = len(more) >= SPEED_AT + 3
        speeds = [_cell(more, SPEED_AT + i, *of) for i, of in enumerate(SPEEDS)] if fast else [math.nan] * 3
        return [time, *_plain(values[:-2], head.form), *values[-2:], ratio, *speeds]

    rows, stop = _rows(path, row, comment=head.take)
    keep, timing = in_order(path, rows[:, 0], rows=rows)
    rows = rows[keep]
    time = rows[:, 0]
    if head.scale != "GPST":
        utc = time - JST_AHEAD_S * (head.scale == "JST")
        time = utc + leap_seconds(utc)
    place = _ecef(rows[:, 1:4], time, head, path)
    velocity = None if np.isnan(rows[:, 7:]).any() else rows[:, 7:]
    if velocity is not None and head.form == XYZ:
        velocity = (velocity @ enu_axes(place[0]))[:, [1, 0, 2]]
    return RtkSolution(
        time, place, rows[:, 4].astype(np.int64), rows[:, 5].astype(np.int64), rows[:, 6], velocity, stop, timing
    )


def read_reference(path: str | Path) -> ReferenceTrack:
    """Read a reference trajectory, plain or gzip.

    Raises
    ------
    InputError
        As :func:`read_rtk_solution`, or a column is missing.
    """
    index: list[int] = []

    def row(words: list[str]) -> list[float]:
        if not index:
            index.extend(_positions(words, path))
            return []
        bounds = zip(index, (REFERENCE_COLUMNS | OPTIONAL_COLUMNS).items(), strict=True)
        return [math.nan if k < 0 else _cell(words, k, name, low, high) for k, (name, (low, high)) in bounds]

    rows, stop = _rows(path, row, ",")
    rows[:, 0] = unrolled(rows[:, 0])
    keep, timing = in_order(path, rows[:, 0], rows=rows)
    rows = rows[keep]
    farthest = float(np.abs(np.linalg.norm(rows[:, 1:4], axis=1) - EARTH_M).max())
    if farthest > FARTHEST_M:
        raise InputError(
            f"{path} must have ECEF positions near the Earth's surface, got one {farthest / 1000.0:.0f} km off it: are "
            "X, Y and Z of another frame?"
        )
    week = None if np.isnan(rows[0, 4]) else int(rows[0, 4])
    return ReferenceTrack(rows[:, 0], week, rows[:, 1:4], np.radians(rows[:, 5]), stop, timing)


def _time(words: list[str]) -> tuple[float, list[str]]:
    """Time [s since 1980-01-06] in the scale of the file, and the words after it."""
    if "/" in words[0]:
        if len(words) > 1 and ":" in words[1]:
            try:
                whole, _, part = words[1].partition(".")
                moment = datetime.strptime(f"{words[0]} {whole}", "%Y/%m/%d %H:%M:%S").replace(tzinfo=UTC)
                return moment.timestamp() - GPS_EPOCH_S + finite_number(f"0.{part or 0}", 0.0, 1.0), words[2:]
            except ValueError:
                pass
        if len(words) <= RATIO_AT:  # a time that is cut is no other form
            raise ValueError(f"must have more than {RATIO_AT} columns, got {len(words)}: the line is truncated")
        raise ValueError(
            f"date and time must be as 2025/07/08 19:34:18.499, got {' '.join(words[:2])[:40]!r}: set out-timeform of "
            "RTKLIB to hms or tow"
        )
    week = _cell(words, 0, "week (out-timeform tow, otherwise a date)", 0.0, 1e4)
    return WEEK_S * week + _cell(words, 1, "time of week", 0.0, WEEK_S), words[2:]


def _plain(values: list[float], form: str) -> list[float]:
    """The three coordinates of a row."""
    if form != DMS:
        return values
    angles = [math.copysign(abs(d) + m / 60.0 + s / 3600.0, d) for d, m, s in (values[:3], values[3:6])]
    return [*angles, values[6]]


def _ecef(place: Array, time_s: Array, head: _Head, path: str | Path) -> Array:
    """Positions (T, 3) ECEF [m] of coordinates in the form of the head, tested for what that form cannot be."""
    if head.form == ENU:
        if head.base_m is None:
            raise InputError(
                f"{path} holds baselines (e/n/u) and no 'ref pos' in its head: set out-solformat of RTKLIB to llh or "
                "xyz"
            )
        return np.asarray(head.base_m + place @ enu_axes(head.base_m).T)
    if head.form == XYZ:
        found = place
    else:
        found = ecef_from_geodetic(np.radians(place[:, 0]), np.radians(place[:, 1]), place[:, 2])
    pace = np.median(np.linalg.norm(np.diff(found, axis=0), axis=1) / np.diff(time_s)) if len(found) > 1 else 0.0
    coarse = head.form == DEG and head.decimals < FEWEST_DECIMALS
    away = 0.0 if head.base_m is None else float(np.linalg.norm(np.median(found, axis=0) - head.base_m))
    length = float(np.linalg.norm(np.median(found, axis=0)))
    likely = "are these baselines (e/n/u)?"
    if head.form == DEG and head.base_m is not None:
        unturned = ecef_from_geodetic(place[:, 0], place[:, 1], place[:, 2])
        if float(np.linalg.norm(np.median(unturned, axis=0) - head.base_m)) < FARTHEST_M:
            likely = "they are probably in radians: convert them to degrees."
    apart = f", {away / 1000.0:.0f} km from ref pos" if away else ""
    if away > FARTHEST_M or pace > FASTEST_MPS or coarse or not 6.0e6 < length < 7.0e6:
        raise InputError(
            f"{path} must hold positions as {head.form}, {'as its head says' if head.named else 'without a head'}, the "
            f"first is {', '.join(f'{v:g}' for v in place[0])} with {head.decimals} decimals, most move at "
            f"{pace:.0f} m/s{apart}: {likely} Set "
            "out-solformat of RTKLIB to llh or xyz, and keep the head (out-outhead)"
        )
    return np.asarray(found)


def _base(text: str) -> Array | None:
    """Position (3,) ECEF [m] of ``ref pos`` in the form that its numbers have; None for another."""
    try:
        values = [finite_number(word) for word in text.split()]
    except ValueError:
        return None
    if len(values) == 7:
        values = _plain(values, DMS)
    if len(values) != 3:
        return None
    if np.abs(values[:2]).max() > 360.0:
        return np.array(values)
    return np.asarray(ecef_from_geodetic(math.radians(values[0]), math.radians(values[1]), values[2]))


def _positions(heads: list[str], path: str | Path) -> list[int]:
    """Index of each column of a reference; -1 for an optional one that it lacks."""
    names = [SHORT_NAMES.get(head.strip(), head.strip()) for head in heads]
    for wanted in REFERENCE_COLUMNS:
        if wanted not in names:
            raise InputError(f"{path}, line 1 must name a column '{wanted}', got none: is it a reference trajectory?")
    return [names.index(name) if name in names else -1 for name in REFERENCE_COLUMNS | OPTIONAL_COLUMNS]


def _cell(words: list[str], index: int, name: str, low: float, high: float) -> float:
    """A number of a line; ValueError with its name."""
    if index >= len(words):
        raise ValueError(f"must have more than {index} columns, got {len(words)}: the line is truncated")
    try:
        return finite_number(words[index], low, high)
    except ValueError as error:
        raise ValueError(f"{name} {error}") from None


def _rows(
    path: str | Path, row: Row, separator: str | None = None, comment: Callable[[str], None] | None = None
) -> tuple[Array, Stop | None]:
    """Numbers of all lines (n, columns), and the place where reading stopped; commas separate as blanks do, unless a
    ``separator`` is given."""
    lines, refusal, found = Lines(path), "", array("d")
    stop: Stop | None = None
    width = 1
    for text in lines:
        if refusal:
            raise InputError(refusal)
        if not text.strip() or text.startswith(COMMENT):
            if comment is not None:
                comment(text)
            continue
        try:
            if separator is None and "." not in text and DECIMAL_COMMA.search(text):
                raise ValueError(f"numbers must have decimal points, got commas in {text.strip()[:40]!r}: write points")
            numbers = row(text.split(separator) if separator else re.split(r"[\s,;]+", text.strip()))
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
            continue
        width = max(width, len(numbers))
        found.extend(numbers)
    if not found:
        raise InputError(f"{path} must hold at least one position, got none: {refusal or 'is it the right file?'}")
    return np.array(found).reshape(-1, width), stop or lines.stop
