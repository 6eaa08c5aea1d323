"""Speed of each id as it is shipped: policy steps a second of the vector engine, against single environments.

Resets count on both sides; actions are random.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import SubprocVecEnv

from lanebound.agents.bench.engine import SEED, engine_side
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.envs.ids import Preset, has_engine, presets
from lanebound.envs.vector.engine import Engine

__all__ = ["measure"]

COUNT = 64
SURROGATE: dict[str, Any] = {"perception": {"others": "surrogate"}}


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


def _subproc_side(kind: type[Preset], envs: SubprocVecEnv) -> Callable[[], int]:
    """A policy step of environments of SB3, which resets them."""
    envs.seed(SEED)
    envs.reset()
    envs.action_space.seed(SEED)

    def step() -> int:
        envs.step(np.array([envs.action_space.sample() for _ in range(envs.num_envs)]))
        return envs.num_envs

    return step


def measure(rounds: int = 5) -> list[Row]:
    """Of each id with an engine: steps a second of the engine, ratios to one single environment and to two of SB3.

    Where others have radio, steps a second with surrogates as well.
    """
    return [row for kind in filter(has_engine, presets()) for row in _of_id(kind, rounds)]


def _of_id(kind: type[Preset], rounds: int) -> list[Row]:
    step, ours = engine_side(kind, COUNT, {})
    sides, name = {"engine": step, "single": _single_side(kind)}, kind.__name__
    assert isinstance(ours.engine, Engine)
    if ours.engine.episodes.perception.has_radio:
        sides["surrogate"] = engine_side(kind, COUNT, SURROGATE)[0]
    with closing(SubprocVecEnv([kind] * 2, start_method="spawn")) as envs:
        rates = alternate({**sides, "subproc": _subproc_side(kind, envs)}, rounds, 1.0)
    rows = [
        Row(f"preset_{name}_steps_per_s", statistics.median(rates["engine"]), "1/s", 10_000.0, 20_000.0),
        Row(f"preset_{name}_vs_subproc", median_ratio(rates, "engine", "subproc"), "x", 200.0),
        Row(f"preset_{name}_vs_single", median_ratio(rates, "engine", "single"), "x"),
    ]
    if "surrogate" in rates:
        rows.append(Row(f"preset_{name}_surrogate_per_s", statistics.median(rates["surrogate"]), "1/s"))
    return rows
