"""Kernels are compiled with a wrapper for Python only where Python calls them, and cached in both forms."""

from __future__ import annotations

import gc
import pickle
from importlib.util import module_from_spec, spec_from_file_location

import numba
import numpy as np
import pytest
from numba.core import types

from lanebound.integrity.core import kernel_dispatcher as kd
from lanebound.integrity.core.kernel_cache import locating

SOURCE = "def plus(x):\n    return x + 1\n\n\ndef twice(x):\n    return plus(x) * 2\n"
F8, I8 = (types.float64,), (types.int64,)


@pytest.fixture
def fresh(tmp_path):
    """Makes the two kernels anew, as another process would, with one cache on disk."""
    (tmp_path / "pair.py").write_text(SOURCE)

    def make():
        spec = spec_from_file_location("pair", tmp_path / "pair.py")
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        for name in ("plus", "twice"):
            kernel = kd.kernel_of(getattr(module, name))
            with locating(str(tmp_path)):
                kernel.enable_caching()
            setattr(module, name, kernel)
        return module

    return make


def test_a_kernel_that_kernels_call_has_no_wrapper_until_python_calls_it(fresh):
    pair = fresh()
    assert pair.twice(1.5) == 5.0
    assert kd._is_outer(pair.twice.overloads[F8])
    assert not kd._is_outer(pair.plus.overloads[F8])
    assert pair.plus(1.5) == 2.5
    assert kd._is_outer(pair.plus.overloads[F8])
    assert pair.twice(2.5) == 7.0, "its callee was compiled again"
    assert pair.plus.signatures == [F8]


def test_both_forms_are_cached(fresh):
    pair = fresh()
    assert not pair.plus.is_cached
    pair.twice(1.5), pair.plus(1.5), pair.plus(2)
    assert pair.plus.is_cached
    again = fresh()
    assert again.plus.is_cached
    assert (again.plus(1.5), again.plus(2), again.twice(1.5), again.twice(2)) == (2.5, 3, 5.0, 6)
    assert again.plus._cache_misses[F8] == again.plus._cache_misses[I8] == 0
    assert again.twice._cache_misses == {I8: 1}


def test_a_kernel_without_its_wrapper_in_the_cache_is_compiled_for_python(fresh):
    fresh().twice(1.5)
    again = fresh()
    assert again.plus(1.5) == 2.5
    assert again.plus._cache_misses[F8] == 1


def test_a_caller_takes_the_form_with_wrapper_where_only_that_is_cached(fresh):
    fresh().plus(1.5)
    again = fresh()
    assert again.twice(1.5) == 5.0
    assert again.plus._cache_misses[F8] == 0


def test_two_processes_that_save_at_once_write_different_files(fresh, monkeypatch):
    one, other = fresh(), fresh()
    for kernel in (one.plus, other.plus):  # both have read the index before either writes it
        monkeypatch.setattr(kernel._cache._cache_file, "_load_index", dict)
    one.plus(1.5)
    monkeypatch.setattr(kd.os, "getpid", lambda: 1)
    other.plus(2)
    again = fresh()
    assert (again.plus(1.5), again.plus(2)) == (2.5, 3), "the code of a signature is that of another"


def test_a_kernel_is_compiled_for_kernels_before_any_calls_it(fresh):
    plus = fresh().plus
    plus.compile_inner(F8)
    assert not kd._is_outer(plus.overloads[F8])
    assert fresh().twice(1.5) == 5.0
    assert plus(1.5) == 2.5


def test_errors_and_pickles_are_those_of_numba(fresh):
    pair = fresh()
    with pytest.raises(numba.TypingError):
        pair.twice("a")
    assert pickle.loads(pickle.dumps(pair.twice)) is pair.twice


def test_garbage_is_collected_as_before_after_a_compilation(fresh):
    before = gc.get_threshold()
    try:
        gc.set_threshold(701, 11, 12)
        fresh().twice(np.float32(1.5))
        assert gc.get_threshold() == (701, 11, 12)
        with kd._compiling():
            assert gc.get_threshold() == (kd.COLLECTION, 11, 12)
        gc.set_threshold(0)
        with kd._compiling():
            assert gc.get_threshold()[0] == 0, "a program that collects nothing is left alone"
    finally:
        gc.set_threshold(*before)


def test_without_compilation_a_kernel_is_the_function(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert kd.kernel_of(len) is len


def test_this_version_of_numba_has_all_that_is_needed():
    assert kd._missing() == []


def test_a_version_of_numba_without_a_needed_attribute_compiles_plain_functions(fresh, monkeypatch):
    monkeypatch.setattr(kd, "NEEDED", (*kd.NEEDED, (kd.CPUDispatcher, ("not_there",))))
    assert kd._missing() == ["CPUDispatcher.not_there"]
    pair = fresh()
    assert not isinstance(pair.plus, kd.Kernel)
    assert (pair.twice(1.5), pair.plus(2)) == (5.0, 3)
    again = fresh()
    assert again.plus(2) == 3
    assert sum(again.plus.stats.cache_hits.values()) == 1, "cached on disk"


def test_constants_and_arrays_of_records_share_the_form_for_numbers_and_arrays():
    @kd.kernel_of
    def pick(values, k, doubled):
        return values[k] * (2.0 if doubled else 1.0)

    @kd.kernel_of
    def total(records, values, k):
        record = records[0]
        return pick(record.place, 0, True) + pick(record.place, 2, False) + pick(values, k, k > 1)

    records = np.zeros(1, np.dtype([("number", "f8"), ("place", "f8", (3,))], align=True))
    records["place"] = 1.0, 2.0, 3.0
    assert total(records, np.array([10.0, 20.0]), 1) == 2.0 + 3.0 + 20.0
    assert list(pick.overloads) == [(types.float64[::1], types.int64, types.boolean)]
