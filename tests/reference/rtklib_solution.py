"""Solutions that RTKLIB wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import Lines, finite_number

__all__ = ["read_solution"]

Array = NDArray[np.float64]


def read_solution(path: str | Path) -> tuple[Array, Array, NDArray[np.int64]]:
    """Read an RTKLIB solution in ECEF (``out-solformat=xyz``): time of day (T,) [s], position (T, 3) [m], quality (T,).

    Raises
    ------
    InputError
        The file is not such a solution.
    """
    time, place, quality = [], [], []
    lines = Lines(path)
    for text in lines:
        if text.startswith("%") or not text.strip():
            continue
        words = text.split()
        try:
            hour, minute, second = (finite_number(w, 0.0, 61.0) for w in words[1].split(":"))
            time.append(3600.0 * hour + 60.0 * minute + second)
            place.append([finite_number(w, -1e8, 1e8) for w in words[2:5]])
            quality.append(int(finite_number(words[5], 0, 9)))
        except (ValueError, IndexError) as error:
            raise InputError(f"{lines.where()} must be a line of an RTKLIB solution in x, y, z, got: {error}") from None
    if not time:
        raise InputError(f"{path} must hold solutions, got none: is it a .pos file of RTKLIB?")
    return np.array(time), np.array(place), np.array(quality, dtype=np.int64)
