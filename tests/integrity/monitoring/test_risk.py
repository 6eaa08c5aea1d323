"""Factors against printed values and enumeration; the rules as configuration."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_closed_form import missed_detection_factor, mode_shares
from scipy.stats import norm

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.protection_kernel import q_inverse
from lanebound.integrity.monitoring.risk import (
    RiskConfig,
    Variant,
    direction_factor,
    false_alarm_factor,
    multiple_fault_risk,
    pair_risk,
    upper_quantile,
)


@pytest.mark.parametrize(("risk", "factor"), [(1e-3, 3.2905267315), (1e-5, 4.4171734135), (1e-7, 5.3267238864)])
def test_two_sided_factors(risk: float, factor: float) -> None:
    """Two-sided normal quantiles; the last is K_V = 5.33 of RTCA DO-229."""
    assert missed_detection_factor(risk, 1.0, 2.0) == pytest.approx(factor, abs=1e-9)


def test_false_alarm_factor_of_the_araim_example() -> None:
    """WG-C ARAIM ADD v3.1 appendix D: K_fa = Qinv(3.9e-6 / (2 12)) = 5.1083, one axis, the published division."""
    assert false_alarm_factor(3.9e-6, 12, Variant.PUBLISHED) == pytest.approx(5.1083, abs=1e-4)
    assert false_alarm_factor(9e-8, 12) == pytest.approx(5.894859640911244, abs=1e-9)


def test_exact_false_alarm_factor_is_the_tests_own_threshold() -> None:
    """Two sides of two axes of n modes share alpha, so the union bound is met with equality."""
    k = false_alarm_factor(0.01, np.arange(1, 40))
    np.testing.assert_allclose(np.arange(1, 40) * 2 * 2 * norm.sf(k), 0.01, rtol=1e-12)
    assert (false_alarm_factor(0.01, np.arange(1, 40), Variant.PUBLISHED) < k).all()
    assert false_alarm_factor(0.01, 0) == 0.0


def test_direction_factor_of_rank_one_is_two_sided() -> None:
    np.testing.assert_allclose(direction_factor(0.01, [5, 10], 1), norm.isf(0.01 / (2 * np.array([5, 10]))))
    assert RiskConfig(direction_test=True).false_alarm_factors(3)[3] == pytest.approx(norm.isf(0.01 / 6))


@pytest.mark.parametrize("share0", [0.0, 0.3])
def test_shares_sum_to_one(share0: float) -> None:
    for n in (1, 2, 30):
        assert mode_shares(n, share0).sum() == pytest.approx(1.0, abs=1e-14)


def test_factors_of_exhausted_and_unneeded_budgets() -> None:
    k = missed_detection_factor([1e-5, -1.0, 1e-5, 1e-5], 1.0, [1e-5, 1e-5, 1e-7, 0.0])
    assert k.tolist() == [-np.inf, np.inf, -np.inf, -np.inf]


def test_multiple_faults_by_enumeration() -> None:
    priors = np.array([0.1, 0.02, 0.3, 0.05])
    expected = sum(
        np.prod(np.where(np.array(s), priors, 1.0 - priors)) for s in product([0, 1], repeat=4) if sum(s) >= 2
    )
    assert multiple_fault_risk(priors) == pytest.approx(expected, rel=1e-12)


def test_multiple_faults_of_the_araim_example() -> None:
    """Ten satellites of 1e-5, two constellations of 1e-4: 3.4496e-8 not monitored."""
    priors = np.array([1e-5] * 10 + [1e-4] * 2)
    assert multiple_fault_risk(priors) == pytest.approx(3.449595977898963e-08, rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(p=st.floats(1e-9, 1e-2), n=st.integers(1, 40))
def test_pair_bound_is_safe_and_tight(p: float, n: int) -> None:
    priors = np.full(n, p)
    exact, bound = float(multiple_fault_risk(priors)), float(pair_risk(priors))
    assert exact * (1 - 1e-9) <= bound <= exact * (1.0 + n * p) + 1e-30 or n == 1


def test_kernel_quantile() -> None:
    p = np.concatenate([10.0 ** -np.linspace(0.31, 14.0, 300), 1.0 - 10.0 ** -np.linspace(0.31, 8.0, 50)])
    np.testing.assert_allclose([q_inverse(x) for x in p], norm.isf(p), atol=1e-11)
    assert q_inverse(0.0) == np.inf
    assert q_inverse(1.0) == -np.inf
    assert q_inverse(0.5) == pytest.approx(0.0, abs=1e-11)
    assert upper_quantile([0.0, 1.0, 2.0, -1.0]).tolist() == [np.inf, -np.inf, -np.inf, np.inf]


def test_budgets_are_split_and_reduced() -> None:
    config = RiskConfig(integrity_risk=1e-4, at_share=0.25)
    np.testing.assert_allclose(config.axis_budgets(), [[2.5e-5, 7.5e-5]])
    np.testing.assert_allclose(config.axis_budgets([1e-3, 1e-5], [2e-5]), [[[2.45e-4, 7.35e-4], [-2.5e-6, -7.5e-6]]])


def test_rules_are_checked_and_travel_as_json() -> None:
    config = RiskConfig(variant=Variant.PUBLISHED, constellation_prior=(1e-4,) * 5)
    assert RiskConfig.from_json(config.to_json()) == config
    assert config.monitors_constellations
    assert config.priors()[1].tolist() == [1e-4] * 5 + [0.0] * 3
    with pytest.raises(ConfigError, match="integrity_risk"):
        RiskConfig(integrity_risk=0.0)
    with pytest.raises(ConfigError, match="satellite_prior"):
        RiskConfig(satellite_prior=(1e-5, 2.0, 1e-5, 1e-5, 1e-5))
    with pytest.raises(InputError, match="risks"):
        config.axis_budgets([1.5])
