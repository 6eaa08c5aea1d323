"""Significance levels of the global and the local test, how they hang together, and the thresholds they give.

Bonferroni splits one significance over the local tests; Baarda's B-method (S1 3.1) lets both tests detect the same bias
with the same power: the non-centrality ``lambda_0`` of the local test (df 1) is that of the global test (df).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, chndtr, chndtrix, ndtri

from lanebound.integrity.core.errors import InputError, require_probability

__all__ = [
    "Linking",
    "ThresholdTables",
    "baarda_global_significance",
    "baarda_local_significance",
    "noncentrality",
    "significances",
    "threshold_tables",
    "two_sided_factor",
]

Array = NDArray[np.float64]


class Linking(Enum):
    """How the local significance follows from the configured one, or the global from the local.

    ``bonferroni``  global test at alpha, each of m local tests at alpha / m; ``baarda_from_global``  global test at
    alpha, local tests with the same power for the same bias; ``baarda_from_local``  the other way round.
    """

    BONFERRONI = "bonferroni"
    BAARDA_FROM_GLOBAL = "baarda_from_global"
    BAARDA_FROM_LOCAL = "baarda_from_local"


@lru_cache(maxsize=4096)
def noncentrality(significance: float, power: float, df: int = 1) -> float:
    """``lambda_0`` for which a chi-square test of size alpha has power gamma.

    ``F(chi2_{1-alpha}(df); df, lambda_0) = 1 - gamma`` with F the non-central chi-square distribution.
    Baarda (1968): 17.07 for alpha 0.001, gamma 0.80, df 1.

    Raises
    ------
    InputError
        A probability outside (0, 1), df < 1, or a power not above the significance.
    """
    alpha, gamma = require_probability("significance", significance), require_probability("power", power)
    if df < 1:
        raise InputError(f"df must be >= 1, got {df}: without redundancy there is no test")
    if gamma <= alpha:
        raise InputError(
            f"power must be > significance = {alpha}, got {gamma}: a test of no use has that power already"
        )
    from scipy.optimize import brentq  # a sixth of a second at each start, which few need

    critical = float(chdtri(df, alpha))
    high = 1.0
    while chndtr(critical, df, high) > 1.0 - gamma:
        high *= 2.0
    return float(brentq(lambda lam: chndtr(critical, df, lam) - (1.0 - gamma), 0.0, high, xtol=1e-12, rtol=1e-14))


@lru_cache(maxsize=4096)
def baarda_global_significance(local_significance: float, power: float, df: int) -> float:
    """Size of the global test with df that has the power of the local test for the same bias (B-method)."""
    return _same_power(noncentrality(local_significance, power, 1), power, df)


@lru_cache(maxsize=4096)
def baarda_local_significance(global_significance: float, power: float, df: int) -> float:
    """Size of the local test that has the power of the global test with df for the same bias: the inverse."""
    return _same_power(noncentrality(global_significance, power, df), power, 1)


def _same_power(lambda0: float, power: float, df: int) -> float:
    """Size of the chi-square test with df that has ``power`` at non-centrality ``lambda0``."""
    return float(chdtrc(df, chndtrix(1.0 - power, df, lambda0)))


def significances(alpha: float, df: int, tests: int, linking: Linking, power: float) -> tuple[float, float]:
    """Sizes of the global test and of each local test at redundancy ``df`` with ``tests`` local tests."""
    if linking is Linking.BONFERRONI:
        return alpha, alpha / tests
    if linking is Linking.BAARDA_FROM_GLOBAL:
        return alpha, baarda_local_significance(alpha, power, df)
    return baarda_global_significance(alpha, power, df), alpha


def two_sided_factor(probability: ArrayLike) -> Array:
    """``k`` with ``P(|z| > k) = p`` of a normal z.  (...,) -> (...,)."""
    return np.asarray(-ndtri(0.5 * np.asarray(probability, dtype=np.float64)))


@dataclass(frozen=True)
class ThresholdTables:
    """Thresholds looked up by redundancy and number of local tests; ``inf`` where there is nothing to test.

    Attributes
    ----------
    global_chi2 : (N + 1,) threshold of the global statistic at df.
    global_significance : (N + 1,) its size.
    local_normal : (N + 1, N + 1) threshold of a normalised local statistic at [df, tests].
    local_significance : (N + 1, N + 1) size of one local test at [df, tests], all axes together.
    """

    global_chi2: Array
    global_significance: Array
    local_normal: Array
    local_significance: Array


@lru_cache(maxsize=64)
def threshold_tables(
    alpha: float, n_max: int, linking: Linking = Linking.BONFERRONI, power: float = 0.8, axes: int = 1
) -> ThresholdTables:
    """Threshold tables up to ``n_max`` rows: ``chi2_{1-a}(df)`` and ``Qinv(a_local / (2 axes))``.

    ``axes`` is 1 for the w-test and 2 for the AT/CT separation test, which tests each mode twice (S2 eq 8). The arrays
    are cached and read-only.

    Raises
    ------
    InputError
        ``alpha`` outside (0, 1), ``n_max`` or ``axes`` below 1.
    """
    require_probability("alpha", alpha)
    if n_max < 1 or axes < 1:
        raise InputError(f"n_max and axes must be >= 1, got {n_max} and {axes}: count the rows and the axes")
    local = np.zeros((n_max + 1, n_max + 1))
    overall = np.full(n_max + 1, alpha)
    for df in range(1, n_max + 1):
        overall[df], first = significances(alpha, df, 1, linking, power)
        local[df, 1:] = first / np.arange(1, n_max + 1) if linking is Linking.BONFERRONI else first
    chi2 = np.full(n_max + 1, np.inf)
    chi2[1:] = chdtri(np.arange(1, n_max + 1), overall[1:])
    tables = ThresholdTables(chi2, overall, -ndtri(local / (2.0 * axes)), local)
    for table in vars(tables).values():
        table.setflags(write=False)
    return tables
