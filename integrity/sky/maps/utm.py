"""Universal transverse Mercator grids: their places on the Earth, and the angle between grid north and north.

Krüger's series in the third flattening n up to n^4: C. F. F. Karney, Transverse Mercator with an accuracy of a few
nanometers, J. Geodesy 85, 2011, eq 7 to 14, 36.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, atanh, cos, cosh, degrees, hypot, sin, sinh, sqrt

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import WGS84_A_M, WGS84_E2
from lanebound.integrity.sky.maps.records import MapFrame

__all__ = ["Utm"]

Array = NDArray[np.float64]

SCALE = 0.9996
FALSE_EAST_M, FALSE_NORTH_M = 500_000.0, 10_000_000.0
FLATTENING = 1.0 - sqrt(1.0 - WGS84_E2)
N = FLATTENING / (2.0 - FLATTENING)
RECTIFYING_M = WGS84_A_M / (1.0 + N) * (1.0 + N**2 / 4.0 + N**4 / 64.0)  # eq 14
BETA = (  # eq 36
    N / 2 - 2 * N**2 / 3 + 37 * N**3 / 96 - N**4 / 360,
    N**2 / 48 + N**3 / 15 - 437 * N**4 / 1440,
    17 * N**3 / 480 - 37 * N**4 / 840,
    4397 * N**4 / 161280,
)
STEP_M = 10.0  # by which the angle of the grid is found
NEWTON_STEPS = 5


@dataclass(frozen=True)
class Utm:
    """A zone of the grid.

    Attributes
    ----------
    zone : 1 to 60
    south : whether it is one of the southern half
    """

    zone: int
    south: bool = False

    @classmethod
    def of_epsg(cls, code: int | None) -> Utm | None:
        """The zone of an EPSG code: 326zz and 327zz (WGS 84), 258zz (ETRS89); None for others."""
        series, zone = divmod(code or 0, 100)
        known = {326: (1, 60), 327: (1, 60), 258: (28, 38)}.get(series)
        return cls(zone, series == 327) if known and known[0] <= zone <= known[1] else None

    def lat_lon_of(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Latitude and longitude of a place of the grid [deg]."""
        xi = (north_m - (FALSE_NORTH_M if self.south else 0.0)) / (SCALE * RECTIFYING_M)
        eta = (east_m - FALSE_EAST_M) / (SCALE * RECTIFYING_M)
        x = xi - sum(b * sin(2 * j * xi) * cosh(2 * j * eta) for j, b in enumerate(BETA, 1))
        y = eta - sum(b * cos(2 * j * xi) * sinh(2 * j * eta) for j, b in enumerate(BETA, 1))
        wanted = sin(x) / hypot(sinh(y), cos(x))  # tangent of the conformal latitude, eq 18
        e, tau = sqrt(WGS84_E2), wanted
        for _ in range(NEWTON_STEPS):  # eq 19 to 21
            root = hypot(1.0, tau)
            sigma = sinh(e * atanh(e * tau / root))
            found = tau * hypot(1.0, sigma) - sigma * root
            step = (wanted - found) / hypot(1.0, found) * (1.0 + (1.0 - WGS84_E2) * tau * tau)
            tau += step / ((1.0 - WGS84_E2) * root)
        return degrees(atan2(tau, 1.0)), 6.0 * self.zone - 183.0 + degrees(atan2(sinh(y), cos(x)))

    def frame_at(self, en_m: Array) -> tuple[MapFrame, Array]:
        """The frame at a place (2,) of the grid, and the matrix (2, 2) from steps of the grid to East, North."""
        east, north = (float(v) for v in en_m)
        frame = MapFrame(*self.lat_lon_of(east, north))
        ends = [self.lat_lon_of(east + STEP_M, north), self.lat_lon_of(east, north + STEP_M)]
        return frame, np.stack([frame.en_of(*end) for end in ends], -1) / STEP_M
