"""A road of one state: the faster, the more reward and the more cost, whose best policy under a limit is known."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces


class Toll(gymnasium.Env[Any, Any]):
    """Ten steps; an action a in [-1, 1] earns ``(a + 1) / 2`` and costs as much squared."""

    LENGTH = 10

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.time = 0
        return self._seen(), {"cost": 0.0}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        share = float((np.clip(action[0], -1.0, 1.0) + 1.0) / 2.0)
        self.time += 1
        return self._seen(), share, False, self.time >= self.LENGTH, {"cost": share**2}

    @classmethod
    def driven_by(cls, model: Any) -> tuple[float, float]:
        """Return and cost of an episode of a policy's mean."""
        env = cls()
        observation, _ = env.reset()
        total, cost, ended = 0.0, 0.0, False
        while not ended:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(action)
            total, cost, ended = total + reward, cost + info["cost"], terminated or truncated
        return total, cost

    def _seen(self) -> Any:
        return np.array([self.time / self.LENGTH, 1.0], dtype=np.float32)


@pytest.fixture
def toll() -> type[Toll]:
    """Under a limit of 2.5 the best is half the speed: a return of 5; without one it is 10, at a cost of 10."""
    return Toll
