"""Satellite vectors over a whole drive: computed once at knots, interpolated at every epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_in_range
from lanebound.integrity.sky.constellation import SatelliteTable, SkyConfig
from lanebound.integrity.sky.track_kernel import sky_at
from lanebound.integrity.sky.view import SkyView

__all__ = ["SkyTrack"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SkyTrack:
    """Relative vectors and rates at equally spaced knots, with cubic Hermite interpolation between the knots.

    With knots 20 s apart the error of the interpolated range is 1e-5 m.

    Attributes
    ----------
    start_s, step_s : GPS time of the first knot, spacing of the knots
    offset_enu_m, rate_enu_mps : (N, S, 3)
    mask_rad : elevation mask of the views
    """

    start_s: float
    step_s: float
    offset_enu_m: Array
    rate_enu_mps: Array
    mask_rad: float
    system: NDArray[np.int64]
    prn: NDArray[np.int64]

    @classmethod
    def build(
        cls,
        satellites: SatelliteTable,
        start_s: float,
        duration_s: float,
        place_rad: tuple[float, float, float],
        mask_rad: float = 0.0,
        step_s: float = 20.0,
    ) -> SkyTrack:
        """Compute the track at one place (lat [rad], lon [rad], height [m]) from ``start_s`` for ``duration_s``.

        Satellites that never rise above the mask in this time are left out, which reduces S.

        Raises
        ------
        InputError
            Duration or step is not positive, or no satellite is above the mask.
        """
        require_in_range("duration_s", duration_s, 0.0, np.inf, low_open=True)
        require_in_range("step_s", step_s, 0.0, 120.0, low_open=True)
        knots = start_s + step_s * np.arange(int(np.ceil(duration_s / step_s)) + 1)
        used = satellites.rising(knots, *place_rad, mask_rad)
        if len(used) == 0:
            raise InputError(
                f"satellites must rise above {mask_rad} rad, got none of {len(satellites)}: lower the mask"
            )
        offset, rate = used.relative_enu(knots, *place_rad)
        return cls(float(start_s), float(step_s), offset, rate, float(mask_rad), used.system, used.prn)

    @classmethod
    def from_config(cls, config: SkyConfig, duration_s: float, step_s: float = 20.0) -> SkyTrack:
        """Compute the track of the nominal satellites of a configuration, from its start time for ``duration_s``."""
        return cls.build(config.satellites(), config.start_gps_s, duration_s, config.place_rad, config.mask_rad, step_s)

    @property
    def end_s(self) -> float:
        """GPS time of the last knot."""
        return self.start_s + self.step_s * float(self.offset_enu_m.shape[0] - 1)

    def at(self, gps_time_s: float, index: ArrayLike = 0) -> SkyView:
        """Interpolate the view at one time (K = 1); ``index`` is an array of zeros (B,), one for each vehicle.

        Raises
        ------
        InputError
            The time is outside the track.
        """
        place = (gps_time_s - self.start_s) / self.step_s
        last = self.offset_enu_m.shape[0] - 2
        if not 0.0 <= place <= last + 1.0:
            raise InputError(
                f"gps_time_s must lie in [{self.start_s}, {self.end_s}], got {gps_time_s}: build a longer track"
            )
        k = min(int(place), last)
        los, row, above = sky_at(self.offset_enu_m, self.rate_enu_mps, k, self.step_s, place - k, self.mask_rad)
        which = np.atleast_1d(np.asarray(index, dtype=np.int64))
        return SkyView(los, row[0], row[1], row[2], row[3], above, self.system, self.prn, which)
