"""The time that kernels take, and whether they are there."""

from __future__ import annotations

import time
from pathlib import Path

from lanebound.agents.benchmark import compiling
from lanebound.agents.benchmark.compiling import CompileClock, kernels_are_cached
from lanebound.integrity.core import accel


def test_kernels_within_kernels_count_once(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    shared = [0.0, 0.0]
    clock, seen = CompileClock(shared), CompileClock(shared)
    clock.begin()
    now[0] = 100.5
    assert not seen.at_work  # so short a time is one of loading
    clock.begin()
    now[0] = 103.0
    assert seen.at_work
    clock.end()
    assert seen.spent_s == 0.0
    now[0] = 104.0
    clock.end()
    assert (seen.spent_s, seen.at_work) == (4.0, False)


def test_numba_tells_when_it_compiles():
    import numba

    clock = CompileClock([0.0, 0.0])
    clock.watch()

    @numba.njit
    def twice(x):
        return 2 * x

    assert twice(2) == 4
    assert clock.spent_s > 0.0


def test_a_cache_is_warm_when_most_kernels_are_in_it(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(accel, "cache_directory", lambda: str(tmp_path))
    assert not kernels_are_cached()
    (tmp_path / "sky").mkdir()
    for k in range(compiling.KEPT_AT_LEAST):
        (tmp_path / "sky" / f"{k}.nbi").touch()
    assert kernels_are_cached()
    monkeypatch.setattr(accel, "cache_directory", lambda: None)
    assert not kernels_are_cached()
