"""Speed of the vector engine beside one other process that never waits, over its speed alone."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from lanebound.agents.bench.rows import Row
from lanebound.agents.vec_env import EngineVecEnv

__all__ = ["beside_busy_process", "measure"]

ID, COUNT, ACTIONS, SEED = "lanebound/LaneKeeping-v0", 64, 8, 1
TURN_S = 2.0
BUSY = "print(flush=True)\nwhile True: pass"


@contextmanager
def beside_busy_process() -> Iterator[subprocess.Popen[bytes]]:
    """Inside this context one process computes without end."""
    with subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()  # it has started
            yield process
        finally:
            process.kill()


def measure(rounds: int = 5) -> list[Row]:
    """Median over rounds of steps a second beside the busy process, over those alone just before."""
    env = EngineVecEnv(ID, COUNT, {"observation": {"form": "flat"}})
    try:
        env.seed(SEED)
        env.reset()
        actions = np.random.default_rng(SEED).normal(0.0, 0.1, (ACTIONS, COUNT, 2)).clip(-1.0, 1.0).astype(np.float32)
        turn = iter(range(10**9))

        def step() -> None:
            env.step(actions[next(turn) % ACTIONS])

        step()
        ratios = []
        for _ in range(rounds):
            alone = _rate(step)
            with beside_busy_process():
                ratios.append(_rate(step) / alone)
    finally:
        env.close()
    return [Row("engine_beside_busy_process", statistics.median(ratios), "-", 0.4, 0.6)]


def _rate(step: Callable[[], None]) -> float:
    """Calls a second over one turn."""
    begun, calls = time.perf_counter(), 0
    while (elapsed := time.perf_counter() - begun) < TURN_S:
        step()
        calls += 1
    return calls / elapsed
