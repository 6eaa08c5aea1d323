"""Vectors of kernels against NumPy, lane by lane."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from numba.core.errors import TypingError

from lanebound.integrity.core import simd_kernel as lk
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.simd_kernel import (
    absolute,
    fma,
    largest,
    load,
    maximum,
    minimum,
    root_of,
    spread,
    store,
    total,
    where_less,
)

NAN = math.nan


@jit
def _arithmetic(a, out):
    x, y = load(a, 0, 0), load(a, 1, 0)
    store(x + y, out, 0, 0)
    store(x - y, out, 1, 0)
    store(x * y, out, 2, 0)
    store(x / y, out, 3, 0)
    store(2.0 - x, out, 4, 0)
    store(absolute(x), out, 5, 0)
    store(root_of(absolute(x)), out, 6, 0)
    store(where_less(x, y, x, 7.0), out, 7, 0)


def test_operations_act_on_each_lane_with_the_bits_of_numpy() -> None:
    a = np.random.default_rng(1).normal(size=(2, lk.WIDTH))
    out = np.empty((8, lk.WIDTH))
    _arithmetic(a, out)
    x, y = a
    expected = [x + y, x - y, x * y, x / y, 2.0 - x, np.abs(x), np.sqrt(np.abs(x)), np.where(x < y, x, 7.0)]
    np.testing.assert_array_equal(out, expected)


@jit
def _clamps(a, out):
    store(minimum(load(a, 0, 0), 1.0), out, 0, 0)
    store(maximum(load(a, 0, 0), 1.0), out, 1, 0)
    store(where_less(load(a, 0, 0), 1.0, 3.0, 4.0), out, 2, 0)


def test_nan_stays_and_is_not_less() -> None:
    a, out = np.array([[NAN, 0.0, 2.0, -np.inf, np.inf, 1.0, -0.5, NAN]]), np.empty((3, lk.WIDTH))
    _clamps(a, out)
    np.testing.assert_array_equal(out[0], [NAN, 0.0, 1.0, -np.inf, 1.0, 1.0, -0.5, NAN])
    np.testing.assert_array_equal(out[1], [NAN, 1.0, 2.0, 1.0, np.inf, 1.0, 1.0, NAN])
    np.testing.assert_array_equal(out[2], [4.0, 3.0, 4.0, 3.0, 4.0, 4.0, 3.0, 4.0])


@jit
def _folds(a):
    sums = spread(0.0)
    for k in range(0, a.shape[1], 8):
        sums += load(a, 1, k)
    return total(sums), largest(load(a, 1, 3))


def test_sums_follow_one_order() -> None:
    a = np.random.default_rng(2).normal(size=(2, 40)) * 10.0 ** np.arange(40)
    by_lane = np.zeros(8)
    for k in range(0, 40, 8):
        by_lane = by_lane + a[1, k : k + 8]
    by_lane = by_lane[:4] + by_lane[4:]
    by_lane = by_lane[:2] + by_lane[2:]
    assert _folds(a) == (by_lane[0] + by_lane[1], a[1, 3:11].max())


@jit
def _fused(a, b, c, rows):
    store(fma(load(rows, 0, 0), load(rows, 1, 0), load(rows, 2, 0)), rows, 0, 0)
    return fma(a, b, c)


def test_multiply_and_add_rounds_once() -> None:
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    rows = np.repeat([[a], [b], [-1.0]], lk.WIDTH, axis=1)
    exact = float(Fraction(a) * Fraction(b) - 1)
    assert exact == -(2.0**-60)
    assert a * b - 1.0 == 0.0
    assert _fused(a, b, -1.0, rows) == exact
    np.testing.assert_array_equal(rows[0], exact)


@jit
def _shifted(a, row, column):
    store(load(a, row, column) * 2.0, a, row, column)


def test_rows_are_read_and_written_where_asked_and_nowhere_else() -> None:
    a = np.arange(60.0).reshape(3, 20)
    expected = a.copy()
    expected[1, 5:13] *= 2.0
    _shifted(a, 1, 5)
    np.testing.assert_array_equal(a, expected)


@jit
def _doubled(vector, k):
    store(load(vector, k) * 2.0, vector, k)


def test_a_vector_is_read_and_written_from_an_entry_on() -> None:
    a = np.arange(20.0)
    _doubled(a, 3)
    np.testing.assert_array_equal(a, np.where((np.arange(20) >= 3) & (np.arange(20) < 11), 2.0, 1.0) * np.arange(20.0))


def test_a_matrix_needs_two_indices() -> None:
    @jit
    def one(a, i):
        return total(load(a, i))

    with pytest.raises(TypingError):
        one(np.zeros((1, 8)), 0)


@pytest.mark.parametrize(("n", "columns"), [(0, 0), (1, 8), (8, 8), (9, 16), (30, 32)])
def test_padding_reaches_whole_vectors(n: int, columns: int) -> None:
    assert lk.padded(n) == columns
