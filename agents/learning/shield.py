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
    """A driver that does what it was told last."""

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

    Raises
    ------
    InputError
        As :class:`~lanebound.agents.drivers.barrier.BarrierFilter`.
    """

    def __init__(self, venv: VecEnv, single: DrivingEnv) -> None:
        super().__init__(venv)
        self._given = _Given()
        self._filter = BarrierFilter(single, self._given)
        self._seen: Any = None
        self._starts = np.ones(venv.num_envs, dtype=np.bool_)
        self._changed = np.zeros(venv.num_envs, dtype=np.bool_)

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        self._seen = self.venv.reset()
        self._starts = np.ones(self.num_envs, dtype=np.bool_)
        return self._seen

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hand on the nearest safe actions."""
        self._given.action = np.asarray(actions, dtype=np.float32)
        safe, _ = self._filter.predict(self._seen, episode_start=self._starts)
        self._changed = np.any(safe != self._given.action, axis=-1)
        self.venv.step_async(safe)

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """What came of them."""
        self._seen, rewards, self._starts, infos = self.venv.step_wait()
        for info, changed in zip(infos, self._changed.tolist(), strict=True):
            info["shielded"] = changed
        return self._seen, rewards, self._starts, infos
