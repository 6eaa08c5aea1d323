"""An environment whose every action passes the barrier filter first."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from lanebound.agents.drivers.barrier import BarrierFilter
from lanebound.envs.core import DrivingEnv

__all__ = ["Shielded"]


class _Given:
    """A driver that does what it was told last."""

    def __init__(self) -> None:
        self.action: Any = None

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        """The action."""
        return self.action, state


class Shielded(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Carries out what the filter makes of an action; ``info["shielded"]`` tells whether it changed it.

    Raises
    ------
    InputError
        As :class:`~lanebound.agents.drivers.barrier.BarrierFilter`.
    """

    def __init__(self, env: DrivingEnv) -> None:
        super().__init__(env)
        self._given = _Given()
        self._filter = BarrierFilter(env, self._given)
        self._seen: Any = None
        self._first = True

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._seen, info = self.env.reset(seed=seed, options=options)
        self._first = True
        return self._seen, {**info, "shielded": False}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Carry out the nearest safe action."""
        self._given.action = np.asarray(action, dtype=np.float32)
        safe, _ = self._filter.predict(self._seen, episode_start=np.array(self._first))
        self._first = False
        self._seen, reward, terminated, truncated, info = self.env.step(safe)
        changed = bool(np.any(safe != self._given.action))
        return self._seen, reward, terminated, truncated, {**info, "shielded": changed}
