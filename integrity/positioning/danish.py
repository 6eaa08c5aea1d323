"""Danish re-weighting: measurements that do not fit lose their say, the worse the more (Krarup et al. 1980).

Weights are multiplied by ``exp(1 - (v/c)^2)`` where the normalised residual v is beyond c, and the solution is repeated
until it settles. Several outliers at once are thus met without naming them one by one; what remains is for fault
detection to judge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field

__all__ = ["DanishConfig", "variance_factor"]

Array = NDArray[np.float64]


class DanishConfig(Config):
    """When and how strongly a measurement loses weight."""

    threshold: float = Field(1.5, gt=0, description="normalised residual that keeps its full weight [-]; customary 1.5")
    largest_factor: float = Field(1e3, ge=1, description="largest factor on a variance [-]; keeps matrices regular")
    iterations: int = Field(12, ge=0, le=100, description="repetitions at most, 0 for none [-]")
    settled: float = Field(1e-2, gt=0, description="largest relative change of a factor at which to stop [-]")


def variance_factor(normalised: ArrayLike, config: DanishConfig) -> Array:
    """``min(exp((v/c)^2 - 1), largest)`` beyond c, else 1: what a variance is multiplied by.  (...,) -> (...,)."""
    ratio = np.minimum(np.abs(np.asarray(normalised, dtype=np.float64)) / config.threshold, 20.0)
    return np.where(ratio > 1.0, np.minimum(np.exp(ratio**2 - 1.0), config.largest_factor), 1.0)
