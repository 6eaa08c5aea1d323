"""Importance sampling against counting, stratum by stratum, and against closed forms; the worst size of a fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from lanebound.integrity.assessment.exceedance import (
    ExceedanceCounts,
    FaultSize,
    Form,
    Prepared,
    draw_case,
    expected_fault_free,
    expected_one_fault,
    fault_chance,
    importance_rates,
    mean_and_deviation,
    prepare,
    tally,
    worst_fault,
)
from lanebound.integrity.monitoring.risk import RiskConfig, pair_risk

UNEVEN = RiskConfig(satellite_prior=(2e-3, 5e-4, 1e-3, 5e-4, 5e-4))
RISKS = [0.2, 0.02]  # large enough to be counted
FORMS = (Form.ROOT, Form.CLOSED)


@pytest.fixture(scope="module", params=[8, 9])
def case(request: pytest.FixtureRequest) -> Prepared:
    return prepare([draw_case(np.random.default_rng(request.param), 12, 0.5)], UNEVEN, RISKS)[0]


def counted_with(case: Prepared, prior: float, epochs: int, seed: int) -> ExceedanceCounts:
    """Counts of the case and its levels, where every satellite has a fault as often as ``prior`` says."""
    counted, common = ExceedanceCounts.empty(len(RISKS)), replace(case, prior=np.full(len(case.case), prior))
    tally(common, epochs, 0.0, np.random.default_rng(seed), counted)
    return counted


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("row", [0, 1])
def test_the_stratum_without_a_fault_is_the_counted_one(case: Prepared, form: Form, row: int) -> None:
    """Means differ by less than four standard deviations of both: two axes fail by chance once in 8,000 runs."""
    epochs, alone = 400_000, 1.0 - case.prior.sum()
    plain = counted_with(case, 1e-12, epochs, 4).misleading[form][row, :2, 0] / epochs
    rates, variances = importance_rates(case, form, row, 8000, np.random.default_rng(5))
    found, variance = rates[0] / alone, variances[0] / alone**2
    assert (np.abs(plain - found) < 4.0 * np.sqrt(variance + found / epochs)).all(), (plain, found)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("row", [0, 1])
def test_the_stratum_of_faults_is_the_counted_one(form: Form, row: int) -> None:
    """Sizes uniform in both, all satellites equally likely; every epoch counted here has a fault, and only one.

    Means differ by less than four standard deviations of both (two axes fail by chance once in 8,000 runs), which is
    less than a quarter of the rate: half of the faults' contribution, or twice, cannot pass.
    """
    rules = RiskConfig(satellite_prior=(1e-3,) * 5)
    case = prepare([draw_case(np.random.default_rng(8), 12, 0.5)], rules, RISKS)[0]
    counted = counted_with(case, 1.0 / 12.0, 1_000_000, 6)
    epochs = counted.epochs[1]
    rates, variances = importance_rates(case, form, row, 64_000, np.random.default_rng(7), FaultSize.UNIFORM)
    found, variance = rates[1] / case.prior.sum(), variances[1] / case.prior.sum() ** 2
    plain = counted.misleading[form][row, :2, 1] / epochs
    allowed = 4.0 * np.sqrt(variance + plain / epochs)
    assert (np.abs(plain - found) < allowed).all(), (plain, found)
    assert (allowed < 0.25 * plain).all(), (allowed, plain)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("row", [0, 1])
def test_faults_of_the_worst_size_are_as_frequent_as_drawn_plainly(case: Prepared, form: Form, row: int) -> None:
    """Every satellite has its fault and its prior; the same bounds and the same chance to fail as above."""
    level, rng, epochs = case.levels_m[form][row], np.random.default_rng(8), 40_000
    rates, variances = importance_rates(case, form, row, 64_000, np.random.default_rng(9))
    for axis in range(2):
        plain = square = 0.0
        for k, size in enumerate(worst_fault(case, axis, level[axis])[0]):
            normal = rng.standard_normal((epochs, len(case.case)))
            error = normal @ case.error_rows[axis] + case.shift[axis] + size * case.fault_error[k, axis]
            apart = normal @ case.test_rows.T + case.test_shift + size * case.fault_test[k]
            share = ((np.abs(error) > level[axis]) & (np.abs(apart) < case.threshold).all(-1)).mean()
            plain += case.prior[k] * share
            square += case.prior[k] ** 2 * share / epochs
        allowed = 4.0 * np.sqrt(variances[1, axis] + square)
        assert abs(plain - rates[1, axis]) < allowed, (plain, rates[1, axis])
        assert allowed < 0.25 * plain


@pytest.mark.parametrize("sizes", FaultSize)
def test_with_the_own_test_alone_the_closed_form_is_exact(sizes: FaultSize) -> None:
    """At 1e-7; fails by chance once in 8,000 runs. All tests together find no less."""
    case = prepare([draw_case(np.random.default_rng(6), 15, 0.5)], RiskConfig(), [1e-7])[0]
    rates, variances = importance_rates(case, Form.ROOT, 0, 64_000, np.random.default_rng(2), sizes)
    exact = expected_one_fault(case, Form.ROOT, sizes)[0]
    deviation = np.sqrt(variances[1])
    assert (rates[1] < exact + 4.0 * deviation).all()
    assert (rates[1] > 0.5 * exact).all()
    worst = max(range(15), key=lambda k: case.prior[k] * worst_fault(case, 0, case.levels_m[Form.ROOT][0, 0])[1][k])
    only = np.arange(15) == worst
    alone = replace(
        case,
        prior=case.prior * only,
        test_rows=case.test_rows * only[:, None],
        test_shift=case.test_shift * only,
        fault_test=case.fault_test * only,
    )
    rates, variances = importance_rates(alone, Form.ROOT, 0, 256_000, np.random.default_rng(3), sizes)
    exact = expected_one_fault(alone, Form.ROOT, sizes)[0]
    allowed = 4.0 * np.sqrt(variances[1])
    assert (np.abs(rates[1] - exact) < allowed).all()
    assert allowed[0] < 0.25 * exact[0]


@pytest.mark.parametrize("bias_share", [0.0, 2.0, 5.0])
def test_no_size_is_worse_than_the_worst(bias_share: float) -> None:
    rng = np.random.default_rng(11)
    drawn = [draw_case(rng, int(n), bias_share) for n in rng.integers(5, 36, 4)]
    for one in prepare(drawn, RiskConfig(satellite_prior=(1e-5,) * 5), [1e-3, 1e-7]):
        for (_, axis), level in np.ndenumerate(one.levels_m[Form.ROOT]):
            size, chance = worst_fault(one, axis, level)
            np.testing.assert_allclose(fault_chance(one, axis, level, size), chance)
            tried = rng.uniform(-40.0, 40.0, (len(size), 4000)) * one.sigma_of_fault_m[:, None]
            assert (fault_chance(one, axis, level, tried).max(-1) <= chance * (1.0 + 1e-4)).all()
            k = int(chance.argmax())

            def negative(f: float, k: int = k, axis: int = axis, level: float = level, one: Prepared = one) -> float:
                return -float(fault_chance(one, axis, level, np.full(len(one.case), f))[k])

            near = size[k] + 3.0 * one.sigma_of_fault_m[k] * np.array([-1.0, 1.0])
            best = minimize_scalar(negative, bounds=near, method="bounded", options={"xatol": 1e-12})
            assert chance[k] == pytest.approx(-best.fun, rel=1e-4)


def test_levels_keep_their_promise_for_a_fault_of_any_size() -> None:
    """In closed form, without a draw: no fault and the worst of each satellite stay within the budget of their axis."""
    rules, risks, wrong_fix = RiskConfig(satellite_prior=(1e-5,) * 5), [1e-3, 1e-5, 1e-7], 1e-8
    rng = np.random.default_rng(12)
    used = []
    for bias_share in (0.0, 0.5, 2.0, 5.0):
        drawn = [draw_case(rng, int(n), bias_share) for n in rng.integers(5, 36, 15)]
        for one in prepare(drawn, rules, risks, wrong_fix):
            budgets = rules.axis_budgets(risks, wrong_fix + float(pair_risk(one.prior)))
            for form in FORMS:
                share = (expected_fault_free(one, form) + expected_one_fault(one, form)) / budgets
                assert (share < 1.0).all(), (form, share)
            used.append(expected_one_fault(one, Form.CLOSED).max())
            assert (expected_one_fault(one, Form.ROOT) >= expected_one_fault(one, Form.ROOT, FaultSize.UNIFORM)).all()
            if bias_share == 0.0:
                root = (expected_fault_free(one, Form.ROOT) + expected_one_fault(one, Form.ROOT)) / budgets
                assert root.max() > 0.3  # and not by slack alone
    assert max(used) > 0.0


def test_without_a_level_nothing_can_exceed_it() -> None:
    case = prepare([draw_case(np.random.default_rng(5), 12, 0.5)], RiskConfig(satellite_prior=(0.1,) * 5), [1e-7])[0]
    assert np.isinf(case.levels_m[Form.ROOT]).all()
    assert expected_one_fault(case, Form.ROOT).tolist() == [[0.0, 0.0]]


def test_the_variance_that_importance_sampling_claims_is_its_own() -> None:
    """40 estimates at 1e-7: their spread over the claimed variance is chi-square; fails once in 10,000 runs."""
    case = prepare([draw_case(np.random.default_rng(6), 15, 0.5)], RiskConfig(), [1e-7])[0]
    rng = np.random.default_rng(7)
    found = [importance_rates(case, Form.ROOT, 0, 1024, rng) for _ in range(40)]
    rates, claimed = np.array([r.sum(0) for r, _ in found]), np.array([v.sum(0) for _, v in found])
    ratio = 39.0 * rates.var(0, ddof=1) / claimed.mean(0)
    assert (ratio > chi2.ppf(2.5e-5, 39)).all(), ratio
    assert (ratio < chi2.isf(2.5e-5, 39)).all(), ratio
    mean, between, draws = mean_and_deviation(list(rates), list(claimed))
    assert (draws < 0.2 * mean).all()
    np.testing.assert_allclose(between, draws, rtol=0.5)
    assert (mean < 0.5e-7).all()
