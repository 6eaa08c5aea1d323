"""Readers of recorded RTK drives: RTKLIB solution files, and a reference trajectory with ECEF positions.

RTKLIB (``.pos``, lines ``week tow latitude longitude height quality satellites ... age ratio``, comments begin with
``%``; RTKLIB manual 2.4.2, section B.1). The reference is a table with a header, as in the MatRTKLIB examples: columns
``GPS TOW (s)``, ``ECEF X (m)``, ``ECEF Y (m)`` and ``ECEF Z (m)`` among others, and ``Heading (deg)`` if known.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic
from lanebound.integrity.recorded.source import Lines, Stop, finite_number

__all__ = ["FIXED", "FLOAT", "ReferenceTrack", "RtkSolution", "read_reference", "read_rtk_solution"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Row = Callable[[list[str]], list[float]]

COMMENT = "%"
FIXED, FLOAT = 1, 2  # values of Q
# (column, name, low, high); the standard deviations between satellites and age are not used
POSITION_COLUMNS = (
    (1, "time of week", 0.0, 604_800.0), (2, "latitude", -90.0, 90.0), (3, "longitude", -180.0, 360.0),
    (4, "height", -1e4, 1e5), (5, "Q", 0, 10), (6, "ns", 0, 1000), (14, "ratio", 0.0, 1e9),
)  # fmt: skip
REFERENCE_COLUMNS = {
    "GPS TOW (s)": (0.0, 604_800.0), "ECEF X (m)": (-1e8, 1e8), "ECEF Y (m)": (-1e8, 1e8), "ECEF Z (m)": (-1e8, 1e8),
}  # fmt: skip
HEADING_COLUMN, HEADINGS = "Heading (deg)", (-360.0, 360.0)


@dataclass(frozen=True)
class RtkSolution:
    """Epochs (T,) of a solution file: time of week [s], position (T, 3) ECEF [m], quality (1 fixed, 2 float), number of
    satellites, ratio of the integer search; ``stopped`` is the place where a truncated file ends."""

    tow_s: Array
    position_ecef_m: Array
    quality: Ints
    satellites: Ints
    ratio: Array
    stopped: Stop | None


@dataclass(frozen=True)
class ReferenceTrack:
    """True positions: time of week (K,) [s], position (K, 3) ECEF [m], heading (K,) [rad], NaN where the file has none;
    ``stopped`` as of a solution."""

    tow_s: Array
    position_ecef_m: Array
    heading_rad: Array
    stopped: Stop | None


def read_rtk_solution(path: str | Path) -> RtkSolution:
    """Read a solution file of RTKLIB with geodetic positions, plain or gzip.

    Raises
    ------
    InputError
        The file cannot be read, a line before the last is malformed, or there is no solution.
    """
    rows, stop = _rows(path, lambda words: [_cell(words, *column) for column in POSITION_COLUMNS])
    position = ecef_from_geodetic(np.radians(rows[:, 1]), np.radians(rows[:, 2]), rows[:, 3])
    return RtkSolution(rows[:, 0], position, rows[:, 4].astype(np.int64), rows[:, 5].astype(np.int64), rows[:, 6], stop)


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
        bounds = zip(index, (REFERENCE_COLUMNS | {HEADING_COLUMN: HEADINGS}).items(), strict=True)
        return [math.nan if k < 0 else _cell(words, k, name, low, high) for k, (name, (low, high)) in bounds]

    rows, stop = _rows(path, row, ",")
    return ReferenceTrack(rows[:, 0], rows[:, 1:4], np.radians(rows[:, 4]), stop)


def _positions(heads: list[str], path: str | Path) -> list[int]:
    """Index of each column of a reference; -1 for a heading that it lacks."""
    names = [head.strip() for head in heads]
    for wanted in REFERENCE_COLUMNS:
        if wanted not in names:
            raise InputError(f"{path}, line 1 must name a column '{wanted}', got none: is it a reference trajectory?")
    heading = names.index(HEADING_COLUMN) if HEADING_COLUMN in names else -1
    return [*(names.index(wanted) for wanted in REFERENCE_COLUMNS), heading]


def _cell(words: list[str], index: int, name: str, low: float, high: float) -> float:
    """A number of a line; ValueError with its name."""
    if index >= len(words):
        raise ValueError(f"must have more than {index} columns, got {len(words)}: the line is truncated")
    try:
        return finite_number(words[index], low, high)
    except ValueError as error:
        raise ValueError(f"{name} {error}") from None


def _rows(path: str | Path, row: Row, separator: str | None = None) -> tuple[Array, Stop | None]:
    """Numbers of all lines (n, columns) sorted by time, and the place where reading stopped."""
    lines, refusal, found = Lines(path), "", array("d")
    stop: Stop | None = None
    width = 1
    for text in lines:
        if refusal:
            raise InputError(refusal)
        if not text.strip() or text.startswith(COMMENT):
            continue
        try:
            numbers = row(text.split(separator))
        except ValueError as error:
            refusal, stop = f"{lines.where()}, {error}", Stop(lines.number, str(error))
            continue
        width = max(width, len(numbers))
        found.extend(numbers)
    if not found:
        raise InputError(f"{path} must hold at least one position, got none: {refusal or 'is it the right file?'}")
    table = np.array(found).reshape(-1, width)
    return table[np.argsort(table[:, 0], kind="stable")], stop or lines.stop
