"""Environments whose every action passes the barrier filter first."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

from lanebound.agents.drivers.barrier import BarrierFilter
from lanebound.envs.core import DrivingEnv

__all__ = ["VecShielded"]


class _Given:
    """A driver whose action is the one that was set last."""

    def __init__(self) -> None:
        self.action: Any = None

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        """The action."""
        return self.action, state


class VecShielded(VecEnvWrapper):
    """Carries out what the filter makes of actions; ``infos[i]["shielded"]`` tells whether it changed one.

    Parameters
    ----------
    venv : environments of one configuration that start anew at once
    single : one of them, asked for its observations, actions and limits; it is not driven
    penalty : taken off the reward, times the mean square of what was changed of an action

    Raises
    ------
    InputError
        As :class:`~lanebound.agents.drivers.barrier.BarrierFilter`.
    """

    def __init__(self, venv: VecEnv, single: DrivingEnv, penalty: float = 0.0) -> None:
        super().__init__(venv)
        self._penalty = penalty
        self._given = _Given()
        self._filter = BarrierFilter(single, self._given)
        self._seen: Any = None
        self._starts = np.ones(venv.num_envs, dtype=np.bool_)
        self._change = np.zeros((venv.num_envs, 1))

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        self._seen = self.venv.reset()
        self._starts = np.ones(self.num_envs, dtype=np.bool_)
        return self._seen

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hand on the nearest safe actions."""
        self._given.action = np.asarray(actions, dtype=np.float32)
        safe, _ = self._filter.predict(self._seen, episode_start=self._starts)
        self._change = safe - np.clip(self._given.action, -1.0, 1.0)
        self.venv.step_async(safe)

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """What came of them."""
        self._seen, rewards, self._starts, infos = self.venv.step_wait()
        for info, changed in zip(infos, np.any(self._change != 0.0, axis=-1).tolist(), strict=True):
            info["shielded"] = changed
        less = np.asarray(self._penalty * np.mean(self._change**2, axis=-1), dtype=np.float32)
        return self._seen, rewards - less, self._starts, infos
