"""Roads of one state: the faster, the more reward and the more cost, whose best policies under limits are known."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from lanebound.agents.learning.constraints import GroupLimit
from lanebound.envs.costs import CAUSES, GROUPS


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


class TwoTolls(Toll):
    """Two actions a, b earn ``(a + b + 2) / 2``; ``cost_lane`` is a squared share of a, ``cost_headway`` one of b.

    The whole cost is their sum. Under limits of 0.9 and 2.5 the shares of the best are 0.3 and 0.5, whatever the whole
    allows beyond 3.4.
    """

    def __init__(self) -> None:
        super().__init__()
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        seen, _ = super().reset(seed=seed)
        return seen, self._priced(np.zeros(2))

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        shares = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        self.time += 1
        return self._seen(), float(shares.sum()), False, self.time >= self.LENGTH, self._priced(shares**2)

    @staticmethod
    def _priced(costs: Any) -> dict[str, Any]:
        by_cause = np.zeros(len(CAUSES))
        by_cause[[CAUSES.index("cost_lane"), CAUSES.index("cost_headway")]] = costs
        return {"cost": float(costs.sum()), "costs": by_cause}

    @classmethod
    def shares_of(cls, model: Any) -> Any:
        """Shares of both actions by a policy's mean at the start, (2,)."""
        action, _ = model.predict(cls().reset()[0], deterministic=True)
        return (np.clip(action, -1.0, 1.0) + 1.0) / 2.0


@pytest.fixture
def two_tolls() -> type[TwoTolls]:
    """Two costs of two actions, for limits of each."""
    return TwoTolls


def limit_of(group: str, limit: float) -> GroupLimit:
    """The limit of a group at weights of 1."""
    return GroupLimit(group, limit, np.array([float(cause in GROUPS[group]) for cause in CAUSES]))


@pytest.fixture
def two_limits() -> list[GroupLimit]:
    """Limits of both tolls."""
    return [limit_of("lane", 0.9), limit_of("headway", 2.5)]


@pytest.fixture
def toll() -> type[Toll]:
    """Under a limit of 2.5 the best is half the speed: a return of 5; without one it is 10, at a cost of 10."""
    return Toll
