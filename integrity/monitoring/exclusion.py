"""Fault detection and exclusion: test, exclude the worst mode, test again (S1 3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.config import Config, Field
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
from lanebound.integrity.monitoring.significance import Linking, ThresholdTables, threshold_tables

__all__ = ["FdeConfig", "FdeOutcome", "FdeResult", "Search", "detect_and_exclude", "fde_parameters", "fde_thresholds"]

Array = NDArray[np.float64]


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
