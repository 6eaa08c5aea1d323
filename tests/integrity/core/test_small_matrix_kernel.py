"""Symmetric 3x3 matrices and HDOP against NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from signal_records import rows_of

from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, hdop_of, invert_3x3, invert_upper, multiply_3

seeds = st.integers(0, 2**32 - 1)


def positive(seed: int, spread: float) -> np.ndarray:
    """A symmetric positive definite matrix with a condition number of 10^spread."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return turn @ np.diag(10.0 ** np.array([0.0, rng.uniform(0.0, spread), spread])) @ turn.T


@given(seeds, st.floats(0.0, 4.0), st.floats(-6.0, 6.0))
def test_inverse(seed: int, spread: float, scale: float) -> None:
    matrix, out = 10.0**scale * positive(seed, spread), np.empty((3, 3))
    assert invert_3x3(matrix, out)
    np.testing.assert_array_equal(out, out.T)
    np.testing.assert_allclose(out @ matrix, np.eye(3), atol=1e-14 * 10.0 ** (2.0 * spread) + 1e-13)


@given(seeds, st.floats(0.0, 4.0))
def test_upper_triangle_is_that_of_the_full_inverse(seed: int, spread: float) -> None:
    matrix, out = positive(seed, spread), np.empty((3, 3))
    invert_3x3(matrix, out)
    assert invert_upper(*matrix[np.triu_indices(3)]) == (True, *out[np.triu_indices(3)])


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.diag([-1.0, -1.0, 1.0]),  # determinant > 0
        np.diag([1.0, 1.0, 1e-13]),  # unlike units
        np.ones((3, 3)),
        np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
        np.full((3, 3), np.nan),
        np.diag([1.0, np.nan, 1.0]),
        np.diag([np.inf, 1.0, 1.0]),
    ],
)
def test_what_is_not_positive_definite_is_refused(matrix: np.ndarray) -> None:
    assert not invert_3x3(matrix, np.empty((3, 3)))
    assert invert_upper(*matrix[np.triu_indices(3)]) == (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_matrix_of_small_numbers_is_no_singular_one() -> None:
    assert invert_3x3(1e-30 * np.eye(3), np.empty((3, 3)))


@given(seeds)
def test_product(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, vector, out = rng.normal(size=(3, 3)), rng.normal(size=3), np.empty(3)
    multiply_3(matrix, vector, out)
    np.testing.assert_allclose(out, matrix @ vector, rtol=1e-13, atol=1e-14)


def directions(seed: int, n: int) -> np.ndarray:
    e = np.random.default_rng(seed).normal(size=(n, 3))
    e[:, 2] = np.abs(e[:, 2])
    return e / np.linalg.norm(e, axis=1, keepdims=True)


@given(seeds, st.integers(8, 30), st.integers(1, 4))
def test_hdop_by_definition(seed: int, n: int, systems: int) -> None:
    rng = np.random.default_rng(seed)
    e, group, member = directions(seed, n), rng.permutation(n) % systems, np.ones(n, bool)
    member[rng.integers(0, n)] = False
    present = np.unique(group[member])
    clocks = (group[member, None] == present).astype(float)
    design = np.hstack([-e[member], clocks])
    if np.linalg.matrix_rank(design) == design.shape[1] and np.linalg.cond(design) < 1e3:
        q = np.linalg.inv(design.T @ design)
        assert hdop_of(rows_of(e, group, member)) == pytest.approx(math.sqrt(q[0, 0] + q[1, 1]), rel=1e-9)


def test_hdop_of_a_symmetric_sky() -> None:
    """Four satellites at the horizon, one overhead: the horizontal normal matrix is diag(2, 2)."""
    e = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    assert hdop_of(rows_of(e, np.zeros(5, np.int64), np.ones(5, bool))) == pytest.approx(1.0, rel=1e-14)


def test_hdop_is_infinite_without_a_position() -> None:
    e, group = directions(1, 9), np.arange(9) % MAX_GROUPS
    assert hdop_of(rows_of(e, np.zeros(9, np.int64), np.zeros(9, bool))) == math.inf
    assert hdop_of(rows_of(e, np.zeros(9, np.int64), np.arange(9) < 3)) == math.inf
    assert hdop_of(rows_of(e, group, np.arange(9) < MAX_GROUPS)) == math.inf  # each alone with its clock


@given(seeds)
def test_hdop_ignores_who_is_alone_or_absent(seed: int) -> None:
    e, group, member = directions(seed, 12), np.zeros(12, np.int64), np.ones(12, bool)
    member[-1] = False
    alone = group.copy()
    alone[-1] = 3
    expected = hdop_of(rows_of(e, group, member))
    assert hdop_of(rows_of(e, alone, np.ones(12, bool))) == pytest.approx(expected, rel=1e-12)
