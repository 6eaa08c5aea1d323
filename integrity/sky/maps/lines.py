"""Lines of points in the plane by their arc length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["along", "arcs_of", "part_of", "points_at"]

Array = NDArray[np.float64]


def arcs_of(line_en_m: Array) -> Array:
    """Arc length at each point of a line (n, 2) [m], from 0.  (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_en_m, axis=0), axis=1))])


def points_at(line_en_m: Array, at_m: Array) -> Array:
    """Points (k, 2) [m] of a line (n, 2) [m] at arc lengths (k,) [m]; its ends beyond them."""
    arc = arcs_of(line_en_m)
    return np.stack([np.interp(at_m, arc, line_en_m[:, j]) for j in (0, 1)], -1)


def part_of(line_en_m: Array, begin_m: float, end_m: float, clear_m: float = 0.0) -> Array:
    """The part of a line (n, 2) [m] between two arc lengths [m], without its points within ``clear_m`` of the ends."""
    arc = arcs_of(line_en_m)
    return points_at(line_en_m, np.array([begin_m, *arc[(arc > begin_m + clear_m) & (arc < end_m - clear_m)], end_m]))


def along(line_en_m: Array, spacing_m: float) -> Array:
    """Places along a line (n, 2), evenly spaced and at most so far apart, with its ends.  -> (m, 2) [m]."""
    length = float(arcs_of(line_en_m)[-1])
    return points_at(line_en_m, np.linspace(0.0, length, int(np.ceil(length / spacing_m)) + 1))
