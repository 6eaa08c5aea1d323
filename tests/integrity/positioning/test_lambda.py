"""Integer least squares kernels: golden example, brute force, reference, invariants."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lanebound.integrity.positioning import lambda_kernel as kernel
from lanebound.integrity.positioning.ambiguity import resolve
from plain_ambiguity import bootstrap_failure_rate, decorrelate, integer_least_squares

Array = NDArray[np.float64]
# de Jonge & Tiberius (1996), LGR series 12, the three-ambiguity example used throughout
EXAMPLE_A = np.array([5.450, 3.100, 2.970])
EXAMPLE_Q = np.array([[6.290, 5.978, 0.544], [5.978, 6.292, 2.340], [0.544, 2.340, 6.288]])


def largest_prefix(Q: Array, order: NDArray[np.int64], group: int, failure_limit: float) -> tuple[int, float]:
    """Reference of the largest k whose ambiguities ``order[: k * group]`` can be fixed together, and their P_IF.

    One decorrelation for each prefix (the kernel meets all prefixes in one; its P_IF may differ slightly, both are
    upper bounds). (0, 0) when none can be fixed; (-1, 1) when Q (n, n) is not positive definite.
    """
    best = (0, 0.0)
    for k in range(1, len(order) // group + 1):
        subset = order[: k * group]
        reduced = decorrelate(Q[np.ix_(subset, subset)])
        if reduced is None:
            return -1, 1.0
        rate = float(bootstrap_failure_rate(reduced.D))
        if rate <= failure_limit:
            best = (k, rate)
    return best


def double_differences(n_pairs: int, rng: np.random.Generator, code_m: float = 0.3) -> tuple[Array, Array]:
    """A dual-frequency code and phase problem: float ambiguities (n,), covariance (n, n), bands one after the other."""
    elevation, azimuth = rng.uniform(0.3, 1.5, n_pairs + 1), rng.uniform(0, 2 * np.pi, n_pairs + 1)
    e = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=1)
    difference = np.hstack([-np.ones((n_pairs, 1)), np.eye(n_pairs)])
    weights = np.linalg.inv(difference @ np.diag(1 / np.sin(elevation) ** 2) @ difference.T)
    n = 2 * n_pairs
    normal = np.zeros((3 + n, 3 + n))
    for band, wavelength in enumerate((0.190294, 0.244210)):
        for sigma, scale in ((code_m, 0.0), (0.003, wavelength)):
            rows = np.zeros((n_pairs, 3 + n))
            rows[:, :3] = -difference @ e
            rows[:, 3 + band * n_pairs : 3 + (band + 1) * n_pairs] = scale * np.eye(n_pairs)
            normal += rows.T @ weights @ rows / (2 * sigma**2)
    Q = np.linalg.inv(normal)[3:, 3:]
    Q = (Q + Q.T) / 2
    return rng.integers(-50, 50, n) + np.linalg.cholesky(Q) @ rng.standard_normal(n), Q


def random_problem(n: int, seed: int) -> tuple[Array, Array]:
    """A correlated problem with several plausible answers."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n)) * rng.uniform(0.1, 1.0)
    return 30 * rng.standard_normal(n), root @ root.T + 1e-3 * np.eye(n)


def run(
    a: Array, Q: Array, m: int = 2, capacity: int = 0, node_limit: int = 100_000
) -> tuple[int, Array, Array, Array]:
    """One cold kernel call: status, candidates, norms, Z'."""
    n = len(a)
    c = max(n, capacity)
    padded_a, padded_q = np.full(c, np.nan), np.full((c, c), np.nan)
    padded_a[:n], padded_q[:n, :n] = a, Q
    scratch = kernel.search_scratch(c, m)
    status = kernel.integer_least_squares(n, padded_a, padded_q, node_limit, False, scratch)
    return status, scratch.candidates[:, :n], scratch.norms, scratch.Zt[:n, :n]


def test_published_example() -> None:
    for solution in (resolve(EXAMPLE_A, EXAMPLE_Q), integer_least_squares(EXAMPLE_A, EXAMPLE_Q)):
        np.testing.assert_array_equal(solution.candidates, [[5, 3, 4], [6, 4, 4]])
        np.testing.assert_allclose(solution.norms, [0.2183, 0.3073], atol=5e-5)
    reduced = decorrelate(EXAMPLE_Q)
    assert reduced is not None
    # the published decorrelated covariance has variances 4.476, 1.146 and 0.626 (in some order and sign)
    assert sorted(np.diag(reduced.Z.T @ EXAMPLE_Q @ reduced.Z)) == pytest.approx([0.626, 1.146, 4.476], abs=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
def test_brute_force_agrees(n: int, seed: int) -> None:
    a, Q = random_problem(n, seed)
    status, candidates, norms, _ = run(a, Q, m=3)
    assert status == kernel.OK
    reach = int(np.ceil(np.sqrt(norms[-1] * np.diag(Q).max()))) + 1
    grid = np.rint(a) + np.array(list(itertools.product(range(-reach, reach + 1), repeat=n)))
    rest = a - grid
    every = np.einsum("ei,ij,ej->e", rest, np.linalg.inv(Q), rest)
    best = np.argsort(every)[:3]
    np.testing.assert_array_equal(candidates, grid[best])
    np.testing.assert_allclose(norms, every[best], rtol=1e-9)


@given(n=st.integers(1, 20), seed=st.integers(0, 10**6), m=st.integers(2, 4))
@settings(max_examples=40, deadline=None)
def test_fast_equals_reference(n: int, seed: int, m: int) -> None:
    a, Q = random_problem(n, seed)
    fast, slow = resolve(a, Q, m, node_limit=2000), integer_least_squares(a, Q, m, node_limit=2000)
    assert fast.status == slow.status
    if slow.status == kernel.OK:
        np.testing.assert_array_equal(fast.candidates, slow.candidates)
        np.testing.assert_allclose(fast.norms, slow.norms, rtol=1e-9)
    assert fast.failure_rate == pytest.approx(slow.failure_rate, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("n_pairs", [2, 5, 10, 33])
def test_fast_equals_reference_on_double_differences(n_pairs: int) -> None:
    a, Q = double_differences(n_pairs, np.random.default_rng(n_pairs))
    fast, slow = resolve(a, Q), integer_least_squares(a, Q)
    np.testing.assert_array_equal(fast.candidates, slow.candidates)
    np.testing.assert_allclose(fast.norms, slow.norms, rtol=1e-9)
    assert fast.failure_rate == pytest.approx(slow.failure_rate, rel=1e-6, abs=1e-15)


@given(n=st.integers(1, 25), seed=st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_decorrelation_is_unimodular_and_exact(n: int, seed: int) -> None:
    _, Q = random_problem(n, seed)
    scratch = kernel.search_scratch(n, 2)
    assert kernel.decorrelate(n, Q, False, scratch) == kernel.OK
    Z, inverse, U, D = scratch.Zt.T, scratch.Z_inverse, scratch.U, scratch.D
    np.testing.assert_array_equal(Z, np.rint(Z))
    np.testing.assert_array_equal(Z @ inverse, np.eye(n))
    np.testing.assert_allclose(
        U @ np.diag(D[:n]) @ U.T, Z.T @ Q @ Z, atol=1e-10 * np.abs(Q).max() * np.abs(Z).max() ** 2
    )
    np.testing.assert_array_equal(np.tril(U, -1), 0.0)
    assert np.abs(np.triu(U, 1)).max(initial=0.0) <= 0.5 + 1e-9
    assert np.prod(D[:n] / np.linalg.eigvalsh(Q)) == pytest.approx(1.0, rel=1e-6)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 12))
@settings(max_examples=25, deadline=None)
def test_integer_shift_moves_the_solution(seed: int, n: int) -> None:
    a, Q = random_problem(n, seed)
    shift = np.random.default_rng(seed).integers(-(10**6), 10**6, n)
    here, there = resolve(a, Q), resolve(a + shift, Q)
    np.testing.assert_allclose(there.norms, here.norms, rtol=1e-6, atol=1e-9)
    if here.norms[1] > here.norms[0] * (1 + 1e-6):
        np.testing.assert_array_equal(there.candidates[0], here.candidates[0] + shift)


def test_spare_capacity_changes_nothing() -> None:
    a, Q = double_differences(6, np.random.default_rng(1))
    tight, spare = run(a, Q), run(a, Q, capacity=40)
    np.testing.assert_array_equal(tight[1], spare[1])
    np.testing.assert_array_equal(tight[2], spare[2])


def test_warm_start_gives_the_same_answers() -> None:
    a, Q = double_differences(8, np.random.default_rng(5))
    drift = np.linspace(0.0, 0.05, 20)[:, None, None]
    covariances = Q * (1 + drift) + drift * 1e-4 * np.eye(len(a))
    floats = a + 0.01 * np.random.default_rng(6).standard_normal((20, len(a)))
    warm, cold = resolve(floats, covariances, reuse=True), resolve(floats, covariances)
    np.testing.assert_array_equal(warm.candidates, cold.candidates)
    np.testing.assert_allclose(warm.norms, cold.norms, rtol=1e-8)
    np.testing.assert_allclose(warm.failure_rate, cold.failure_rate, rtol=0.5)


def test_small_variances_skip_the_decorrelation() -> None:
    a, Q = random_problem(6, 3)
    Q = Q * (0.0024 / np.diag(Q).max())
    status, candidates, norms, transform = run(a, Q)
    assert status == kernel.OK
    np.testing.assert_array_equal(np.abs(transform).sum(axis=1), 1.0)  # a permutation
    slow = integer_least_squares(a, Q)
    np.testing.assert_array_equal(candidates, slow.candidates)
    np.testing.assert_allclose(norms, slow.norms, rtol=1e-9)


def test_node_limit_is_reported() -> None:
    a, Q = random_problem(15, 2)
    status, candidates, norms, _ = run(a, 100 * Q, node_limit=16)
    assert status == kernel.NODE_LIMIT
    assert np.isfinite(norms[0])
    np.testing.assert_array_equal(candidates[0], np.rint(candidates[0]))


def prefix(Q: Array, order: NDArray[np.int64], group: int, limit: float) -> tuple[int, float]:
    """The kernel's largest prefix."""
    ordered = np.ascontiguousarray(Q[np.ix_(order, order)])
    k, rate = kernel.largest_prefix(len(order) // group, group, ordered, limit, kernel.search_scratch(len(order), 2))
    return k, rate


@pytest.mark.parametrize("limit", [1e-1, 1e-3, 1e-5])
def test_largest_prefix_keeps_its_limit(limit: float) -> None:
    for seed in range(8):
        _, Q = double_differences(8, np.random.default_rng(seed), code_m=0.6)
        order = np.argsort(np.diag(Q)[:8])
        order = np.stack([order, order + 8], axis=1).ravel()
        k, rate = prefix(Q, order, 2, limit)
        assert rate <= limit
        # two reductions of the same lattice differ by up to a factor in their bound, so they agree within one
        slow_k, _ = largest_prefix(Q, order, 2, limit)
        assert k <= largest_prefix(Q, order, 2, 2.5 * limit)[0]
        assert slow_k <= prefix(Q, order, 2, 2.5 * limit)[0]
        if k:
            subset = order[: 2 * k]
            reduced = decorrelate(Q[np.ix_(subset, subset)])
            assert reduced is not None
            assert bootstrap_failure_rate(reduced.D) == pytest.approx(rate, rel=1.5, abs=1e-15)


def test_largest_prefix_extremes() -> None:
    order = np.arange(6)
    assert prefix(1e-4 * np.eye(6), order, 2, 1e-9) == (3, 0.0)
    assert prefix(9.0 * np.eye(6), order, 2, 1e-3) == (0, 0.0)
    assert prefix(np.diag([1e-4, 1e-4, 9.0, 9.0, 1e-4, 1e-4]), order, 2, 1e-3)[0] == 1
    assert prefix(np.ones((6, 6)), order, 2, 1e-3) == (-1, 1.0)
    assert prefix(np.eye(0), np.arange(0), 2, 1e-3) == (0, 0.0)
