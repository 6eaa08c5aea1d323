"""Lines of sight by the triangles of a city: the reference of sky masks, which round directions to cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.sky.raytrace import first_hits
from lanebound.integrity.sky.scene import City

__all__ = ["line_of_sight"]


def line_of_sight(city: City, antenna_enu_m: ArrayLike, los_enu: ArrayLike) -> NDArray[np.bool_]:
    """Whether no solid triangle blocks the directions from the antennas (S2 eq 1-2).

    antenna_enu_m (P, 3) [m]; los_enu (S, 3) for all antennas or (P, S, 3) -> (P, S). Directions below the horizon are
    blocked by the ground.
    """
    antenna = np.atleast_2d(np.asarray(antenna_enu_m, dtype=np.float64))
    los = np.asarray(los_enu, dtype=np.float64)
    los = np.broadcast_to(los, (antenna.shape[0], *los.shape[-2:]))
    clear = first_hits(city.grid, antenna[:, None], los).clear.reshape(los.shape[:2])
    return np.asarray(clear & (los[..., 2] >= 0.0))
