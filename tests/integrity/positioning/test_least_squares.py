"""Least squares against closed forms, its invariants, and its verdicts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.least_squares import Solvability, design_matrix, gain, weights
from plain_least_squares import dilution, solve


def random_sky(seed: int, n: int, systems: int, batch: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    elevation = np.arcsin(rng.uniform(0.15, 1.0, (*batch, n)))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, (*batch, n))
    flat = np.cos(elevation)
    los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
    return los, np.broadcast_to(np.arange(n) % systems, (*batch, n))


def test_four_satellites_have_the_textbook_dilution() -> None:
    """Zenith and three on the horizon 120 degrees apart: HDOP^2 = 4/3, PDOP^2 = 4/3 + 4/3 (Kaplan, GDOP 1.73)."""
    azimuth = np.radians([0.0, 120.0, 240.0])
    los = np.vstack([[0.0, 0.0, 1.0], np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros(3)], -1)])
    dop = dilution(design_matrix(los, np.zeros(4, int)), 4.0 * np.eye(4))
    assert dop.hdop == pytest.approx(np.sqrt(4.0 / 3.0), rel=1e-12)
    assert dop.pdop == pytest.approx(np.sqrt(8.0 / 3.0), rel=1e-12)
    assert dop.weighted_hdop_m == pytest.approx(0.5 * np.sqrt(4.0 / 3.0), rel=1e-12)


def test_exact_measurements_give_the_state_back() -> None:
    los, group = random_sky(1, 12, 3, (4, 2))
    g = design_matrix(los, group)
    truth = np.random.default_rng(2).normal(size=(4, 2, 6))
    found = solve(g, np.eye(12), (g @ truth[..., None])[..., 0])
    np.testing.assert_allclose(found.estimate, truth, atol=1e-9)
    assert np.abs(found.chi2).max() < 1e-15
    assert (found.freedom == 6).all()


def test_a_full_covariance_equals_whitening() -> None:
    rng = np.random.default_rng(3)
    los, group = random_sky(3, 9, 2)
    g = design_matrix(los, group)
    root = rng.normal(size=(9, 9)) + 3.0 * np.eye(9)
    y = rng.normal(size=9)
    found = solve(g, root @ root.T, y)
    white = np.linalg.solve(root, np.column_stack([g, y]))
    expected, residue, *_ = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)
    np.testing.assert_allclose(found.estimate, expected, rtol=1e-9)
    assert found.chi2 == pytest.approx(residue[0], rel=1e-9)


def test_residual_covariance_is_that_of_the_residuals() -> None:
    """Q_e = (I - G S) Q_y (I - G S)' for the best linear estimator."""
    los, group = random_sky(4, 10, 2)
    g, q = design_matrix(los, group), np.diag(np.linspace(0.5, 2.0, 10))
    found = solve(g, q, np.zeros(10))
    free = np.eye(10) - g @ found.gain.gain
    np.testing.assert_allclose(found.residual_covariance, free @ q @ free.T, atol=1e-12)


def test_chi2_is_chi_square_distributed() -> None:
    """Mean of 4000 sums with 5 degrees of freedom; fails by chance once in 1000 runs."""
    rng = np.random.default_rng(5)
    los, group = random_sky(5, 10, 2)
    variance = np.linspace(0.1, 1.0, 10)
    noise = rng.normal(size=(4000, 10)) * np.sqrt(variance)
    total = solve(design_matrix(los, group), np.diag(variance), noise).chi2.sum()
    low, high = chi2.ppf([5e-4, 1 - 5e-4], df=4000 * 5)
    assert low < total < high


def test_masked_rows_do_not_matter_whatever_they_hold() -> None:
    los, group = random_sky(6, 12, 2)
    g, keep = design_matrix(los, group), np.arange(12) != 5
    y = np.random.default_rng(6).normal(size=12)
    spoiled = y.copy()
    spoiled[5] = 1e9
    masked = solve(g, np.eye(12), spoiled, keep)
    np.testing.assert_allclose(masked.estimate, solve(g[keep], np.eye(11), y[keep]).estimate, atol=1e-12)
    assert masked.residual[5] == 0.0


def test_a_clock_without_rows_is_dropped_but_a_position_axis_never() -> None:
    los, group = random_sky(7, 10, 2)
    g, one_system = design_matrix(los, group), group == 0
    found = gain(g, weights(np.eye(10), one_system))
    assert found.solved
    assert (found.gain[4] == 0.0).all()
    np.testing.assert_allclose(found.gain[:4, one_system], gain(g[one_system, :4], np.eye(5)).gain, atol=1e-12)
    flat = np.hstack([np.zeros((6, 1)), np.random.default_rng(0).normal(size=(6, 3))])
    assert gain(flat, np.eye(6)).status == Solvability.SINGULAR.code


@pytest.mark.parametrize(("n", "systems"), [(0, 1), (1, 1), (3, 1), (4, 2), (6, 4)])
def test_too_few_is_a_verdict_with_finite_outputs(n: int, systems: int) -> None:
    los, group = random_sky(8, n, systems)
    found = solve(design_matrix(los, group, systems), np.eye(n), np.ones(n))
    assert found.gain.status == Solvability.TOO_FEW.code
    assert (found.estimate == 0.0).all()
    assert (found.residual == 0.0).all()
    assert found.freedom == 0
    assert np.isinf(dilution(design_matrix(los, group, systems), np.eye(n)).hdop)


def test_satellites_in_one_direction_are_singular() -> None:
    los = np.tile([0.6, 0.0, 0.8], (6, 1))
    assert gain(design_matrix(los, np.zeros(6, int)), np.eye(6)).status == Solvability.SINGULAR.code


def test_one_batch_item_without_solution_leaves_the_others_alone() -> None:
    los, group = random_sky(9, 8, 1, (3,))
    rows = np.ones((3, 8), bool)
    rows[1, 3:] = False
    found = solve(design_matrix(los, group), np.eye(8), np.ones((3, 8)), rows)
    assert found.gain.status.tolist() == [0, 1, 0]
    np.testing.assert_allclose(found.estimate[[0, 2], 3], 1.0, atol=1e-10)


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="unit vectors"):
        design_matrix([[2.0, 0.0, 0.0]], [0])
    with pytest.raises(InputError, match=r"group must lie in \[0, 1\]"):
        design_matrix([[1.0, 0.0, 0.0]], [2], 2)
    with pytest.raises(InputError, match="positive definite"):
        weights(np.diag([1.0, -1.0]))
    with pytest.raises(InputError, match="y must be finite"):
        solve(np.ones((2, 1)), np.eye(2), [np.nan, 0.0], required=1)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(0, 16), systems=st.integers(1, 4), scale=st.floats(1e-6, 1e6))
def test_outputs_are_always_finite(seed: int, n: int, systems: int, scale: float) -> None:
    los, group = random_sky(seed, n, systems)
    rng = np.random.default_rng(seed)
    rows = rng.random(n) < 0.8
    found = solve(design_matrix(los, group, systems), scale * np.eye(n), rng.normal(size=n) * scale, rows)
    for value in (found.estimate, found.residual, found.residual_covariance, found.chi2, found.gain.cofactor):
        assert np.isfinite(value).all()
