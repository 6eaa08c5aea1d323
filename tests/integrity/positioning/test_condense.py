"""Correlated rows as few independent ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.positioning.condense import Condensed, condense_white, gauss_markov_covariance


def condense(design: np.ndarray, covariance: np.ndarray, y: np.ndarray) -> Condensed:
    """The rows of a design after division by a root of the covariance."""
    return condense_white(np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack([design, y])))


@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 1000))
def test_normal_equations_and_misfit_stay(rows: int, unknowns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    g, y = rng.normal(size=(rows, unknowns)), rng.normal(size=rows)
    q = gauss_markov_covariance(np.arange(rows) * 1.0, rng.uniform(0.5, 3.0, rows), 5.0)
    found, w = condense(g, q, y), np.linalg.inv(q)
    assert len(found.y) <= min(rows, unknowns)
    np.testing.assert_allclose(found.design.T @ found.design, g.T @ w @ g, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.design.T @ found.y, g.T @ w @ y, rtol=1e-6, atol=1e-7)
    x = np.linalg.lstsq(found.design, found.y, rcond=None)[0]
    whole = (y - g @ x) @ w @ (y - g @ x)
    condensed = ((found.y - found.design @ x) ** 2).sum() + found.misfit
    assert condensed == pytest.approx(whole, rel=1e-6, abs=1e-7)
    assert found.freedom == rows - len(found.y)


def test_lasting_errors_do_not_average_out() -> None:
    t, sigma = np.arange(100.0), np.full(100, 2.0)
    one = np.ones((100, 1))
    white = condense(one, gauss_markov_covariance(t, sigma, 0.0), np.zeros(100))
    lasting = condense(one, gauss_markov_covariance(t, sigma, 1e9, 0.0) + 1e-6 * np.eye(100), np.zeros(100))
    assert white.design[0, 0] ** -2 == pytest.approx(4.0 / 100.0)
    assert lasting.design[0, 0] ** -2 == pytest.approx(4.0, rel=1e-3)
