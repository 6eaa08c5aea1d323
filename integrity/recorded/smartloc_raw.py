"""Reader of smartLoc raw tables: every signal of the u-blox receiver, a label for reflected signals, and the truth.

Semicolon-separated, one signal in each line, UTF-8 header (Reisdorf et al. 2016, "The problem of comparable GNSS
results - an approach for a uniform dataset with low-cost and reference data"). The tables contain no satellite
positions; the preprocessed form of the same drive (:mod:`.smartloc`) has them.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.series import UNTIMED, Timing, in_order
from lanebound.integrity.recorded.source import Lines, Stop, finite_number
from lanebound.integrity.recorded.time_scales import WEEK_S

__all__ = ["SmartLocRaw", "read_smartloc_raw"]

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
    keep, timing = in_order(path, WEEK_S * tables["week"] + tables["tow_s"], repeated=True)
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
