"""What stands between a lane and the satellites: line of sight, foliage, a reflection, or nothing at all."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.sky.view import SkyView

__all__ = ["Path", "Reception", "SkyMask"]

Array = NDArray[np.float64]


class Path(IntEnum):
    """How a satellite's signal reaches the antenna."""

    LOS = 0
    FOLIAGE = 1
    REFLECTED = 2
    BLOCKED = 3


@dataclass(frozen=True)
class Reception:
    """How S signals reach B antennas.

    Attributes
    ----------
    path : (B, S) uint8, values of :class:`Path`
    excess_m : (B, S) extra path of the strongest one-bounce reflection, 0 for none. A LOS satellite with an excess
        has multipath; a REFLECTED one is received only by way of that detour.
    """

    path: NDArray[np.uint8]
    excess_m: Array


class SkyMask:
    """Precomputed reception by street position, lane and direction (filled in by the ray caster)."""

    @classmethod
    def open(cls) -> SkyMask:
        """A sky without obstacles."""
        return cls()

    def look(self, arc_m: ArrayLike, lane: ArrayLike, sky: SkyView) -> Reception:
        """Reception of vehicles at ``arc_m`` (B,), ``lane`` (B,)."""
        elevation = sky.elevation_rad[sky.index]
        path = np.where(elevation > 0.0, Path.LOS, Path.BLOCKED).astype(np.uint8)
        return Reception(path, np.zeros(elevation.shape))
