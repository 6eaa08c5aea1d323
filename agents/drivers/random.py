"""A driver with random actions, all equally likely."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader, StatelessDriver
from lanebound.envs.core import DrivingEnv

__all__ = ["RandomDriver"]


class RandomDriver(StatelessDriver):
    """Draws from the action space with a generator of its own.

    Parameters
    ----------
    env : gives the action space
    seed : equal seeds draw equal actions
    """

    def __init__(self, env: DrivingEnv, seed: int = 0) -> None:
        self.action_space = env.action_space
        self._reader = Reader(env.config.observation)
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Begin anew under a seed."""
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation) -> NDArray[Any]:
        """An action, or one for each of a batch."""
        batch = self._reader.value(observation, "ego.speed").shape
        if hasattr(self.action_space, "n"):
            return self._rng.integers(self.action_space.n, size=batch)
        low, high = self.action_space.low, self.action_space.high  # type: ignore[attr-defined]
        return self._rng.uniform(low, high, (*batch, *low.shape)).astype(np.float32)
