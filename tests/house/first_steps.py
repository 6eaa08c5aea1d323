"""The seconds to the first steps of every id, alone and in the engine: ``python first_steps.py [ID...]``."""

from __future__ import annotations

import sys
import time

import gymnasium

from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs.ids.preset import id_of
from lanebound.envs.ids.registry import presets
from lanebound.integrity.core.errors import ConfigError


def alone(env_id: str) -> None:
    """Some random steps of one environment."""
    env = gymnasium.make(env_id)
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    env.close()


def many(env_id: str) -> None:
    """Some steps of eight environments in the engine, for those that have one."""
    envs = EngineVecEnv(env_id, 8, {"observation": {"form": "flat"}})
    envs.reset()
    for _ in range(3):
        envs.step([envs.action_space.sample() for _ in range(8)])
    envs.close()


if __name__ == "__main__":
    for env_id in sys.argv[1:] or [id_of(kind) for kind in presets()]:
        for what in (alone, many):
            start = time.perf_counter()
            try:
                what(env_id)
                print(f"{env_id} {what.__name__}: {time.perf_counter() - start:.1f} s", flush=True)
            except ConfigError as refusal:
                print(f"{env_id} {what.__name__}: {refusal}", flush=True)
