"""Ranges to satellites given where they were at transmission: the Earth turns while the signal travels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

__all__ = ["ranges_and_sights"]

Array = NDArray[np.float64]


def ranges_and_sights(satellite_ecef_m: Array, receiver_ecef_m: Array) -> tuple[Array, Array]:
    """Range (...,) [m] and unit vector to the satellite (..., 3), both in the Earth-fixed frame of reception.

    The satellite is turned by ``omega tau`` about the axis of the Earth, tau the travel time (IS-GPS-200 20.3.3.4.3.3).
    """
    flat = np.linalg.norm(satellite_ecef_m - receiver_ecef_m, axis=-1)
    for _ in range(2):  # the correction of tau moves the satellite by 1e-4 m; once more for good measure
        angle = EARTH_RATE_RADPS * flat / SPEED_OF_LIGHT_MPS
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = np.moveaxis(np.asarray(satellite_ecef_m), -1, 0)
        apart = np.stack([c * x + s * y, c * y - s * x, z], -1) - receiver_ecef_m
        flat = np.linalg.norm(apart, axis=-1)
    return flat, apart / flat[..., None]
