"""A chain of kernels does what its kernels do one after another."""

from __future__ import annotations

import copy
import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest

from lanebound.integrity.core import accel
from lanebound.integrity.core.accel import jit, run_rows
from lanebound.integrity.core.chain_kernel import Chain


class Pair(NamedTuple):
    """Two arrays with a row for each vehicle."""

    a: Any
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
def fail(first, last, pair):
    if pair.a[first] > 2.5:
        raise ValueError("too large")


def _pair() -> Pair:
    return Pair(np.arange(4.0), np.ones(4))


def test_kernels_run_in_their_order_on_the_rows_given() -> None:
    pair = _pair()
    Chain(add, double)(1, 3, pair)
    np.testing.assert_array_equal(pair.a, [0.0, 4.0, 6.0, 3.0])
    Chain(double, add)(0, 1, pair)
    np.testing.assert_array_equal(pair.a, [1.0, 4.0, 6.0, 3.0])


def test_python_functions_take_their_turn() -> None:
    seen = []

    def note(first: int, last: int, pair: Pair) -> None:
        seen.append((first, last, pair.a.copy().tolist()))

    pair = _pair()
    Chain(add, note, double, note)(0, 4, pair)
    assert [s[:2] for s in seen] == [(0, 4)] * 2
    assert [s[2] for s in seen] == [[1.0, 2.0, 3.0, 4.0], [2.0, 4.0, 6.0, 8.0]]


def test_data_of_another_type_get_kernels_of_their_own() -> None:
    chain = Chain(add, double)
    for pair in (
        _pair(),
        Pair(np.arange(4), np.ones(4, dtype=np.int64)),
        Pair(np.arange(8.0)[::2], np.ones(4)),
        _pair(),
    ):
        before = pair.a.copy()
        chain(0, 4, pair)
        np.testing.assert_array_equal(pair.a, 2 * (before + 1))


def test_an_error_of_a_kernel_is_raised_and_ends_the_chain() -> None:
    pair, chain = _pair(), Chain(fail, add)
    with pytest.raises(ValueError, match="too large"):
        chain(3, 4, pair)
    np.testing.assert_array_equal(pair.a, np.arange(4.0))
    chain(0, 1, pair)
    assert pair.a[0] == 1.0


def test_copies_do_the_same() -> None:
    chain = Chain(add, double)
    chain(0, 4, _pair())
    for again in (copy.deepcopy(chain), pickle.loads(pickle.dumps(chain))):
        pair = _pair()
        again(0, 4, pair)
        np.testing.assert_array_equal(pair.a, 2.0 * (np.arange(4.0) + 1.0))


def test_threads_share_a_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accel, "thread_count", lambda pieces: 3)
    pair = Pair(np.arange(1000.0), np.ones(1000))
    run_rows(Chain(add, double), 1000, pair, row_us=10.0)
    np.testing.assert_array_equal(pair.a, 2.0 * (np.arange(1000.0) + 1.0))
