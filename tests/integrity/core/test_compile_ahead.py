"""Two processes compile the kernels of a chain; whatever happens to the second one, all are compiled."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import sys
import threading
from importlib import import_module
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core import types

from lanebound.integrity.core import compile_ahead
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.compile_ahead import Ahead
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.epoch import EpochStages
from lanebound.integrity.navigators.rtk_reckoning.epoch_kernel import locate

SOURCE = """
from lanebound.integrity.core.accel import jit


@jit
def one(first, last, x):
    x[first] += 1.0


@jit
def two(first, last, x):
    x[first] *= 2.0


@jit
def three(first, last, x):
    x[first] -= 3.0


@jit
def of_record(first, last, record):
    record.x[first] += 1.0
"""
SIGNATURE = types.int64, types.int64, types.float64[::1]
HANGS = "import time; time.sleep(600.0)"
DIES = "import pickle, sys; pickle.load(sys.stdin.buffer); pickle.load(sys.stdin.buffer)"  # in its first kernel


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """Three kernels of a file of their own that are in no cache."""
    name = f"ahead_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(SOURCE + f"# {tmp_path}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    for name_of_variable in (compile_ahead.VARIABLE, compile_ahead.WORKER):
        monkeypatch.delenv(name_of_variable, raising=False)
    module = import_module(name)
    yield module.one, module.two, module.three
    del sys.modules[name]


def _result(kernels):
    x = np.array([5.0])
    for kernel in kernels:
        kernel(0, 1, x)
    return x[0]


def _misses(kernels):
    return [kernel._cache_misses[SIGNATURE] for kernel in kernels]


def test_this_process_loads_what_the_second_one_has_compiled(kernels):
    assert Ahead.helps(kernels)
    ahead = Ahead(kernels, SIGNATURE)
    ahead._direct()
    ahead.finish()
    for kernel in kernels:
        kernel.compile_inner(SIGNATURE)
    assert _misses(kernels) == [0, 0, 0]
    assert not Ahead.helps(kernels), "all are cached"
    assert _result(kernels) == 9.0


def test_both_share_the_kernels(kernels):
    ahead = Ahead(kernels, SIGNATURE).start()
    ahead.finish()
    assert ahead._waiting == []
    assert ahead._theirs is None
    for kernel in kernels:
        kernel.compile_inner(SIGNATURE)
        assert SIGNATURE in kernel.overloads


@pytest.mark.parametrize("program", ["raise SystemExit(1)", DIES], ids=["at once", "in a kernel"])
def test_when_the_second_process_dies_this_one_compiles_all(kernels, monkeypatch, program):
    monkeypatch.setattr(compile_ahead, "PROGRAM", program)
    ahead = Ahead(kernels, SIGNATURE)
    ahead._direct()
    assert sorted(ahead._waiting) == [0, 1, 2]
    ahead.finish()
    assert _misses(kernels) == [1, 1, 1]
    assert _result(kernels) == 9.0


def _finishes(ahead, within_s=60.0):
    """Whether ``finish`` returns in time; a thread, so that an endless wait fails the test and does not hang it."""
    thread = threading.Thread(target=ahead.finish, daemon=True)
    thread.start()
    thread.join(within_s)
    return not thread.is_alive()


def test_a_signature_that_no_other_process_can_read_is_compiled_by_this_one(kernels):
    class Local(NamedTuple):
        x: Any

    of_record = sys.modules[kernels[0].py_func.__module__].of_record
    signature = types.int64, types.int64, numba.typeof(Local(np.zeros(1)))
    with pytest.raises((AttributeError, TypeError, pickle.PicklingError)):
        pickle.dumps(signature)
    ahead = Ahead([of_record], signature)
    ahead._direct()
    assert ahead._waiting == [0]
    assert _finishes(ahead)
    assert signature in of_record.overloads


def test_a_second_process_that_hangs_is_ended_and_this_one_compiles_all(kernels, monkeypatch, caplog):
    monkeypatch.setattr(compile_ahead, "PROGRAM", HANGS)
    ahead = Ahead(kernels, SIGNATURE, limit_s=0.5)
    director = threading.Thread(target=ahead._direct, daemon=True)
    director.start()
    with ahead._changed:
        assert ahead._changed.wait_for(lambda: ahead._theirs is not None, timeout=300.0)
    assert _finishes(ahead)
    director.join(300.0)
    assert not director.is_alive()
    assert ahead._process.returncode is not None, "the process has ended"
    assert "no kernel in 0.5 s" in caplog.text
    for kernel in kernels:
        kernel.compile_inner(SIGNATURE)
    assert _misses(kernels) == [1, 1, 1]
    assert _result(kernels) == 9.0


def test_after_its_end_a_second_process_gets_no_kernel(kernels):
    ahead = Ahead(kernels, SIGNATURE)
    assert ahead._give() == 0
    ahead._end()
    assert ahead._give() is None
    assert ahead._waiting == [0, 1, 2]


def test_without_permission_for_a_process_this_one_compiles_all(kernels, monkeypatch):
    monkeypatch.setattr(compile_ahead.sys, "executable", "/nowhere/python")
    ahead = Ahead(kernels, SIGNATURE).start()
    ahead.finish()
    assert _misses(kernels) == [1, 1, 1]


def test_a_forked_process_does_not_wait_for_the_second_one_of_its_parent(kernels, monkeypatch):
    ahead = Ahead(kernels, SIGNATURE)
    ahead._give()
    monkeypatch.setattr(compile_ahead.os, "getpid", lambda: os.getppid())
    ahead.finish()  # would wait for ever
    assert _misses(kernels) == [0, 0, 0], "the chain compiles them"


def _set(name, value):
    return lambda patch: patch.setattr(numba.config, name, value)


REASONS = {
    "one processor": _set("NUMBA_NUM_THREADS", 1),
    "a worker process": lambda patch: patch.setattr(multiprocessing, "parent_process", lambda: 1),
    "a worker of pytest-xdist": lambda patch: patch.setenv(compile_ahead.WORKER, "gw0"),
    "switched off": lambda patch: patch.setenv(compile_ahead.VARIABLE, "0"),
    "no interpreter": lambda patch: patch.setattr(sys, "executable", ""),
}


@pytest.mark.parametrize("reason", REASONS)
def test_no_second_process_where_it_would_not_help(kernels, monkeypatch, reason):
    REASONS[reason](monkeypatch)
    assert not Ahead.helps(kernels)


def test_no_second_process_for_kernels_that_it_would_not_find(kernels):
    @jit
    def inner(first, last, x):
        x[first] = 0.0

    assert not Ahead.helps([*kernels, inner])
    assert not Ahead.helps([*kernels, len])


def test_the_heaviest_kernels_come_first(kernels):
    assert Ahead(kernels, SIGNATURE)._heaviest_first == [0, 1, 2], "of one file: in their order"
    assert compile_ahead._source_bytes(kernels[0]) > len(SOURCE)


def test_the_expected_types_are_those_of_an_epoch(monkeypatch):
    made, seen = [], []

    def spy(first, last, epoch):
        seen.append(numba.typeof(epoch))
        locate(first, last, epoch)

    monkeypatch.setattr(EpochStages, "compile_ahead", lambda self, make: made.append(numba.typeof(make())))
    navigator = Navigator.nominal(NavigatorConfig(), seeds=[1], duration_s=60.0)
    monkeypatch.setattr(navigator._stages, "_faultless", [spy])
    rest = np.zeros((1, 2))
    navigator.step(truth_between(0.1, 0.1, (rest, rest), (rest, rest), (np.zeros(1), np.zeros(1))))
    assert made[-1:] == seen
