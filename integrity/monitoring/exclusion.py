"""Fault detection and exclusion: test, exclude the worst mode, test again (S1 3.1).

Significance levels of the global and the local test give their thresholds. Bonferroni splits one significance over the
local tests; Baarda's B-method (S1 3.1) lets both tests detect the same bias with the same power: the non-centrality
``lambda_0`` of the local test (df 1) is that of the global test (df).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import chdtrc, chdtri, chndtr, chndtrix, ndtri

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_probability
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.monitoring import detection_kernel as kernel
from lanebound.integrity.monitoring.detection import (
    Adjustment,
    ModeSeparation,
    TestResult,
    adjust,
    checked_modes,
    chi2_threshold,
    direction_test,
    global_test,
    mode_statistics,
    separate,
    separation_test,
    w_test,
)
from lanebound.integrity.monitoring.detection_kernel import FDE_RULES, LIMIT, Thresholds

__all__ = [
    "FdeConfig",
    "FdeOutcome",
    "FdeResult",
    "Linking",
    "Search",
    "ThresholdTables",
    "baarda_global_significance",
    "baarda_local_significance",
    "detect_and_exclude",
    "fde_parameters",
    "fde_thresholds",
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


Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


class FdeOutcome(Advice):
    """How fault detection and exclusion ended."""

    CLEAN = kernel.CLEAN, "no fault detected; the solution may be used"
    EXCLUDED = kernel.EXCLUDED, "faults were excluded and the rest agrees; the solution may be used"
    UNRESOLVED = kernel.UNRESOLVED, "a fault is present and could not be excluded; do not use the solution"
    NO_REDUNDANCY = kernel.NO_REDUNDANCY, "too few measurements to test; only the protection level guards"
    SINGULAR = kernel.SINGULAR, "geometry has no solution; wait for more satellites"


class Search(Enum):
    """Which test names the mode to exclude.

    ``w_test``  normalised residuals of each mode; ``separation``  solution separation along and across the track;
    ``direction``  in the direction of the maximum error. Separations are confirmed by normalised residuals.
    """

    W_TEST = "w_test"
    SEPARATION = "separation"
    DIRECTION = "direction"

    @property
    def code(self) -> int:
        """Its code in :mod:`.detection_kernel`."""
        return {"w_test": kernel.W_TEST, "separation": kernel.SEPARATION, "direction": kernel.DIRECTION}[self.value]


class FdeConfig(Config):
    """Significance, search and limits of the exclusion loop."""

    alpha: float = Field(0.01, gt=0, lt=1, description="probability of false alarm [-]; S1 section 4")
    linking: Linking = Field(
        Linking.BONFERRONI,
        description="relation of global and local significance; baarda_from_local makes the global false alarm large: "
        "5 % at 4 degrees of freedom, 26 % at 20 (alpha 0.01, power 0.8)",
    )
    power: float = Field(0.8, gt=0, lt=1, description="power of Baarda's B-method [-]; Baarda 1968")
    search: Search = Field(
        Search.SEPARATION,
        description="test that names the mode to exclude: separation along and across the track, in the direction of "
        "the maximum error, or normalised residuals (w_test)",
    )
    global_first: bool = Field(
        False,
        description="search only after the global test has failed; false keeps K_fa of the protection level exact",
    )
    max_excluded: int = Field(4, ge=0, description="fault modes excluded at most [-]; chosen: a third of an urban sky")
    min_redundancy: int = Field(1, ge=1, description="redundancy that an exclusion must leave for the re-test [-]")

    def tables(self, n_max: int) -> ThresholdTables:
        """Threshold tables for up to ``n_max`` rows; the separation test splits each local test over two axes."""
        axes = 2 if self.search is Search.SEPARATION else 1
        return threshold_tables(self.alpha, n_max, self.linking, self.power, axes)


def fde_parameters(config: FdeConfig, constellations: bool = False) -> Records:
    """FDE_RULES (1,) of :mod:`.detection_kernel`; ``constellations``: the rows of a constellation are a mode too."""
    return one_record(
        FDE_RULES,
        global_first=config.global_first,
        max_excluded=config.max_excluded,
        min_redundancy=config.min_redundancy,
        by_tests=config.linking is Linking.BONFERRONI,
        constellations=constellations,
        search=config.search.code,
    )


def fde_thresholds(config: FdeConfig, n_max: int, constellations: bool = False) -> Thresholds:
    """Thresholds of :mod:`.detection_kernel` for up to ``n_max`` rows, and as many constellations as there are groups.

    A normalised separation has the threshold ``Qinv(a / 4)`` (AT and CT), ``sqrt(chi2_{1-a}(rank Q_d))`` (direction) or
    ``sqrt(chi2_{1-a}(rank))`` (w-test) with the size a of one local test.
    """
    tables = config.tables(n_max + MAX_GROUPS)
    bonferroni = config.linking is Linking.BONFERRONI
    local = (tables.local_normal[-1] if bonferroni else tables.local_normal[:, -1]).copy()
    size = tables.local_significance[-1] if bonferroni else tables.local_significance[:, -1]
    factor, chi2 = np.repeat(local[:, None], 2, axis=1), np.full((1, 1), np.inf)
    if constellations:
        chi2 = chi2_threshold(np.where(size > 0.0, size, 0.5)[:, None], np.arange(n_max + 1))
        chi2[size <= 0.0] = np.inf
        ranks = {Search.SEPARATION: 0, Search.DIRECTION: 3, Search.W_TEST: n_max + 1}[config.search]
        if ranks:
            factor = np.sqrt(chi2[:, :ranks])
    limits = np.zeros(local.size, LIMIT)
    limits["overall"], limits["local"] = tables.global_chi2, local
    return Thresholds(limits, np.ascontiguousarray(factor), chi2)


@dataclass(frozen=True)
class FdeResult:
    """What remains after exclusion.

    Attributes
    ----------
    outcome : (...,) codes of :class:`FdeOutcome`.
    used : (..., m) rows kept; excluded : (..., k) modes excluded.
    overall : the last global test.
    worst : (...,) largest local statistic over its threshold among the modes kept, both squared.
    adjustment : the last adjustment.
    """

    outcome: Ints
    used: Bools
    excluded: Bools
    overall: TestResult
    worst: Array
    adjustment: Adjustment


def detect_and_exclude(
    config: FdeConfig,
    design: ArrayLike,
    covariance: ArrayLike,
    observation: ArrayLike,
    used: ArrayLike | None = None,
    *,
    modes: ArrayLike | None = None,
    heading_rad: ArrayLike = 0.0,
) -> FdeResult:
    """Global and local tests; exclude the mode largest above its threshold; repeat.

    Stops when nothing exceeds its threshold, nothing can be named, ``max_excluded`` is reached or an exclusion would
    leave less than ``min_redundancy``.  design (..., m, n), covariance (..., m, m), observation (..., m),
    used (..., m), modes (k, m) row sets (each row alone by default), heading_rad (...,).

    Raises
    ------
    InputError
        As :func:`~lanebound.integrity.monitoring.detection.adjust`.
    """
    state = adjust(design, covariance, observation, used)
    rows = state.used.copy()
    sets = checked_modes(modes, rows.shape[-1])
    excluded = np.zeros((*rows.shape[:-1], sets.shape[0]), dtype=np.bool_)
    tables = config.tables(max(rows.shape[-1], sets.shape[0]))
    while True:
        tests = _run_tests(config, tables, state, sets, heading_rad)
        hit = tests.choice & (excluded.sum(-1) < config.max_excluded)[..., None]
        if not hit.any():
            break
        excluded |= hit
        rows &= ~(hit[..., None] & sets).any(-2)
        state = adjust(design, covariance, observation, rows)
    return FdeResult(_outcome(state, tests.detected, excluded), rows, excluded, tests.overall, tests.worst, state)


@dataclass(frozen=True)
class _Tests:
    """One round: the global test, whether anything failed (...,), and the mode to exclude (..., k), at most one."""

    overall: TestResult
    worst: Array
    detected: Bools
    choice: Bools


def _run_tests(
    config: FdeConfig, tables: ThresholdTables, state: Adjustment, sets: Bools, heading_rad: ArrayLike
) -> _Tests:
    separation = separate(state, sets)
    df, count = np.clip(state.df, 0, None), separation.n_modes
    overall = global_test(state, tables.global_significance[df])
    size = np.where(df >= 1, tables.local_significance[df, count], 0.5)
    confirmed = w_test(state, size, sets)
    rank = mode_statistics(state, sets)[1]
    testable = separation.monitored & (rank >= 1) & (df >= 1)[..., None]
    suspected = np.where(testable, _suspicion(config.search, separation, confirmed, heading_rad, size), 0.0)
    excess = np.minimum(suspected, confirmed.excess)
    detected = overall.failed | ((suspected >= 1.0).any(-1) & (not config.global_first))
    best = excess.argmax(-1)[..., None]
    possible = np.take_along_axis((excess >= 1.0) & (df[..., None] - rank >= config.min_redundancy), best, -1)
    choice = detected[..., None] & possible & (np.arange(sets.shape[0]) == best)
    return _Tests(overall, suspected.max(-1, initial=0.0), detected, choice)


def _suspicion(
    search: Search, separation: ModeSeparation, confirmed: TestResult, heading_rad: ArrayLike, size: Array
) -> Array:
    """Squared statistic over squared threshold of each mode (..., k), in the test that names the mode."""
    if search is Search.SEPARATION:
        return np.asarray(separation_test(separation, heading_rad, size, 1).excess.max(-1) ** 2)
    if search is Search.DIRECTION:
        return direction_test(separation, size, 1).excess
    return confirmed.excess


def _outcome(state: Adjustment, detected: Bools, excluded: Bools) -> Ints:
    cases = [~state.solvable, detected, state.df < 1, excluded.any(-1)]
    found = [FdeOutcome.SINGULAR, FdeOutcome.UNRESOLVED, FdeOutcome.NO_REDUNDANCY, FdeOutcome.EXCLUDED]
    return np.select(cases, [outcome.code for outcome in found], FdeOutcome.CLEAN.code).astype(np.int64)
