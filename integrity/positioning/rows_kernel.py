"""Rows of a least-squares problem: one for each satellite, ``y = -e x + clock`` with a clock for each group."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["Rows", "row_scratch"]


class Rows(NamedTuple):
    """S rows: los (S, 3) unit vectors e, group (S,) clock of each row, variance (S,), y (S,), used (S,) bool."""

    los: NDArray[np.float64]
    group: NDArray[np.int64]
    variance: NDArray[np.float64]
    y: NDArray[np.float64]
    used: NDArray[np.bool_]


@jit
def row_scratch(los: NDArray[np.float64], group: NDArray[np.int64]) -> Rows:
    """Rows of these satellites whose variance, y and used are still to be filled."""
    n = group.shape[0]
    return Rows(los, group, np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_))
