"""Deviations of codes: as given, by elevation, by C/N0, by both, by fitted classes, and by a map (S3 V-B1).

Declared deviations of undifferenced codes and carriers follow from the budget of all code positions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, ShadowedUse, WeightKind
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.positioning.code_errors import CodeErrorBudget, CodeErrorParts
from lanebound.integrity.positioning.code_errors_kernel import LEAST_SINE
from lanebound.integrity.sensors.broadcast import change_rate

__all__ = ["CodeBudget", "weighted_codes"]

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


REFERENCE_DBHZ = 45.0
LIMITS_M = (0.1, 1e3)


def weighted_codes(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """The epochs with the deviations that a monitor assumes; shadowed codes have less weight or none.

    ``sigma = s / sin E``, ``sigma^2 = s^2 10^((45 - C/N0) / 10)``, or both factors together, with s = ``code_sigma_m``.

    Raises
    ------
    InputError
        A map is asked for, and the epochs have no prediction.
    """
    out = epochs
    if config.weights is WeightKind.CLASSES:
        assert config.classes is not None  # validated
        centre, sigma = config.classes.at(epochs.cn0_dbhz, epochs.elevation_rad, epochs.shadowed)
        out = CodeEpochs(**{**vars(epochs), "y_m": epochs.y_m - np.where(epochs.used, centre, 0.0), "sigma_m": sigma})
    elif config.weights is not WeightKind.GIVEN:
        out = epochs.with_codes(sigma_m=_model(epochs, config))
    if config.shadowed is ShadowedUse.KEEP:
        return out
    if epochs.shadowed is None:
        raise InputError("shadowed must be predicted by a map, got None: use epochs with a map, or shadowed 'keep'")
    if config.shadowed is ShadowedUse.EXCLUDE:
        return out.with_codes(used=out.used & ~epochs.shadowed)
    return out.with_codes(sigma_m=out.sigma_m * np.where(epochs.shadowed, config.shadowed_factor, 1.0))


def _model(epochs: CodeEpochs, config: FamilyMonitorConfig) -> Array:
    sine = np.maximum(np.sin(np.where(epochs.used, epochs.elevation_rad, 1.0)), LEAST_SINE)
    cn0 = np.where(epochs.used, epochs.cn0_dbhz, REFERENCE_DBHZ)
    strength = 10.0 ** (0.05 * (REFERENCE_DBHZ - cn0))
    factor = {
        WeightKind.ELEVATION: 1.0 / sine,
        WeightKind.CN0: strength,
        WeightKind.ELEVATION_CN0: strength / sine,
    }[config.weights]
    return np.asarray(np.clip(config.code_sigma_m * factor, *LIMITS_M))
