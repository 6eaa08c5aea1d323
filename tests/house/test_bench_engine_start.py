"""The benchmarks of a busy machine and of an empty cache of kernels."""

from __future__ import annotations

import os
import subprocess

import numpy as np
import pytest

from lanebound.agents.bench import environments, runner

REPORT = """
import os, pathlib
cache = pathlib.Path(os.environ["NUMBA_CACHE_DIR"])
pathlib.Path({seen!r}).write_text(f"{{cache}} {{len(list(cache.iterdir()))}}")
"""


class FakeEnv:
    """An engine that is ten times slower while the busy process runs."""

    def __init__(self, env_id, count, config):
        self.count, self.closed = count, False

    def seed(self, seed):
        return [seed]

    def reset(self):
        return None

    def step(self, actions):
        assert actions.shape == (self.count, 2)
        assert np.abs(actions).max() <= 1.0
        environments.time.now += 0.1 if environments.time.beside else 0.01

    def close(self):
        self.closed = True


class FakeTime:
    now, beside = 0.0, False

    def perf_counter(self):
        return self.now


def test_the_ratio_is_of_steps_beside_the_process_over_those_alone(monkeypatch):
    clock, real, processes = FakeTime(), environments.beside_busy_process, []

    @environments.contextmanager
    def beside():
        with real() as process:
            processes.append(process)
            clock.beside = process.poll() is None
            yield process
        clock.beside = False

    monkeypatch.setattr(environments, "time", clock)
    monkeypatch.setattr(environments, "EngineVecEnv", FakeEnv)
    monkeypatch.setattr(environments, "beside_busy_process", beside)
    (row,) = environments.measure_busy(rounds=2)
    assert (row.name, row.gate, row.stretch, row.higher_is_better) == ("engine_beside_busy_process", 0.4, 0.6, True)
    assert row.value == pytest.approx(0.1, rel=0.05)
    assert len(processes) == 2
    assert all(process.poll() is not None for process in processes), "the processes are stopped"


def test_a_cold_start_has_an_empty_cache_of_its_own(monkeypatch, tmp_path):
    seen = tmp_path / "seen"
    monkeypatch.setattr(environments, "PROGRAM", REPORT.format(seen=str(seen)))
    (row,) = environments.measure_cold(rounds=5)
    assert (row.name, row.gate, row.stretch, row.higher_is_better) == ("engine_cold_start_s", 90.0, 45.0, False)
    assert 0.0 < row.value < 60.0
    cache, files = seen.read_text().split()
    assert files == "0"
    assert cache != os.environ.get("NUMBA_CACHE_DIR")
    assert not os.path.exists(cache), "the cache is removed"


def test_a_cold_start_that_fails_is_a_failure(monkeypatch):
    monkeypatch.setattr(environments, "PROGRAM", "raise SystemExit(3)")
    with pytest.raises(subprocess.CalledProcessError):
        environments.measure_cold()


def test_both_are_found_and_only_the_short_one_runs_unasked():
    assert "busy" in runner.select([])
    assert "cold" not in runner.select([])
