"""Speed of the vector engine: policy steps of Highway a second, against highway-env's own environment.

Both sides have the same roads, vehicles, rates and kind of actions; highway-env observes its Kinematics, the engine all
of an observation of ours.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lanebound.agents.bench.environments import bare_of
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.vector import VectorHighway

__all__ = ["measure"]

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
MANY, SEED, TURNS = 512, 1, 64


def _bare_side() -> Callable[[], int]:
    env = bare_of(DrivingEnv(make_config("lanebound/Highway-v0", PERFECT)))
    env.reset(seed=SEED)
    rng = np.random.default_rng(SEED)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(int(rng.integers(5)))
        if terminated or truncated:
            env.reset()
        return 1

    return step


def _engine_side(count: int, config: dict[str, Any]) -> tuple[Callable[[], int], VectorHighway]:
    env = VectorHighway(count, config, autoreset_mode="SameStep")
    env.reset(seed=SEED)
    actions, turn = np.random.default_rng(SEED).integers(5, size=(TURNS, count)), iter(range(10**9))

    def step() -> int:
        env.step(actions[next(turn) % TURNS])
        return count

    return step, env


def measure(rounds: int = 5) -> list[Row]:
    """Ratios of policy steps a second, resets included on both sides, and the memory of an environment."""
    many, env = _engine_side(MANY, PERFECT)
    sides = {"bare": _bare_side(), "many": many, "one": _engine_side(1, PERFECT)[0]}
    rates = alternate(sides, rounds, seconds=1.0)
    ratio = {name: median_ratio(rates, name, "bare") for name in ("many", "one")}
    return [
        Row("engine_dynamics_vs_highway_2core", ratio["many"], "x", 5000.0, 12000.0),
        Row("engine_dynamics_vs_highway_1env", ratio["one"], "x", 2500.0, 5000.0),
        Row("engine_memory_per_environment", env.engine.bytes_per_environment / 1024.0, "KiB", higher_is_better=False),
    ]
