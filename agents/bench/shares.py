"""Where the time of learning goes: shares of PPO of Stable-Baselines3 in LaneKeeping, by processor time of one core.

And what threads of torch do to the update: its time on two threads over that on one, by the clock.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import closing
from importlib import import_module
from typing import Any

import torch
from stable_baselines3 import PPO

from lanebound.agents.bench.rows import Row
from lanebound.agents.learning.training import one_thread
from lanebound.agents.vec_env import EngineVecEnv

__all__ = ["measure"]

ID, COUNT, STEPS = "lanebound/LaneKeeping-v0", 64, 64
FORMS = {"flat": "MlpPolicy", "dict": "MultiInputPolicy"}
SETTINGS: dict[str, Any] = {"batch_size": 512, "n_epochs": 10, "device": "cpu", "seed": 1}


def measure(rounds: int = 5) -> list[Row]:
    """Shares of a rollout and its update, for either form of observations; the update on two threads."""
    rows = []
    for form, policy in FORMS.items():
        with one_thread(), closing(EngineVecEnv(ID, COUNT, {"observation": {"form": form}})) as env:
            model = PPO(policy, env, n_steps=STEPS, **SETTINGS)
            model.learn(COUNT * STEPS)
            shares = _shares(model, env, rounds)
            ratio = statistics.median(_update_s(model, 2) / _update_s(model, 1) for _ in range(rounds))
        rows += [Row(f"ppo_{form}_{name}_share", 100.0 * share, "%") for name, share in shares.items()]
        rows.append(Row(f"ppo_{form}_update_2_threads", ratio, "x", higher_is_better=False))
    return rows


def _shares(model: PPO, env: EngineVecEnv, rounds: int) -> dict[str, float]:
    """Shares of the processor time of so many rollouts and updates."""
    spent: dict[str, float] = {}
    vector = env.envs
    for owner, method, name in (
        (vector.engine, "step", "step"),
        (vector, "_restart", "reset"),
        (env, "step_wait", "environment"),
        (model.policy, "forward", "policy"),
        (model, "train", "update"),
        (model.rollout_buffer, "add", "copy"),
    ):
        setattr(owner, method, _timed(getattr(owner, method), spent, name))
    rollouts: Any = import_module("stable_baselines3.common.on_policy_algorithm")  # imports the function of the copy
    to_torch = rollouts.obs_as_tensor
    rollouts.obs_as_tensor = _timed(to_torch, spent, "copy")
    try:
        begun = time.process_time()
        model.learn(rounds * COUNT * STEPS, reset_num_timesteps=False)
        total = time.process_time() - begun
    finally:
        rollouts.obs_as_tensor = to_torch
    spent["environment"] -= spent["step"] + spent["reset"]
    spent["rest"] = total - sum(spent.values())
    return {name: seconds / total for name, seconds in sorted(spent.items(), key=lambda item: -item[1])}


def _timed(function: Callable[..., Any], spent: dict[str, float], name: str) -> Callable[..., Any]:
    """The function, whose processor time is added to that of its name."""

    def timed(*arguments: Any, **settings: Any) -> Any:
        begun = time.process_time()
        found = function(*arguments, **settings)
        spent[name] = spent.get(name, 0.0) + time.process_time() - begun
        return found

    return timed


def _update_s(model: PPO, threads: int) -> float:
    """Clock time of an update on so many threads of torch."""
    torch.set_num_threads(threads)
    begun = time.perf_counter()
    model.train()
    return time.perf_counter() - begun
