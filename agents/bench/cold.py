"""Cold start: from the start of Python to the first step of the vector engine, with an empty cache of kernels."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from lanebound.agents.bench.rows import Row

__all__ = ["measure"]

PROGRAM = """
import gymnasium, lanebound.envs
env = gymnasium.make_vec("lanebound/LaneKeeping-v0", 64)
env.reset(seed=1)
env.step(env.action_space.sample())
"""


def measure(rounds: int = 1) -> list[Row]:
    """One start in a process of its own; it takes minutes, so that ``rounds`` does not repeat it.

    Raises
    ------
    subprocess.CalledProcessError
        The process failed; its message is on standard error.
    """
    with tempfile.TemporaryDirectory() as cache:
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", PROGRAM], check=True, env={**os.environ, "NUMBA_CACHE_DIR": cache})
        seconds = time.perf_counter() - begun
    return [Row("engine_cold_start_s", seconds, "s", 90.0, 45.0, higher_is_better=False)]
