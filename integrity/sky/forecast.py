"""Forecast of the number of visible satellites along a street from a map of the city, as input of a planner.

The forecast is computed from the mapped city (:mod:`.survey`). It is separate from the mask that determines the
received signals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.sky.mask_kernel import count_free
from lanebound.integrity.sky.raytrace_kernel import free_rows
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import cell_centres, cells_of, distinct_antennas

__all__ = ["SkyForecast"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SkyForecast:
    """Cells of the sky without an obstacle, by station and lane.

    Attributes
    ----------
    free : (N, L, A E) bool; the cells are those of :class:`~lanebound.integrity.sky.visibility.SkyMask`
    azimuths, elevations : numbers of bins A over 2 pi and E over pi / 2
    spacing_m : distance between stations; station n lies at the arc ``n spacing_m``
    """

    free: NDArray[np.bool_]
    azimuths: int
    elevations: int
    spacing_m: float

    @classmethod
    def open(cls) -> SkyForecast:
        """The forecast of a sky without obstacles, for any street."""
        return cls(np.ones((1, 1, 1), dtype=np.bool_), 1, 1, 1.0)

    @classmethod
    def of_stations(
        cls,
        antenna_enu_m: ArrayLike,
        city: City,
        spacing_m: float = 5.0,
        az_step_deg: float = 3.0,
        el_step_deg: float = 3.0,
    ) -> SkyForecast:
        """Cast rays to the centre of every cell from antennas (N, L, 3) ENU [m] above the L lanes (S2 eq 1-2).

        Raises
        ------
        InputError
            Antennas are not finite or have another shape, a step does not divide the circle, or the spacing is out of
            range.
        """
        each, rows = distinct_antennas(antenna_enu_m)
        require_in_range("spacing_m", spacing_m, 0.0, 1e4, low_open=True)
        azimuths, elevations = cells_of(az_step_deg, el_step_deg)
        free = np.empty((each.shape[0], azimuths * elevations), dtype=np.bool_)
        cells = cell_centres(azimuths, elevations)
        run_rows(free_rows, each.shape[0], city.grid, each, cells, elevations, free, row_us=100.0)
        return cls(free[rows], azimuths, elevations, spacing_m)

    def in_sight(self, sky: SkyView) -> NDArray[np.bool_]:
        """Whether satellites are in line of sight above the mask angle at all stations and lanes, (N, L, S).

        The satellites are those of the first row of ``sky.index``.
        """
        row = int(sky.index[0])
        azimuth = np.floor(sky.azimuth_rad[row] * (self.azimuths / (2.0 * np.pi))).astype(np.int64) % self.azimuths
        elevation = np.floor(sky.elevation_rad[row] * (self.elevations / (0.5 * np.pi))).astype(np.int64)
        cell = azimuth * self.elevations + np.clip(elevation, 0, self.elevations - 1)
        return np.asarray(self.free[:, :, cell] & sky.above[row])

    def count(self, arc_m: Array, lane: NDArray[np.int64], sky: SkyView) -> NDArray[np.int64]:
        """Count the satellites in line of sight above the mask angle at D places, for the first row of ``sky.index``.

        arc_m (D,) [m], lane (D,) -> (D,). The nearest station is used; lanes are clamped to the existing ones.
        """
        row = int(sky.index[0])
        found: NDArray[np.int64] = count_free(
            self.free,
            arc_m,
            lane,
            sky.azimuth_rad[row],
            sky.elevation_rad[row],
            sky.above[row],
            self.spacing_m,
            self.azimuths,
            self.elevations,
        )
        return found
