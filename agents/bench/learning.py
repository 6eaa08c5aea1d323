"""Speed of learning, end to end: decisions of Highway a second under PPO, against highway-env in two processes.

Both sides learn by the same network with the same settings, but for rollouts, and batches no larger than these: ours of
512 environments with perfect navigation, or of 128 with the whole layer; theirs of the two of ``SubprocVecEnv``.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from lanebound.agents.bench.engine import FULL, PERFECT
from lanebound.agents.bench.environments import bare_of
from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import DrivingEnv, make_config

__all__ = ["measure"]

ID = "lanebound/Highway-v0"
SETTINGS: dict[str, Any] = {"n_epochs": 4, "batch_size": 2048, "gamma": 0.9, "device": "cpu", "seed": 1}
FLAT: dict[str, Any] = {"observation": {"form": "flat"}}


def measure(rounds: int = 5) -> list[Row]:
    """Decisions a second, rollouts and updates, with and without what is sensed."""
    theirs = SubprocVecEnv([_bare] * 2, start_method="spawn")
    try:
        rates = alternate(
            {
                "subproc": _side(theirs, 2),
                "dynamics": _side(EngineVecEnv(ID, 512, PERFECT | FLAT), 16),
                "full": _side(EngineVecEnv(ID, 128, FULL | FLAT), 16),
            },
            rounds,
            1.0,
        )
    finally:
        theirs.close()
    return [
        Row("ppo_end_to_end_vs_subproc2", median_ratio(rates, "dynamics", "subproc"), "x", 1000.0, 3000.0),
        Row("ppo_end_to_end_full_vs_subproc2", median_ratio(rates, "full", "subproc"), "x"),
        Row("ppo_end_to_end_per_s", statistics.median(rates["dynamics"]), "1/s"),
    ]


def _bare() -> Any:
    return Monitor(bare_of(DrivingEnv(make_config(ID, PERFECT))))


def _side(env: VecEnv, steps: int) -> Callable[[], int]:
    """A rollout of so many steps of each environment, and the updates after it."""
    size = steps * env.num_envs
    model = PPO("MlpPolicy", env, n_steps=steps, **{**SETTINGS, "batch_size": min(SETTINGS["batch_size"], size)})

    def learn() -> int:
        model.learn(size, reset_num_timesteps=model.num_timesteps == 0)
        return size

    return learn
