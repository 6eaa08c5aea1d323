"""The one error budget of code positions: against hand computation, and against the errors of simulated signals.

Ratios are the RMS of error over declared deviation of East and North, of 200 vehicles in areas of their own under an
open sky. 400 values have a standard error of 3.5 %: a ratio 20 % inside a bound fails by chance once in 10^8 seeds. A
factor of 2 in the deviation is beyond the bounds, wherever they are not wider than 0.7 to 1.4.
"""

from __future__ import annotations

import numpy as np
import pytest
from code_ratios import EXACT, horizontal_ratio, ratio_of, service_solutions, truths

from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, code_fix
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.navigators.monitored_codes import MonitoredCodesConfig, code_epochs
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services.code_kernel import largest_mean
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.code_errors_kernel import multipath_time
from lanebound.integrity.positioning.filters.code_position import CodePositionConfig, locate_by_codes
from lanebound.integrity.sensors.broadcast import mapping, obliquity

OPEN = {"errors": {"reflections_m": 0.0}}
BATCH = 200


def test_the_parts_of_a_code_at_30_degrees_by_hand() -> None:
    budget = CodeErrorBudget(reflections_m=0.5)
    found = budget.errors(np.array([1.0, 0.5]), 35.0)  # at the knee C/N0 doubles the variance
    clear = 0.15**2 + 0.15**2 + 0.5**2
    np.testing.assert_allclose(found.factor, [2.0, 5.0])
    np.testing.assert_allclose(found.fast_m2, clear * np.array([2.0, 5.0]))
    slant, mapped = obliquity(np.array([1.0, 0.5])), mapping(np.array([1.0, 0.5]))
    np.testing.assert_allclose(found.own_m2, 1.56**2 + 0.2 * 2.5**2 * slant**2, rtol=1e-12)
    common = np.stack([np.sqrt(0.8) * 2.5 * (slant - 1.0), 0.12 * (mapped - 1.0)], -1)
    np.testing.assert_allclose(found.common_m, common, atol=1e-12)
    np.testing.assert_allclose(found.variance_m2, found.fast_m2 + found.own_m2 + (common**2).sum(-1))


@pytest.mark.parametrize(
    ("service", "low", "high"),
    [
        ("spp", 0.7, 1.0),
        ("dgps", 0.7, 1.0),
        ("sbas_l1", 0.85, 1.15),
        ("sbas_dfmc", 0.5, 0.8),  # the simulated multipath of both bands is the same, the budget's is independent
        ("ppp", 0.45, 0.75),  # the same, and a second of smoothing
    ],
)
def test_services_declare_the_errors_of_an_open_sky(monkeypatch, service: str, low: float, high: float) -> None:
    """Budgets without reflections, providers that declare what they have."""
    fit, truth = service_solutions(monkeypatch, service, BATCH, services={service: OPEN}, gnss={"augmentation": EXACT})
    assert fit.solved.mean() > 0.95
    assert low < horizontal_ratio(fit, truth) < high


@pytest.mark.parametrize(
    ("service", "low", "high"),
    [("spp", 0.6, 0.8), ("dgps", 0.15, 0.24), ("sbas_l1", 0.28, 0.42), ("sbas_dfmc", 0.14, 0.21), ("ppp", 0.1, 0.16)],
)
def test_defaults_of_services_are_wider_by_what_they_say(monkeypatch, service: str, low: float, high: float) -> None:
    """Reflections (1 m, of two bands 0.8 m), which an open sky has not, and UDRE and GIVE of 2 times the residuals."""
    fit, truth = service_solutions(monkeypatch, service, BATCH)
    assert low < horizontal_ratio(fit, truth) < high


@pytest.mark.parametrize(("speed_mps", "low", "high"), [(10.0, 0.4, 0.65), (0.0, 0.35, 0.6)])
def test_smoothed_codes_are_declared_by_the_longest_correlation(monkeypatch, speed_mps, low, high) -> None:
    """10 s are declared, 3 s are simulated, 300 s are declared at rest; an infinite time would give 0.25 and less."""
    changes = {"services": {"dgps": {**OPEN, "smoothing_s": 100.0}}, "gnss": {"augmentation": EXACT}}
    fit, truth = service_solutions(monkeypatch, "dgps", 60, 301, speed_mps, **changes)
    assert low < horizontal_ratio(fit, truth) < high


@pytest.fixture(scope="module")
def open_sky():
    """Undifferenced measurements of an epoch, and the truth."""
    config = NavigatorConfig.load({"kind": "filter"})
    navigator = Navigator.nominal(config, list(range(1000, 1000 + BATCH)), duration_s=60.0)
    for truth in truths(BATCH, 11, 10.0):
        measured = navigator.measure(truth)
    return measured, truth


def test_the_position_of_filters_has_the_error_that_it_states(open_sky) -> None:
    """Fast and slow parts together, with the common errors exactly."""
    m, truth = open_sky
    for source, low, high in (("undifferenced", 0.8, 1.1), ("differential", 0.7, 1.1)):
        config = CodePositionConfig.load({"source": source, **OPEN, "differential_errors": {"reflections_m": 0.0}})
        fix = locate_by_codes(config, m)
        assert fix.valid.all()
        error = fix.position_m[:, :2] - truth.position_enu_m[:, :2]
        assert low < ratio_of(error, fix.fast_m2 + fix.slow_m2) < high
        wider = locate_by_codes(CodePositionConfig.load({"source": source}), m)
        assert 0.5 < ratio_of(error, wider.fast_m2 + wider.slow_m2) < high  # 0.3 m of reflections


def test_the_position_of_the_context_monitor_and_of_the_family_has_the_error_that_it_states(open_sky) -> None:
    m, truth = open_sky
    for config in (CodeErrorsConfig(), CodeErrorsConfig.load(OPEN)):
        assert 0.8 < horizontal_ratio(code_fix(m, config).codes, truth) < 1.0
    wide = MonitoredCodesConfig().budget
    assert 0.35 < horizontal_ratio(solve_codes(code_epochs(m, wide, np.arange(BATCH))), truth) < 0.7  # 1.6 m of streets
    fit = solve_codes(code_epochs(m, wide.replace(**OPEN), np.arange(BATCH)))
    assert 0.7 < horizontal_ratio(fit, truth) < 1.0
    assert 0.7 < np.sqrt(fit.wsse.sum() / fit.df.sum()) < 1.0  # and residuals
    up = ratio_of(fit.x_m[:, 2:], fit.cofactor[:, 2:, 2:])
    assert 1.5 < up < 2.2  # heights have no level: what is common to all is taken as independent


def test_multipath_of_a_creeping_car_lasts_as_long_as_its_way() -> None:
    rules = CodeErrorBudget().rules()[0]
    times = [multipath_time(rules, v, 0.15) for v in (0.0, 0.1, 0.2, 1.0, 2.0, -10.0, 30.0)]
    assert times == pytest.approx([300.0, 300.0, 100.0, 20.0, 10.0, 10.0, 10.0])


def test_a_mean_of_one_frequency_is_no_longer_than_the_ionosphere_allows() -> None:
    assert largest_mean(1000.0, 0.0, 1.0) == 1000.0
    assert largest_mean(1000.0, 3e-4, 0.09) == pytest.approx(1000.0)
    assert largest_mean(2000.0, 3e-4, 0.09) == pytest.approx(1000.0)  # 0.3 m over 0.3 mm in an epoch
    assert largest_mean(2000.0, 10.0, 0.09) == 1.0
