"""A chain of kernels does what its kernels do one after another."""

from __future__ import annotations

import copy
import pickle
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest

from lanebound.integrity.core import accel
from lanebound.integrity.core.accel import jit, run_rows
from lanebound.integrity.core.bundle_kernel import Bundle
from lanebound.integrity.core.chain_kernel import Chain


class Pair(NamedTuple):
    """Two arrays with a row for each vehicle."""

    a: Any
    b: Any


class Sums(NamedTuple):
    """The array that lasts."""

    a: Any


class Terms(NamedTuple):
    """The array of one call."""

    b: Any


@jit
def add(first, last, pair):
    for v in range(first, last):
        pair.a[v] += pair.b[v]


@jit
def double(first, last, pair):
    for v in range(first, last):
        pair.a[v] *= 2.0


@jit
def add_slices(first, last, pair):
    for v in range(first, last):
        own = pair.a[v : v + 1].copy() + pair.b[v : v + 1]
        pair.a[v] = own[0]


@jit
def fail(first, last, pair):
    if pair.a[first] > 2.5:
        raise ValueError("too large")


def _data(size: int = 4) -> tuple[Bundle, Terms]:
    return Bundle(Sums(np.arange(float(size)))), Terms(np.ones(size))


def test_kernels_run_in_their_order_on_the_rows_given() -> None:
    sums, terms = _data()
    Chain(Pair, add, double)(1, 3, sums, terms)
    np.testing.assert_array_equal(sums.values.a, [0.0, 4.0, 6.0, 3.0])
    Chain(Pair, double, add)(0, 1, sums, terms)
    np.testing.assert_array_equal(sums.values.a, [1.0, 4.0, 6.0, 3.0])


def test_the_arrays_of_a_call_may_differ_from_call_to_call() -> None:
    (sums, _), chain = _data(), Chain(Pair, add)
    for k in range(3):
        chain(0, 4, sums, Terms(np.full(4, float(k))))
    np.testing.assert_array_equal(sums.values.a, np.arange(4.0) + 3.0)


def test_arrays_outlive_the_slices_that_kernels_take() -> None:
    sums, terms = _data()
    references = sys.getrefcount(sums.values.a), sys.getrefcount(terms.b)
    chain = Chain(Pair, add_slices)
    for _ in range(100):
        chain(0, 4, sums, terms)
    assert (sys.getrefcount(sums.values.a), sys.getrefcount(terms.b)) == references
    np.testing.assert_array_equal(sums.values.a, np.arange(4.0) + 100.0)


def test_data_of_another_type_get_kernels_of_their_own() -> None:
    chain = Chain(Pair, add, double)
    for a, b in (
        (np.arange(4.0), np.ones(4)),
        (np.arange(4), np.ones(4, dtype=np.int64)),
        (np.arange(8.0)[::2], np.ones(4)),
        (np.arange(4.0), np.ones(4)),
    ):
        before = a.copy()
        chain(0, 4, Bundle(Sums(a)), Terms(b))
        np.testing.assert_array_equal(a, 2 * (before + 1))


def test_a_whole_of_other_fields_is_refused() -> None:
    with pytest.raises(TypeError, match=r"Pair must have the fields \('b', 'a'\), got \('a', 'b'\)"):
        Chain(Pair, add)(0, 4, Bundle(Terms(np.ones(4))), Sums(np.ones(4)))


def test_an_error_of_a_kernel_is_raised_and_ends_the_chain() -> None:
    (sums, terms), chain = _data(), Chain(Pair, fail, add)
    with pytest.raises(ValueError, match="too large"):
        chain(3, 4, sums, terms)
    np.testing.assert_array_equal(sums.values.a, np.arange(4.0))
    chain(0, 1, sums, terms)
    assert sums.values.a[0] == 1.0


def test_copies_do_the_same() -> None:
    chain = Chain(Pair, add, double)
    chain(0, 4, *_data())
    for again in (copy.deepcopy(chain), pickle.loads(pickle.dumps(chain))):
        sums, terms = _data()
        again(0, 4, sums, terms)
        np.testing.assert_array_equal(sums.values.a, 2.0 * (np.arange(4.0) + 1.0))


def test_threads_share_a_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accel, "thread_count", lambda pieces: 3)
    sums, terms = _data(1000)
    run_rows(Chain(Pair, add, double), 1000, sums, terms, row_us=10.0)
    np.testing.assert_array_equal(sums.values.a, 2.0 * (np.arange(1000.0) + 1.0))
