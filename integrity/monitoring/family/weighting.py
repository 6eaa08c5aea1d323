"""Deviations of codes: as given, by elevation, by C/N0, by both, by fitted classes, and by a map (S3 V-B1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, ShadowedUse, WeightKind
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.positioning.code_errors_kernel import LEAST_SINE

__all__ = ["weighted_codes"]

Array = NDArray[np.float64]

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
