"""Declared deviations of undifferenced codes and carriers, by elevation (S3 Table III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.sensors.broadcast import change_rate, mapping, obliquity

__all__ = ["CodeBudget"]

Array = NDArray[np.float64]

LEAST_SINE = 0.05


class CodeBudget(Config):
    """Deviations, 1 sigma, of what broadcast ephemerides and models leave, and of the receiver at the zenith."""

    satellite_m: float = Field(1.6, ge=0, description="ephemeris and clock [m]; S3 Table III, 1.1 each")
    zenith_iono_m: float = Field(2.5, ge=0, description="vertical ionosphere after the model [m]; half of 5 m by day")
    zenith_tropo_m: float = Field(0.12, ge=0, description="zenith troposphere after the model [m]; DO-229 A.4.2.4")
    code_m: float = Field(0.22, ge=0, description="noise and multipath of a code, zenith [m]; 0.15 m each")
    carrier_m: float = Field(0.004, ge=0, description="noise and multipath of a carrier, zenith [m]; 3 and 2 mm")
    lasting_s: float = Field(1800.0, gt=0, description="correlation time of what changes slowly [s]; satellite clocks")
    coast_s: float = Field(30.0, ge=0, description="longest time over which steps of carriers add up [s]; as RRAIM")

    def code(self, elevation_rad: ArrayLike) -> Array:
        """Deviation of a code.  (...,) [m]."""
        sine = _sine(elevation_rad)
        slow = self.satellite_m**2 + np.square(self.zenith_iono_m * obliquity(sine))
        return np.asarray(
            np.sqrt(slow + np.square(self.zenith_tropo_m * mapping(sine)) + np.square(self.code_m / sine))
        )

    def carrier_step(self, elevation_rad: ArrayLike, span_s: float) -> Array:
        """Deviation of the change of a carrier.  (...,) [m].

        Slow errors are smooth, of rate ``s 2.146 / tau``: their steps are alike and add up as they are, over n steps to
        n times one. Monitors add variances of steps. ``sqrt(t coast)`` in place of the time t of a step makes the sum
        of the variances of a coast that of the whole change.
        """
        sine = _sine(elevation_rad)
        slow = self.satellite_m**2 + np.square(self.zenith_iono_m * obliquity(sine))
        slow = slow + np.square(self.zenith_tropo_m * mapping(sine))
        time = np.sqrt(span_s * np.maximum(span_s, self.coast_s))
        moved = change_rate(self.lasting_s) * time
        return np.asarray(np.sqrt(moved**2 * slow + 2.0 * np.square(self.carrier_m / sine)))


def _sine(elevation_rad: ArrayLike) -> Array:
    return np.maximum(np.sin(np.asarray(elevation_rad, dtype=np.float64)), LEAST_SINE)
