"""How long the command line takes to start, with its bytecode cached."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

from lanebound.agents.bench.rows import Row

__all__ = ["measure"]

COMMAND = [sys.executable, "-c", "from lanebound.agents.cli import main; main()", "--version"]


def _seconds() -> float:
    start = time.perf_counter()
    subprocess.run(COMMAND, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def measure(rounds: int = 5) -> list[Row]:
    """Median time of ``lanebound --version`` in a process of its own, after one run that fills the caches."""
    _seconds()
    median = statistics.median(_seconds() for _ in range(rounds))
    return [Row("cli_start_cached_s", median, "s", gate=1.0, stretch=0.4, higher_is_better=False)]
