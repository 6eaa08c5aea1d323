"""Ambiguity front door: batches, outcomes, success rates."""

import numpy as np
import pytest
from scipy.stats import binom, norm

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.ambiguity import SearchStatus, resolve
from plain_ambiguity import bootstrap_failure_rate, integer_least_squares

Q2 = np.array([[0.09, 0.05], [0.05, 0.08]])
BOTH = pytest.mark.parametrize("solve", [resolve, integer_least_squares])


@BOTH
def test_batch_axes_broadcast(solve: object) -> None:
    a = np.random.default_rng(0).normal(size=(3, 4, 2))
    solution = solve(a, Q2)  # type: ignore[operator]
    assert solution.candidates.shape == (3, 4, 2, 2)
    assert solution.norms.shape == (3, 4, 2)
    assert solution.status.shape == solution.failure_rate.shape == solution.ratio.shape == (3, 4)
    alone = solve(a[1, 2], Q2)  # type: ignore[operator]
    np.testing.assert_array_equal(solution.candidates[1, 2], alone.candidates)
    np.testing.assert_array_equal(solution.norms[1, 2], alone.norms)


@BOTH
def test_no_ambiguities_is_a_perfect_fit(solve: object) -> None:
    solution = solve(np.zeros((5, 0)), np.zeros((5, 0, 0)))  # type: ignore[operator]
    assert (solution.status == SearchStatus.OK).all()
    np.testing.assert_array_equal(solution.norms, [[0.0, np.inf]] * 5)
    np.testing.assert_array_equal(solution.failure_rate, 0.0)
    assert np.isinf(solution.ratio).all()


@BOTH
def test_empty_batch(solve: object) -> None:
    assert solve(np.zeros((0, 3)), np.eye(3)).candidates.shape == (0, 2, 3)  # type: ignore[operator]


@BOTH
@pytest.mark.parametrize(
    ("a", "Q", "status"),
    [
        ([np.nan, 0.0], Q2, SearchStatus.NOT_FINITE),
        ([np.inf, 0.0], Q2, SearchStatus.NOT_FINITE),
        ([0.2, 0.3], -Q2, SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], np.ones((2, 2)), SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], np.zeros((2, 2)), SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], [[1.0, 2.0], [2.0, 1.0]], SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], np.full((2, 2), np.nan), SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], [[1.0, np.nan], [np.nan, 1.0]], SearchStatus.NOT_POSITIVE_DEFINITE),
        ([0.2, 0.3], np.diag([np.inf, 1.0]), SearchStatus.NOT_POSITIVE_DEFINITE),
    ],
)
def test_unusable_input_is_a_status(solve: object, a: list[float], Q: object, status: SearchStatus) -> None:
    solution = solve([[0.2, 0.3], a, [0.2, 0.3]], [Q2, Q, Q2])  # type: ignore[operator]
    np.testing.assert_array_equal(solution.status, [SearchStatus.OK, status, SearchStatus.OK])
    assert np.isinf(solution.norms[1]).all()
    assert solution.failure_rate[1] == 1.0
    assert solution.ratio[1] == 0.0
    assert np.isfinite(solution.candidates).all()
    np.testing.assert_array_equal(solution.candidates[0], solution.candidates[2])


@BOTH
def test_misuse_is_an_error(solve: object) -> None:
    for a, Q, options in (
        (np.zeros(3), np.eye(2), {}),
        (0.0, np.eye(2), {}),
        (np.zeros((3, 2)), np.zeros((4, 2, 2)), {}),
        (["x"], np.eye(1), {}),
        (np.zeros(2), np.eye(2), {"candidates": 1}),
        (np.zeros(2), np.eye(2), {"node_limit": 0}),
    ):
        with pytest.raises(InputError):
            solve(a, Q, **options)  # type: ignore[operator]


def test_failure_rate_closed_forms() -> None:
    assert bootstrap_failure_rate([0.04]) == pytest.approx(2 * norm.sf(2.5), rel=1e-12)
    two = 1 - (1 - 2 * norm.sf(2.5)) * (1 - 2 * norm.sf(1.25))
    assert bootstrap_failure_rate([0.04, 0.16]) == pytest.approx(two, rel=1e-12)
    assert bootstrap_failure_rate([0.004]) == pytest.approx(2 * norm.sf(0.5 / np.sqrt(0.004)), rel=1e-9)
    assert bootstrap_failure_rate([]) == 0.0
    compiled = resolve(np.zeros(1), np.eye(1) * 0.004).failure_rate
    assert compiled == pytest.approx(2 * norm.sf(0.5 / np.sqrt(0.004)), rel=1e-9)


@pytest.mark.parametrize("scale", [0.3, 1.0])
def test_success_rate_is_at_least_the_bootstrapped_one(scale: float) -> None:
    rng = np.random.default_rng(7)
    root = rng.standard_normal((5, 5)) * 0.2 * np.sqrt(scale)
    Q, runs = root @ root.T + 0.02 * np.eye(5), 20_000
    floats = rng.standard_normal((runs, 5)) @ np.linalg.cholesky(Q).T
    solution = resolve(floats, Q)
    wrong = int((solution.candidates[:, 0] != 0).any(axis=-1).sum())
    # the bound may only be exceeded by chance, once in 10,000 test runs
    assert wrong <= binom.isf(1e-4, runs, float(solution.failure_rate[0]))


def test_one_ambiguity_fails_exactly_as_bootstrapped() -> None:
    runs, sigma = 50_000, 0.25
    floats = sigma * np.random.default_rng(8).standard_normal((runs, 1))
    solution = resolve(floats, [[sigma**2]])
    wrong = int((solution.candidates[:, 0, 0] != 0).sum())
    low, high = binom.interval(1 - 1e-4, runs, 2 * norm.sf(2.0))  # fails by chance once in 10,000 runs
    assert low <= wrong <= high
