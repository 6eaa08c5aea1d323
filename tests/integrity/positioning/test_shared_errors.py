"""Least squares with errors that all codes share: against matrices, and levels under errors drawn in common."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import sky
from scipy.stats import binom, chi2, norm

from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, code_position
from lanebound.integrity.monitoring.context.position_phase import PositionPhaseConfig, check_position
from lanebound.integrity.positioning.code_solution import solve_ranges
from lanebound.integrity.positioning.shared_errors import solve_with_shared_errors

RUNS = 20_000
SATELLITES = 12
SYSTEM = np.arange(SATELLITES) % 2


def sights(seed: int = 3) -> np.ndarray:
    """Unit vectors (S, 3)."""
    return np.array(sky(np.random.default_rng(seed), SATELLITES)[0])


def design_of(los: np.ndarray) -> np.ndarray:
    return np.column_stack([-los, SYSTEM == 0, SYSTEM == 1])


def test_solution_level_and_statistic_are_those_of_the_full_covariance() -> None:
    """R = D + C C' in matrices: S = (G'R^-1 G)^-1 G'R^-1, M = R^-1 - R^-1 G S, slope |S_i| / sqrt(M_ii)."""
    rng, los = np.random.default_rng(1), sights()
    own, shared = rng.uniform(0.5, 4.0, SATELLITES), rng.uniform(0.0, 3.0, (SATELLITES, 2))
    y, g = rng.standard_normal(SATELLITES) * 3.0, design_of(los)
    inverse = np.linalg.inv(np.diag(own) + shared @ shared.T)
    covariance = np.linalg.inv(g.T @ inverse @ g)
    gain = covariance @ g.T @ inverse
    m = inverse - inverse @ g @ gain
    slope = np.hypot(gain[0], gain[1]) / np.sqrt(np.diag(m))
    used = np.ones((1, SATELLITES), bool)
    fit = solve_with_shared_errors(los[None], y[None], own[None], used, SYSTEM, shared[None])
    np.testing.assert_allclose(fit.x_m[0], (gain @ y)[:3], atol=1e-9)
    np.testing.assert_allclose(fit.cofactor[0], covariance[:3, :3], atol=1e-9)
    np.testing.assert_allclose(fit.gain[0], gain[:3].T, atol=1e-9)
    np.testing.assert_allclose(fit.slopes()[0], slope, rtol=1e-8)
    np.testing.assert_allclose(fit.normalised[0], m @ y / np.sqrt(np.diag(m)), rtol=1e-8)
    assert fit.wsse[0] == pytest.approx(y @ m @ y)
    found = check_position(fit, PositionPhaseConfig())
    spread = np.sqrt(covariance[0, 0] + covariance[1, 1])
    level = slope.max() * np.sqrt(chi2.isf(1e-3, SATELLITES - 5)) + norm.isf(0.5e-5) * spread
    assert found.level_m[0] == pytest.approx(level)


def test_without_shared_errors_it_is_the_solver_of_codes_and_unsolved_epochs_stay_so() -> None:
    rng, los = np.random.default_rng(2), np.stack([sights(4), sights(5)])
    y, own = rng.standard_normal((2, SATELLITES)), rng.uniform(1.0, 3.0, (2, SATELLITES))
    used = np.ones(y.shape, bool)
    used[1, 3:] = False
    plain = solve_ranges(los, y, own, used, SYSTEM)
    none = solve_with_shared_errors(los, y, own, used, SYSTEM, np.zeros((2, SATELLITES, 2)))
    some = solve_with_shared_errors(los, y, own, used, SYSTEM, np.full((2, SATELLITES, 2), np.nan) * ~used[..., None])
    for name, value in vars(plain).items():
        np.testing.assert_allclose(getattr(none, name), value, atol=1e-12, err_msg=name)
    assert plain.status.tolist() == some.status.tolist()
    assert some.x_m[1].tolist() == [0.0, 0.0, 0.0]


def drawn(covariance: str, bias_m: float = 0.0):
    """Errors (RUNS,) of positions, their fit, and the first phase; ionosphere and troposphere are drawn once a run."""
    config, rng = CodeErrorsConfig(covariance=covariance), np.random.default_rng(6)
    los = np.broadcast_to(sights(), (RUNS, SATELLITES, 3))
    cn0 = np.full((RUNS, SATELLITES), 42.0)
    parts = config.errors.errors(los[..., 2], cn0)
    own = np.sqrt(parts.fast_m2 + parts.own_m2) * rng.standard_normal((RUNS, SATELLITES))
    y = own + np.einsum("bmk,bk->bm", parts.common_m, rng.standard_normal((RUNS, 2)))
    used = np.ones((RUNS, SATELLITES), bool)
    if bias_m:
        clean, _ = code_position(los[:1], y[:1], cn0[:1], used[:1], SYSTEM, config)
        y[:, int(np.argmax(clean.slopes()[0]))] += bias_m
    fit, _ = code_position(los, y, cn0, used, SYSTEM, config)
    return np.hypot(*fit.x_m[:, :2].T), fit, check_position(fit, PositionPhaseConfig(false_alarm=0.01))


def test_the_test_has_its_false_alarms_under_shared_errors_and_the_covariance_is_that_of_the_errors() -> None:
    """20,000 positions; intervals that fail by chance in 1 of 1,000 runs."""
    error, fit, found = drawn("full")
    low, high = binom.ppf([5e-4, 1 - 5e-4], RUNS, 0.01)
    assert low <= (~found.consistent).sum() <= high
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 2 * RUNS)
    inverse = np.linalg.inv(fit.cofactor[0, :2, :2])
    assert low <= np.einsum("bi,ij,bj->", fit.x_m[:, :2], inverse, fit.x_m[:, :2]) <= high
    assert not (error > found.level_m).any()


def test_a_diagonal_covariance_is_wider_and_its_test_is_blunt() -> None:
    error, _, found = drawn("full")
    other, diagonal, blunt = drawn("diagonal")
    assert found.level_m[0] < 0.9 * blunt.level_m[0]
    assert np.square(error).mean() < np.square(other).mean()  # the weights fit the errors
    assert np.square(other).mean() < 0.9 * np.trace(diagonal.cofactor[0, :2, :2])
    low = binom.ppf(5e-4, RUNS, 0.01)
    assert (~blunt.consistent).sum() < low


@pytest.mark.parametrize("bias_m", [8.0, 12.0, 18.0, 27.0])
def test_an_undetected_fault_stays_within_the_level_under_shared_errors(bias_m) -> None:
    """The code of the largest slope is wrong; fewer than 1 in 1,000 positions lie beyond their level unseen."""
    error, _, found = drawn("full", bias_m)
    misleading = found.consistent & (error > found.level_m)
    assert misleading.mean() < 1e-3
