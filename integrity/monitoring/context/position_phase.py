"""First phase of S5: weighted RAIM (Walter and Enge 1995), S5 equations 1 to 4.

``HPL = max_i slope_i T + k(P_MD) HDOP_w``, ``slope_i = |(K_1i, K_2i)| / sqrt(M_ii)``, K = (G'WG)^-1 G'W, W = R^-1,
M = W - W G K; the test statistic is sqrt(WSSE) = sqrt(y'M y), its threshold T = sqrt(chi2_{1 - P_FA}(m - n)). A bias b
of code i has the mean K_i b and raises WSSE by M_ii b^2. With a diagonal covariance R the slope is
``sigma_i |(K_1i, K_2i)| / sqrt(1 - P_ii)``, P = G K, as in Walter and Enge.

``k`` is two-sided, ``P(|z| > k) = P_MD``, as in the monitors of S3: the error has no preferred side.

S5 equation 2 lacks sigma_i, so that its slope is not in metres; ``printed_slope`` computes it nevertheless.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.monitoring.significance import two_sided_factor
from lanebound.integrity.positioning.code_solution import CodeFit

__all__ = ["PositionPhaseConfig", "PositionTest", "check_position", "raim_threshold"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class PositionPhaseConfig(Config):
    """Alert limit and risks of the first phase; S5 section 3.1."""

    alert_limit_m: float = Field(15.0, gt=0, description="horizontal alert limit [m]; S5, after Velaga 2012")
    false_alarm: float = Field(1e-3, gt=0, lt=1, description="P_FA of the WSSE test [-]; S5")
    missed_detection: float = Field(1e-5, gt=0, lt=1, description="P_MD of the protection level [-]; S5")
    printed_slope: bool = Field(
        False, description="slope without sigma_i, as printed in S5 eq 2 (not in metres); codes.covariance: diagonal"
    )


class PositionTest(NamedTuple):
    """Results of B vehicles: level_m (B,) inf without redundancy, statistic (B,), threshold (B,) inf without."""

    level_m: Array
    statistic: Array
    threshold: Array
    available: Bools
    consistent: Bools

    def rows(self, rows: slice | NDArray[np.int64]) -> PositionTest:
        """The results of some vehicles."""
        return PositionTest(
            self.level_m[rows], self.statistic[rows], self.threshold[rows], self.available[rows], self.consistent[rows]
        )

    @property
    def passed(self) -> Bools:
        """The level is within the alert limit, and the residuals are consistent."""
        return np.asarray(self.available & self.consistent)


def raim_threshold(redundancy: NDArray[np.int64], false_alarm: float) -> Array:
    """``T(N, P_FA) = sqrt(chi2_{1 - P_FA}(m - n))``; inf without redundancy.  (...,) -> (...,)."""
    table = _thresholds(false_alarm, int(redundancy.max(initial=0)))
    return table[np.maximum(redundancy, 0)]


@lru_cache(maxsize=64)
def _thresholds(false_alarm: float, most: int) -> Array:
    return np.concatenate([[np.inf], np.sqrt(chdtri(np.arange(1.0, most + 1), false_alarm))])


def check_position(codes: CodeFit, config: PositionPhaseConfig, hdop: Array | None = None) -> PositionTest:
    """Protection level and consistency of code positions; ``hdop`` (B,) in place of the weighted one."""
    slope = codes.slopes()
    if config.printed_slope:
        slope = slope * np.where(codes.used, np.sqrt(codes.weight), 1.0)
    threshold = raim_threshold(codes.df, config.false_alarm)
    tested = codes.solved & (codes.df > 0)
    worst = np.where(tested, slope.max(-1, initial=0.0), 0.0)
    spread = codes.hdop_m if hdop is None else hdop
    level = worst * np.where(tested, threshold, 0.0) + two_sided_factor(config.missed_detection) * spread
    level = np.where(tested, level, np.inf)
    statistic = np.sqrt(codes.wsse)
    return PositionTest(level, statistic, threshold, level <= config.alert_limit_m, statistic <= threshold)
