"""Reader of smartLoc drives: pseudoranges, odometry and ground truth of a car in a city (Reisdorf et al. 2016).

There are two published formats: the preprocessed one of TUC-ProAut/libRSF (:func:`read_smartloc`, lines
``pseudorange3``, ``odom3`` and ``point3``; corrected for atmosphere and satellite clocks, not for Earth rotation), and
the raw table of the receiver with a label for reflected signals (:func:`read_smartloc_raw`). Raw tables are
semicolon-separated, one signal in each line, with a UTF-8 header (Reisdorf et al. 2016, "The problem of comparable GNSS
results - an approach for a uniform dataset with low-cost and reference data"). They contain no satellite positions; the
preprocessed form of the same drive has them.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import (
    UNTIMED,
    WEEK_S,
    Lines,
    Stop,
    Timing,
    finite_number,
    in_order,
    notes,
    require_degrees,
)

__all__ = [
    "SYSTEM_LETTERS",
    "GroundTruth",
    "Odometry",
    "Pseudoranges",
    "SmartLoc",
    "SmartLocRaw",
    "read_smartloc",
    "read_smartloc_raw",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


UNKNOWN = -1
LETTERS = {"gps": "G", "glonass": "R", "galileo": "E", "beidou": "C", "sbas": "S", "qzss": "J", "imes": "I"}
# start of the column header in lower case: (name, low, high)
NUMBERS = {
    "gpsweek": ("week", 0, 10_000),
    "gpssecondsofweek": ("tow_s", 0.0, 604_800.0),
    "longitude (gt lon)": ("longitude_deg", -180.0, 360.0),
    "latitude (gt lat)": ("latitude_deg", -90.0, 90.0),
    "height above ellipsoid (gt height)": ("height_m", -1e4, 1e5),
    "heading (0": ("heading_east_left_rad", -10.0, 10.0),
    "velocity (gt velocity)": ("speed_mps", -200.0, 200.0),
    "yaw-rate (gt yaw-rate)": ("yaw_rate_left_radps", -50.0, 50.0),
    "pseudorange measurement": ("range_m", 1e5, 1e9),
    "carrier phase measurement": ("carrier_cycles", -1e12, 1e12),
    "doppler measurement": ("doppler_hz", -1e6, 1e6),
    "satellite identifier": ("satellite", 0, 1000),
    "frequency slot": ("slot", 0, 30),
    "carrier-to-noise": ("cn0_dbhz", 0.0, 100.0),
    "estimated pseudorange": ("range_sigma_m", 0.0, 1e9),
}
SYSTEM, LABEL = "gnss identifier", "nlos"


@dataclass(frozen=True)
class SmartLocRaw:
    """Signals (N,): week and time of week [s] (GPS), true position and motion of the car, range, carrier and Doppler,
    satellite and system letter, ``slot`` of GLONASS (channel + 7), C/N0, sigma of the receiver, and ``reflected``: 1,
    0, or -1 for unknown.

    The heading is as in the file: counterclockwise from East [rad].
    """

    week: Ints
    tow_s: Array
    longitude_deg: Array
    latitude_deg: Array
    height_m: Array
    heading_east_left_rad: Array
    speed_mps: Array
    yaw_rate_left_radps: Array
    range_m: Array
    carrier_cycles: Array
    doppler_hz: Array
    satellite: Ints
    slot: Ints
    cn0_dbhz: Array
    range_sigma_m: Array
    system: NDArray[np.str_]
    reflected: Ints
    stopped: Stop | None
    timing: Timing = UNTIMED


def read_smartloc_raw(path: str | Path) -> SmartLocRaw:
    """Read a raw table, plain or gzip.

    Raises
    ------
    InputError
        The file cannot be read, lacks a column, has a malformed line before the last, or no signal.
    """
    lines, refusal, columns, width = Lines(path), "", {}, 0
    stop: Stop | None = None
    values = {name: array("d") for name, _, _ in NUMBERS.values()}
    system, label = [], array("b")
    for text in lines:
        if refusal:
            raise InputError(refusal)
        cells = text.split(";")
        if lines.number == 1:
            columns, width = _columns(cells, path), len(cells)
            continue
        if not text.strip():
            continue
        try:
            row, letter, seen = _row(cells, columns, width)
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
            continue
        for name, value in row.items():
            values[name].append(value)
        system.append(letter)
        label.append(seen)
    if not system:
        raise InputError(f"{path} must hold at least one signal, got none: {refusal or 'is it a smartLoc *_raw.csv?'}")
    tables: dict[str, Any] = {name: np.array(column) for name, column in values.items()}
    time = WEEK_S * tables["week"] + tables["tow_s"]
    keep, timing = in_order(path, time, True, np.column_stack([*tables.values(), [ord(letter) for letter in system]]))
    tables = {name: column[keep] for name, column in tables.items()}
    whole = {name: tables.pop(name).astype(np.int64) for name in ("week", "satellite", "slot")}
    return SmartLocRaw(
        **tables, **whole, system=np.array(system, dtype="U1")[keep], reflected=np.array(label, dtype=np.int64)[keep],
        stopped=stop or lines.stop, timing=timing,
    )  # fmt: skip


def _columns(heads: list[str], path: str | Path) -> dict[str, int]:
    """Index of every required column."""
    found = {}
    for wanted in (*NUMBERS, SYSTEM, LABEL):
        at = [i for i, head in enumerate(heads) if head.strip().lower().startswith(wanted)]
        if not at:
            raise InputError(f"{path}, line 1 must name a column '{wanted}...', got none: is it a smartLoc *_raw.csv?")
        found[wanted] = at[0]
    return found


def _row(cells: list[str], columns: dict[str, int], width: int) -> tuple[dict[str, float], str, int]:
    """Numbers by name, system letter and label of one line; ValueError with the column."""
    if len(cells) != width:
        raise ValueError(f"the line must have {width} columns, got {len(cells)}: it is truncated")
    row = {}
    for head, (name, low, high) in NUMBERS.items():
        try:
            row[name] = finite_number(cells[columns[head]], low, high)
        except ValueError as error:
            raise ValueError(f"column '{head}' {error}") from None
    system = cells[columns[SYSTEM]].strip().lower()
    if system not in LETTERS:
        raise ValueError(f"column '{SYSTEM}' must be one of {', '.join(LETTERS)}, got {system[:40]!r}")
    label = cells[columns[LABEL]].strip()
    if label not in ("0", "1", "#"):
        raise ValueError(f"column '{LABEL}' must be 0, 1 or #, got {label[:40]!r}")
    return row, LETTERS[system], UNKNOWN if label == "#" else int(label)


SYSTEM_LETTERS = {1: "G", 2: "S", 4: "R", 8: "E", 16: "J", 32: "C"}  # readme of the data set
TIME = (0.0, 1e10)
ANY = (-1e10, 1e10)
VARIANCE = (0.0, 1e12)
# (name, low, high) of the columns after the keyword
COLUMNS = {
    "pseudorange3": (
        ("time", *TIME), ("pseudorange", 1e5, 1e9), ("covariance", *VARIANCE), ("satellite x", *ANY),
        ("satellite y", *ANY), ("satellite z", *ANY), ("satellite id", 0, 100_000), ("satellite system", 1, 32),
        ("elevation", -90.0, 90.0), ("C/N0", 0.0, 100.0),
    ),
    "odom3": (
        ("time", *TIME), ("velocity x", -200.0, 200.0), ("velocity y", -200.0, 200.0), ("velocity z", -200.0, 200.0),
        ("turn rate x", -50.0, 50.0), ("turn rate y", -50.0, 50.0), ("turn rate z", -50.0, 50.0),
        *((f"covariance {i}", *VARIANCE) for i in range(1, 7)),
    ),
    "point3": (("time", *TIME), ("position x", *ANY), ("position y", *ANY), ("position z", *ANY)),
}  # fmt: skip
NEARER_S = 0.02  # largest time between a true position and the epoch it belongs to; the rate is 5 Hz


@dataclass(frozen=True)
class Pseudoranges:
    """Rows (N,): time [s], range [m] and its variance from the receiver [m^2], satellite position (N, 3) ECEF [m] at
    transmission, id, system letter, elevation [rad], C/N0 [dB-Hz]."""

    time_s: Array
    range_m: Array
    variance_m2: Array
    satellite_ecef_m: Array
    satellite: Ints
    system: NDArray[np.str_]
    elevation_rad: Array
    cn0_dbhz: Array


@dataclass(frozen=True)
class Odometry:
    """Wheel speed [m/s] and yaw rate, positive to the LEFT as recorded [rad/s], with their variances, (M,) each."""

    time_s: Array
    speed_mps: Array
    yaw_rate_left_radps: Array
    speed_variance_m2ps2: Array
    yaw_rate_variance_rad2ps2: Array


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth: time (K,) [s] and position (K, 3) ECEF [m]."""

    time_s: Array
    position_ecef_m: Array

    def at(self, time_s: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Position (T, 3) at times (T,) by linear interpolation, and whether a true position is within 0.3 s (T,)."""
        inside = (time_s >= self.time_s[0] - NEARER_S) & (time_s <= self.time_s[-1] + NEARER_S)
        after = np.clip(np.searchsorted(self.time_s, time_s), 0, self.time_s.size - 1)
        before = np.maximum(after - 1, 0)
        close = np.minimum(np.abs(self.time_s[after] - time_s), np.abs(self.time_s[before] - time_s)) < 0.3
        columns = [np.interp(time_s, self.time_s, self.position_ecef_m[:, k]) for k in range(3)]
        return np.stack(columns, -1), np.asarray(inside & close)


@dataclass(frozen=True)
class SmartLoc:
    """A drive; ``truth`` is None without a ground truth file, ``stopped`` is the place where a truncated file ends,
    ``timings`` is what the times of ``pseudorange3``, ``odom3`` and ``point3`` show."""

    ranges: Pseudoranges
    odometry: Odometry
    truth: GroundTruth | None
    stopped: Stop | None
    timings: dict[str, Timing] = field(default_factory=dict)

    @property
    def notes(self) -> dict[str, str]:
        """By kind of line, rows that are left out, and gaps, and where a truncated file ends."""
        return notes(
            *((name, None, timing) for name, timing in self.timings.items()), ("smartloc", self.stopped, UNTIMED)
        )

    def bridged(self, time_s: Array, after_s: float = 0.0) -> NDArray[np.bool_]:
        """Whether times (T,) lie in a gap of wheels and gyro, or up to ``after_s`` later."""
        return self.timings.get("odom3", UNTIMED).bridged(time_s, after_s=after_s)


def read_smartloc(path: str | Path, truth: str | Path | None = None) -> SmartLoc:
    """Read a drive from its ``*_Input`` file, plain or gzip, and its ``*_GT`` file.

    Raises
    ------
    InputError
        A file cannot be read, a line before the last is malformed, or there is no pseudorange.
    """
    rows, stopped = _read(path, ("pseudorange3", "odom3", "point3"))
    if truth is not None:
        true_rows, true_stop = _read(truth, ("point3",))
        rows["point3"], stopped = true_rows["point3"], stopped or true_stop
    timings: dict[str, Timing] = {}
    for name in rows:
        keep, timings[name] = in_order(f"{path}, {name}", rows[name][:, 0], name == "pseudorange3", rows[name])
        rows[name] = rows[name][keep]
    ranges = rows["pseudorange3"]
    if not ranges.shape[0]:
        raise InputError(f"{path} must hold lines 'pseudorange3', got none: is it the *_Input file of smartLoc?")
    require_degrees(f"elevations of {path}", ranges[:, 8])
    return SmartLoc(_pseudoranges(ranges), _odometry(rows["odom3"]), _truth(rows["point3"], truth), stopped, timings)


def _read(path: str | Path, wanted: tuple[str, ...]) -> tuple[dict[str, Array], Stop | None]:
    """Numbers of each kind of line (n, columns), and the place where reading stopped."""
    found = {name: array("d") for name in wanted}
    lines, refusal = Lines(path), None
    for text in lines:
        if refusal is not None:
            raise InputError(refusal)
        words = text.split()
        if not words:
            continue
        if words[0] not in found:
            refusal = f"{lines.where()}: the first word must be one of {', '.join(wanted)}, got {words[0][:40]!r}"
            stop = Stop(lines.number, f"unknown word {words[0][:40]!r}")
            continue
        try:
            found[words[0]].extend(_numbers(words))
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
    tables = {name: np.array(v).reshape(-1, len(COLUMNS[name])) for name, v in found.items()}
    return tables, stop if refusal is not None else lines.stop


def _numbers(words: list[str]) -> list[float]:
    """All columns of a line, checked against their bounds; ValueError with the column."""
    columns = COLUMNS[words[0]]
    if len(words) <= len(columns):
        raise ValueError(f"{words[0]} must have {len(columns)} columns, got {len(words) - 1}: the line is truncated")
    values = []
    for (name, low, high), text in zip(columns, words[1:], strict=False):
        try:
            values.append(finite_number(text, low, high))
        except ValueError as error:
            raise ValueError(f"{name} {error}") from None
    return values


def _pseudoranges(rows: Array) -> Pseudoranges:
    letters = np.array([SYSTEM_LETTERS.get(int(code), "?") for code in rows[:, 7]], dtype="U1")
    return Pseudoranges(
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3:6], rows[:, 6].astype(np.int64), letters,
        np.radians(rows[:, 8]), rows[:, 9],
    )  # fmt: skip


def _odometry(rows: Array) -> Odometry:
    return Odometry(rows[:, 0], rows[:, 1], rows[:, 6], rows[:, 7], rows[:, 12])


def _truth(rows: Array, path: str | Path | None) -> GroundTruth | None:
    if not rows.shape[0]:
        if path is not None:
            raise InputError(f"{path} must hold lines 'point3', got none: is it the *_GT file of smartLoc?")
        return None
    if math.isclose(float(np.abs(rows[:, 1:]).max()), 0.0):
        raise InputError(f"{path} must hold positions, got zeros only: is it the *_GT file of smartLoc?")
    return GroundTruth(rows[:, 0], rows[:, 1:])
