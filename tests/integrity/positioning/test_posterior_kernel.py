"""The probability that the best integers are wrong: against sums over all of them, and against counts."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, poisson

from lanebound.integrity.positioning.lambda_kernel import OK, SearchScratch, integer_least_squares, search_scratch
from lanebound.integrity.positioning.resolve_kernel import others_probability, row_sum

Array = NDArray[np.float64]
NODES = 20_000


def covariance(rng: np.random.Generator, n: int, size: float) -> Array:
    """A covariance (n, n) whose ambiguities are strongly correlated, as those of one epoch [cycles^2]."""
    a = rng.standard_normal((n, n))
    common = rng.standard_normal((n, 1))
    return np.asarray(size * (0.1 * a @ a.T / n + 4.0 * common @ common.T / n + 0.02 * np.eye(n)))


def searched(a_hat: Array, q: Array) -> SearchScratch:
    scratch = search_scratch(len(a_hat), 2)
    assert integer_least_squares(len(a_hat), a_hat, q, NODES, False, scratch) == OK
    return scratch


def summed(a_hat: Array, q: Array, best: Array, scale: float, reach: int) -> float:
    """Sum of ``exp((q_best - q_z) / 2)`` over all other vectors within ``reach`` cycles of the best one."""
    z = best + np.array(list(product(range(-reach, reach + 1), repeat=len(a_hat))), dtype=float)
    norm = np.einsum("ki,ij,kj->k", a_hat - z, np.linalg.inv(scale * q), a_hat - z)
    own = norm[len(norm) // 2]
    return float(np.exp(-0.5 * (np.delete(norm, len(norm) // 2) - own)).sum())


@pytest.mark.parametrize("variance", [1e-3, 0.05, 0.3, 0.99, 1.01, 2.0, 40.0])
def test_sum_over_a_row_of_integers(variance: float) -> None:
    k = np.arange(-400, 401)
    assert row_sum(variance) == pytest.approx(np.exp(-0.5 * k**2 / variance).sum(), rel=1e-12)


@pytest.mark.parametrize("scale", [1.0, 1.7])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_bound_is_the_sum_over_all_other_vectors(n: int, scale: float) -> None:
    rng = np.random.default_rng(n)
    for size in (0.3, 1.0):
        for _ in range(12):
            q, a_hat = covariance(rng, n, size), rng.normal(0.0, 3.0, n)
            scratch = searched(a_hat, q)
            exact = summed(a_hat, q, scratch.candidates[0, :n].copy(), scale, {1: 60, 2: 40, 3: 16}[n])
            assert exact * (1.0 - 1e-9) <= others_probability(n, 1e3, scale, NODES, scratch) + 1e-12
            tight = others_probability(n, 1.01 * exact, scale, 10**6, scratch)
            assert exact * (1.0 - 1e-9) <= tight <= 1.02 * exact


def test_what_is_above_the_limit_or_not_searched_is_never_accepted() -> None:
    q, a_hat = np.array([[0.04, 0.01], [0.01, 0.05]]), np.array([0.2, -0.1])
    scratch = searched(a_hat, q)
    exact = others_probability(2, 1.0, 1.0, NODES, scratch)
    assert 0.0 < exact < 1.0
    assert others_probability(2, 0.9 * exact, 1.0, NODES, scratch) == math.inf
    assert others_probability(2, 1.0, 1.0, 3, scratch) == math.inf


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.25])
def test_wrong_integers_are_accepted_as_often_as_the_limit_allows(scale: float) -> None:
    """Errors of the declared covariance, and of ``scale`` times it, 2.4e4 float solutions of 4 to 8 ambiguities; false
    alarm of each bound: 1e-4."""
    rng, limit, accepted, wrong, stated, runs = np.random.default_rng(8), 0.05, 0, 0, 0.0, 24_000
    for run in range(runs):
        if run % 400 == 0:
            n = 4 + run // 400 % 5
            q = covariance(rng, n, 0.25)
            root = np.linalg.cholesky(scale * q)
        a_hat = root @ rng.standard_normal(n)
        scratch = searched(a_hat, q)
        failure = others_probability(n, limit, 1.0, NODES, scratch)
        if failure <= limit:
            accepted += 1
            stated += failure
            wrong += bool(scratch.candidates[0, :n].any())
    assert accepted > 0.1 * runs
    assert wrong <= binom.isf(1e-4, runs, limit)
    assert wrong <= poisson.isf(1e-4, stated)  # of those accepted, as many as they state
    if scale == 1.0:
        assert stated > 100.0
        assert wrong >= poisson.ppf(1e-4, 0.95 * stated)
