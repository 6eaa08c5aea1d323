"""Counting and importance sampling against closed forms and against each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

from lanebound.integrity.assessment.exceedance import (
    STRATA,
    Tally,
    expected_fault_free,
    importance_rates,
    least_fault_free,
    mean_and_deviation,
    tally,
)
from lanebound.integrity.assessment.measurement_model import Form, Prepared, draw_case, prepare
from lanebound.integrity.monitoring.risk import RiskConfig

RISKS = [0.2, 0.02]


def one_case(rules: RiskConfig, seed: int = 5, satellites: int = 9) -> Prepared:
    return prepare([draw_case(np.random.default_rng(seed), satellites, 0.5)], rules, RISKS)[0]


def test_counts_without_faults_and_without_a_test_are_binomial() -> None:
    """With a test that never speaks the rate is known; each count fails by chance once in 10,000 runs."""
    rules = RiskConfig(satellite_prior=(1e-12,) * 5, false_alarm=1e-14)
    case, counted = one_case(rules), Tally.empty(len(RISKS))
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
    case, counted = one_case(rules), Tally.empty(len(RISKS))
    tally(case, 50_000, 0.1, np.random.default_rng(2), counted)
    none, once = 0.98**9, 9 * 0.02 * 0.98**8
    share = np.array([0.9 * none, 0.9 * once, 0.9 * (1.0 - none - once), 0.1])
    statistic = ((counted.epochs - 50_000 * share) ** 2 / (50_000 * share)).sum()
    assert statistic < chi2.isf(1e-5, len(STRATA) - 1)
    assert counted.available[Form.ROOT].tolist() == [50_000, 50_000]


def test_faults_are_found_and_wrong_fixes_never() -> None:
    rules = RiskConfig(satellite_prior=(5e-3,) * 5, false_alarm=1e-4)
    case, counted = one_case(rules, satellites=20), Tally.empty(len(RISKS))
    tally(case, 20_000, 0.2, np.random.default_rng(3), counted)
    found = counted.alarms / counted.epochs
    assert found[1] > 0.2  # sizes up to twice the threshold: about half are found
    assert found[3] < 1e-2
    assert counted.misleading[Form.ROOT][:, 2, 3].min() > 0  # a wavelength of 19 cm is above the level


@pytest.mark.parametrize("row", [0, 1])
def test_importance_sampling_agrees_with_counting(row: int) -> None:
    """Means differ by less than four standard deviations of both."""
    rules = RiskConfig(satellite_prior=(1e-3,) * 5)
    case, counted = one_case(rules, seed=8, satellites=12), Tally.empty(len(RISKS))
    epochs = 400_000
    tally(case, epochs, 0.0, np.random.default_rng(4), counted)
    rate, variance = importance_rates(case, Form.ROOT, row, 20_000, np.random.default_rng(5))
    plain = counted.misleading[Form.ROOT][row, :2].sum(-1) / epochs
    away = np.abs(plain - rate) / np.sqrt(variance + plain / epochs)
    assert (away < 4.0).all(), (plain, rate)


def test_the_variance_that_importance_sampling_claims_is_its_own() -> None:
    """40 estimates at 1e-7: their spread over the claimed variance is chi-square; fails once in 10,000 runs."""
    case = prepare([draw_case(np.random.default_rng(6), 15, 0.5)], RiskConfig(), [1e-7])[0]
    rng = np.random.default_rng(7)
    found = [importance_rates(case, Form.ROOT, 0, 1024, rng) for _ in range(40)]
    rates, claimed = np.array([r for r, _ in found]), np.array([v for _, v in found])
    ratio = 39.0 * rates.var(0, ddof=1) / claimed.mean(0)
    assert (ratio > chi2.ppf(2.5e-5, 39)).all(), ratio
    assert (ratio < chi2.isf(2.5e-5, 39)).all(), ratio
    mean, between, draws = mean_and_deviation(list(rates), list(claimed))
    assert (draws < 0.2 * mean).all()
    np.testing.assert_allclose(between, draws, rtol=0.5)
    assert (mean < 0.5e-7).all()
