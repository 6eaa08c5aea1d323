"""Fault modes as sets of rows, for the plain solution separation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["constellation_modes", "satellite_modes"]

Bools = NDArray[np.bool_]


def satellite_modes(satellite: ArrayLike) -> Bools:
    """One mode for each satellite, removing all its rows (code and phase together).

    satellite (m,) int, 0 to M - 1 for each row -> (M, m).
    """
    owner = np.asarray(satellite, dtype=np.int64)
    return np.asarray(owner == np.arange(int(owner.max(initial=-1)) + 1)[:, None])


def constellation_modes(system: ArrayLike) -> Bools:
    """One mode for each constellation present, in ascending order.  system (m,) int -> (C, m)."""
    owner = np.asarray(system, dtype=np.int64)
    return np.asarray(owner == np.unique(owner)[:, None])
