"""Speed of each id as it is shipped: policy steps a second of the vector engine, against one single environment.

Resets count on both sides; actions are random.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

from lanebound.agents.bench.engine import SEED, engine_side
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.envs.ids import Preset, has_engine, presets

__all__ = ["measure"]

COUNT = 64


def _single_side(kind: type[Preset]) -> Callable[[], int]:
    env = kind()
    env.reset(seed=SEED)
    env.action_space.seed(SEED)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        return 1

    return step


def measure(rounds: int = 5) -> list[Row]:
    """Steps a second of the engine, and the ratio to one single environment, for each id that has an engine."""
    rows = []
    for kind in filter(has_engine, presets()):
        sides = {"engine": engine_side(kind, COUNT, {})[0], "single": _single_side(kind)}
        rates, name = alternate(sides, rounds, 1.0), kind.__name__
        rows.append(Row(f"preset_{name}_steps_per_s", statistics.median(rates["engine"]), "1/s", 10_000.0, 20_000.0))
        rows.append(Row(f"preset_{name}_vs_single", median_ratio(rates, "engine", "single"), "x"))
    return rows
