"""Drivers of ``lanebound/Journey-v0``: they choose the next street by what is predicted of the rest of the journey.

Each decision is made anew with what was met: the time since RTK as experienced, and the time without a position so far.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import StatelessDriver
from lanebound.envs.journeys.config import JourneyConfig
from lanebound.envs.journeys.engine import ENTRIES, HOUR_ENTRIES, STREET_ENTRIES
from lanebound.envs.journeys.records import MOST_STREETS
from lanebound.integrity.sky.journeys.planner import MOST_UNUSABLE, WEIGHT

__all__ = [
    "JOURNEY_DRIVERS",
    "ChanceConstrainedWay",
    "FastestWay",
    "IntegrityAwareWay",
    "JourneyDriver",
    "OracleWay",
    "ShortestWay",
]

Array = NDArray[np.float64]

BEYOND = 1e3  # more than all times
NEVER = 1e9  # cost of a street that does not exist


class SeesTruth(Protocol):
    """An environment of journeys, or N of them."""

    def oracle_observation(self) -> NDArray[np.float32]:
        """The observation with a forecast by the true city."""


class JourneyDriver(StatelessDriver):
    """Takes the street of least cost; at a departure that is to be chosen the hour with the best integrity-aware route.

    Parameters
    ----------
    config : of the environment
    """

    def __init__(self, config: JourneyConfig | None = None) -> None:
        self.config = config or JourneyConfig()

    def act(self, observation: Any) -> Any:
        """The action for an observation (n,), or one for each of a batch (B, n); the highest speed class."""
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        here = dict(zip(ENTRIES, rows[:, : len(ENTRIES)].T, strict=True))
        after = len(ENTRIES) + MOST_STREETS * len(STREET_ENTRIES)
        streets = rows[:, len(ENTRIES) : after].reshape(-1, MOST_STREETS, len(STREET_ENTRIES))
        street = dict(zip(STREET_ENTRIES, np.moveaxis(streets, -1, 0), strict=True))
        cost = np.where(street["exists"] > 0.0, self.cost(here, street), NEVER)
        action = cost.argmin(1)
        if rows.shape[1] > after:
            time, lost = np.moveaxis(rows[:, after + 1 :].reshape(len(rows), -1, len(HOUR_ENTRIES)), -1, 0)
            hour = MOST_STREETS + (time + WEIGHT * lost).argmin(1)
            action = np.where(rows[:, after] > 0.0, hour, action)
        if len(self.config.speed_classes) > 1:
            pace = np.full(action.size, int(np.argmax(self.config.speed_classes)))
            action = np.stack([action, pace], -1)
        return action if np.ndim(observation) > 1 else action[0]

    @abstractmethod
    def cost(self, here: dict[str, Array], street: dict[str, Array]) -> Array:
        """The cost of each street (B, K) with the rest of the route, from entries of a journey (B,) and its streets."""


class ShortestWay(JourneyDriver):
    """Least length."""

    def cost(self, here: dict[str, Array], street: dict[str, Array]) -> Array:
        """Length."""
        return street["length"] + street["short_length"]


class FastestWay(JourneyDriver):
    """Least time."""

    def cost(self, here: dict[str, Array], street: dict[str, Array]) -> Array:
        """Time."""
        return street["time"] + street["fast_time"]


class IntegrityAwareWay(JourneyDriver):
    """Least sum of time and 3 times the expected time without a usable position."""

    def cost(self, here: dict[str, Array], street: dict[str, Array]) -> Array:
        """Weighted sum."""
        return street["time"] + street["aware_time"] + WEIGHT * (street["unusable"] + street["aware_unusable"])


class ChanceConstrainedWay(JourneyDriver):
    """Least time, with an expected share of the whole journey of at most 0.25 without a usable position.

    After each street the fastest and the integrity-aware route are candidates. If none keeps the share, the street is
    chosen as by integrity: a choice by the least share would drive about in open streets.
    """

    def cost(self, here: dict[str, Array], street: dict[str, Array]) -> Array:
        """The time of the better candidate, beyond all times where none keeps the share."""
        total = {}
        for name in ("fast", "aware"):
            time = street["time"] + street[f"{name}_time"]
            total[name] = time, street["unusable"] + street[f"{name}_unusable"]
        keeps = [
            np.where(
                here["unusable"][:, None] + lost <= MOST_UNUSABLE * (here["elapsed"][:, None] + time), time, np.inf
            )
            for time, lost in total.values()
        ]
        time, lost = total["aware"]
        return np.minimum(np.minimum(*keeps), BEYOND + time + WEIGHT * lost)


class OracleWay(IntegrityAwareWay):
    """Integrity-aware by the true city, trees and heights as they are; it does not know the draws of the navigator.

    Parameters
    ----------
    env : the environment, or the vector environment, that it drives
    config : of the environment
    """

    def __init__(self, env: SeesTruth, config: JourneyConfig | None = None) -> None:
        super().__init__(config)
        self._env = env

    def act(self, observation: Any) -> Any:
        """The action; the observation is replaced by that with the forecast by the true city."""
        return super().act(self._env.oracle_observation())


JOURNEY_DRIVERS: dict[str, Callable[[Any, JourneyConfig], JourneyDriver]] = {
    "shortest": lambda env, config: ShortestWay(config),
    "fastest": lambda env, config: FastestWay(config),
    "integrity_aware": lambda env, config: IntegrityAwareWay(config),
    "chance_constrained": lambda env, config: ChanceConstrainedWay(config),
    "oracle": OracleWay,
}
"""The drivers by name, made for an environment."""
