"""Ranges to satellites from their positions at transmission, corrected for the rotation of the Earth (Sagnac)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, rotated_with_earth
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

__all__ = ["ranges_and_sights"]

Array = NDArray[np.float64]


def ranges_and_sights(satellite_ecef_m: Array, receiver_ecef_m: Array) -> tuple[Array, Array]:
    """Compute range (...,) [m] and unit vector to the satellite (..., 3) in the Earth-fixed frame at reception.

    satellite_ecef_m (..., 3) in the Earth-fixed frame at transmission, receiver_ecef_m (..., 3). The satellite position
    is rotated by ``omega tau`` about the axis of the Earth, tau the travel time (IS-GPS-200 20.3.3.4.3.3).
    """
    distance = np.linalg.norm(satellite_ecef_m - receiver_ecef_m, axis=-1)
    for _ in range(2):  # the first correction of tau moves the satellite by 1e-4 m; the second is a reserve
        angle = EARTH_RATE_RADPS * distance / SPEED_OF_LIGHT_MPS
        offset = rotated_with_earth(satellite_ecef_m, angle) - receiver_ecef_m
        distance = np.linalg.norm(offset, axis=-1)
    return distance, offset / distance[..., None]
