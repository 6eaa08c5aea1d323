"""Declared deviations of undifferenced codes and carriers, from the budget of all code positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.positioning.code_errors import CodeErrorBudget, CodeErrorParts
from lanebound.integrity.positioning.code_errors_kernel import LEAST_SINE
from lanebound.integrity.sensors.broadcast import change_rate

__all__ = ["CodeBudget"]

Array = NDArray[np.float64]

STRONG_DBHZ = 45.0


class CodeBudget(Config):
    """Deviations, 1 sigma, of codes, and of the change of carriers from step to step."""

    errors: CodeErrorBudget = Field(
        CodeErrorBudget(reflections_m=1.6),
        description="errors of codes; reflections with the RMS of all tracked codes in urban streets, seed 101: as "
        "faults of their priors alone they are too frequent",
    )
    carrier_m: float = Field(0.004, ge=0, description="noise and multipath of a carrier, zenith [m]; 3 and 2 mm")
    lasting_s: float = Field(1800.0, gt=0, description="correlation time of what changes slowly [s]; satellite clocks")
    coast_s: float = Field(30.0, ge=0, description="longest time over which steps of carriers add up [s]; as RRAIM")

    def code(self, elevation_rad: ArrayLike, cn0_dbhz: ArrayLike = STRONG_DBHZ) -> Array:
        """Deviation of a code.  (...,) [m]."""
        return np.asarray(np.sqrt(self._errors(elevation_rad, cn0_dbhz).variance_m2))

    def carrier_step(self, elevation_rad: ArrayLike, span_s: float) -> Array:
        """Deviation of the change of a carrier.  (...,) [m].

        Slow errors are smooth, of rate ``s 2.146 / tau``: their steps are alike and add up as they are, over n steps to
        n times one. Monitors add variances of steps. ``sqrt(t coast)`` in place of the time t of a step makes the sum
        of the variances of a coast that of the whole change. What changes at all elevations alike is in the clocks.
        """
        found, sine = self._errors(elevation_rad, STRONG_DBHZ), _sine(elevation_rad)
        slow = found.variance_m2 - found.fast_m2
        moved = change_rate(self.lasting_s) * np.sqrt(span_s * np.maximum(span_s, self.coast_s))
        return np.asarray(np.sqrt(moved**2 * slow + 2.0 * np.square(self.carrier_m / sine)))

    def _errors(self, elevation_rad: ArrayLike, cn0_dbhz: ArrayLike) -> CodeErrorParts:
        return self.errors.errors(_sine(elevation_rad), cn0_dbhz)


def _sine(elevation_rad: ArrayLike) -> Array:
    return np.maximum(np.sin(np.asarray(elevation_rad, dtype=np.float64)), LEAST_SINE)
