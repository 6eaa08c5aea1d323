"""Speed of the vector engine: policy steps of Highway a second, against highway-env's own environment.

Both sides have the same roads, vehicles, rates and kind of actions; highway-env observes its Kinematics, the engine all
of an observation of ours.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

import numpy as np

from lanebound.agents.bench.environments import bare_of
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.ids import Highway, Preset
from lanebound.envs.vector import VectorDrivingEnv, engine_class

__all__ = ["SEED", "engine_side", "measure"]

PERFECT: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
FULL: dict[str, Any] = {"perception": {"source": "truth"}}
V2V: dict[str, Any] = {}  # as the id presets it
MANY, HEARING, SEED, TURNS = 512, 8, 1, 64


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


def engine_side(
    kind: type[Preset], count: int, config: dict[str, Any]
) -> tuple[Callable[[], int], VectorDrivingEnv]:  # fmt: skip
    """A policy step of so many environments of an id under random actions, and these environments."""
    env = engine_class(kind)(count, config, autoreset_mode="SameStep")
    env.reset(seed=SEED)
    env.action_space.seed(SEED)
    actions, turn = [env.action_space.sample() for _ in range(TURNS)], iter(range(10**9))

    def step() -> int:
        env.step(actions[next(turn) % TURNS])
        return count

    return step, env


def measure(rounds: int = 5) -> list[Row]:
    """Ratios of policy steps a second, resets included on both sides; rates of ours; the memory of an environment."""
    cases = {"many": (MANY, PERFECT), "one": (1, PERFECT), "full": (MANY, FULL), "v2v": (HEARING, V2V)}
    engines = {name: engine_side(Highway, count, config) for name, (count, config) in cases.items()}
    rates = alternate({"bare": _bare_side(), **{name: step for name, (step, _) in engines.items()}}, rounds, 1.0)
    ratio = {name: median_ratio(rates, name, "bare") for name in cases}
    size = {name: env.engine.bytes_per_environment / 1024.0 for name, (_, env) in engines.items()}
    return [
        Row("engine_dynamics_vs_highway_2core", ratio["many"], "x", 5000.0, 12000.0),
        Row("engine_dynamics_vs_highway_1env", ratio["one"], "x", 2500.0, 5000.0),
        Row("engine_full_vs_highway_2core", ratio["full"], "x", 1000.0, 3000.0),
        Row("engine_v2v_vs_highway_2core", ratio["v2v"], "x", 200.0, 600.0),
        Row("engine_dynamics_per_s", statistics.median(rates["many"]), "1/s"),
        Row("engine_full_per_s", statistics.median(rates["full"]), "1/s"),
        Row("engine_memory_per_environment", size["many"], "KiB", higher_is_better=False),
        Row("engine_full_memory_per_environment", size["full"], "KiB", higher_is_better=False),
        Row("engine_v2v_memory_per_environment", size["v2v"], "KiB", higher_is_better=False),
    ]
