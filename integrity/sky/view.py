"""Satellite directions and ranges from one street, shared by all vehicles of the street."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.mask_kernel import SatelliteRows

__all__ = ["SkyView"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SkyView:
    """Directions and ranges of S satellites at K epochs (or places), shared by B vehicles.

    The line of sight is computed at the origin of the street: the wavefront is assumed plane over a street. The error
    of the direction is baseline over range, 5e-5 rad per km.

    Attributes
    ----------
    los_enu : (K, S, 3) unit vectors from receiver to satellite
    elevation_rad, azimuth_rad : (K, S), azimuth clockwise from North in [0, 2 pi)
    range_m : (K, S) geometric range
    range_rate_mps : (K, S) range rate due to the motion of the satellite, positive if the range increases
    above : (K, S) whether the elevation is above the mask angle
    system, prn : (S,)
    index : (B,) the row k that each vehicle uses
    """

    los_enu: Array
    elevation_rad: Array
    azimuth_rad: Array
    range_m: Array
    range_rate_mps: Array
    above: NDArray[np.bool_]
    system: NDArray[np.int64]
    prn: NDArray[np.int64]
    index: NDArray[np.int64]

    @property
    def batch(self) -> int:
        """Number of vehicles B."""
        return int(self.index.shape[0])

    @property
    def satellites(self) -> int:
        """Number of satellites S, in view or not."""
        return int(self.system.shape[0])

    @property
    def rows(self) -> SatelliteRows:
        """The arrays as kernels take them."""
        return SatelliteRows(self.los_enu, self.elevation_rad, self.azimuth_rad, self.above, self.system)
