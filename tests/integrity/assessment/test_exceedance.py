"""Counting against closed forms."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom, chi2, norm

from lanebound.integrity.assessment.exceedance import (
    LARGEST_FAULT,
    STRATA,
    ExceedanceCounts,
    Form,
    Prepared,
    draw_case,
    expected_fault_free,
    fault_chance,
    least_fault_free,
    prepare,
    tally,
)
from lanebound.integrity.monitoring.risk import RiskConfig

RISKS = [0.2, 0.02]


def one_case(rules: RiskConfig, seed: int = 5, satellites: int = 9) -> Prepared:
    return prepare([draw_case(np.random.default_rng(seed), satellites, 0.5)], rules, RISKS)[0]


def test_counts_without_faults_and_without_a_test_are_binomial() -> None:
    """With a test that never speaks the rate is known; each count fails by chance once in 10,000 runs."""
    rules = RiskConfig(satellite_prior=(1e-12,) * 5, false_alarm=1e-14)
    case, counted = one_case(rules), ExceedanceCounts.empty(len(RISKS))
    tally(case, 60_000, 0.0, np.random.default_rng(1), counted)
    assert counted.epochs.tolist() == [60_000, 0, 0, 0]
    assert counted.alarms.sum() == 0
    for form in (Form.ROOT, Form.CLOSED, Form.PUBLISHED):
        chance = expected_fault_free(case, form)
        found = counted.misleading[form][:, :2, 0]
        low, high = binom.ppf(5e-5, 60_000, chance), binom.isf(5e-5, 60_000, chance)
        assert ((found >= low) & (found <= high)).all(), form
        assert (counted.misleading[form][:, 2, 0] >= found.max(-1)).all()


def test_the_least_level_uses_its_budget() -> None:
    case = one_case(RiskConfig())
    budgets = np.array([[0.1, 0.01], [1e-6, 1e-7]])
    levels = least_fault_free(case, budgets)
    sigma = np.linalg.norm(case.error_rows, axis=-1)
    found = norm.sf((levels - case.shift) / sigma) + norm.sf((levels + case.shift) / sigma)
    np.testing.assert_allclose(found, budgets, rtol=1e-9)


def test_strata_come_as_often_as_nature_has_them() -> None:
    rules = RiskConfig(satellite_prior=(0.02,) * 5)
    case, counted = one_case(rules), ExceedanceCounts.empty(len(RISKS))
    tally(case, 50_000, 0.1, np.random.default_rng(2), counted)
    none, once = 0.98**9, 9 * 0.02 * 0.98**8
    share = np.array([0.9 * none, 0.9 * once, 0.9 * (1.0 - none - once), 0.1])
    statistic = ((counted.epochs - 50_000 * share) ** 2 / (50_000 * share)).sum()
    assert statistic < chi2.isf(1e-5, len(STRATA) - 1)
    assert counted.available[Form.ROOT].tolist() == [50_000, 50_000]


def test_faults_are_found_and_wrong_fixes_never() -> None:
    rules = RiskConfig(satellite_prior=(5e-3,) * 5, false_alarm=1e-4)
    case, counted = one_case(rules, satellites=20), ExceedanceCounts.empty(len(RISKS))
    tally(case, 20_000, 0.2, np.random.default_rng(3), counted)
    found = counted.alarms / counted.epochs
    largest = LARGEST_FAULT * case.threshold * case.sigma_of_fault_m
    quiet = fault_chance(case, 0, 0.0, largest[:, None] * np.linspace(-1.0, 1.0, 2001)).mean()  # of any error
    assert 0.4 < quiet < 0.6  # sizes up to twice the threshold: about half are found
    assert counted.alarms[1] > binom.ppf(1e-4, counted.epochs[1], 1.0 - quiet)  # other satellites' tests find more
    assert found[3] < 1e-2
    assert counted.misleading[Form.ROOT][:, 2, 3].min() > 0  # a wavelength of 19 cm is above the level
