"""A track: what one source knows of one vehicle, a row of an array with a row for each slot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["AGE", "HEADING", "N_COLUMNS", "PL_AT", "PL_CT", "SPEED", "XY", "direction"]

XY = slice(0, 2)
HEADING, SPEED, PL_AT, PL_CT, AGE = range(2, 7)
N_COLUMNS = 7


def direction(heading_rad: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors of headings in the plane.  (...) -> (..., 2)."""
    out = np.empty((*np.shape(heading_rad), 2))
    out[..., 0] = np.cos(heading_rad)
    out[..., 1] = np.sin(heading_rad)
    return out
