"""The plain driver: keeps its lane, its speed and its distance, and trusts its position whatever that is worth.

It knows nothing of integrity: what it reads is the same in blind observations. That makes it the one to beat.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.plans import (
    CruiseConfig,
    following_acceleration,
    nearest_ahead,
    pursuit_steering,
    route_speed,
    safe_speed,
)
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.errors import InputError

__all__ = ["ContinuousCruise", "MetaCruise", "make_cruise"]

States = tuple[NDArray[Any], ...] | None
NEEDED = ("ego.speed", "road.speed_limit")


def make_cruise(env: DrivingEnv, config: CruiseConfig | None = None) -> ContinuousCruise | MetaCruise:
    """The cruising driver for the actions of an environment."""
    config = CruiseConfig() if config is None else config
    continuous = isinstance(env.action_space, spaces.Box)
    return ContinuousCruise(env, config) if continuous else MetaCruise(env, config)


class ContinuousCruise:
    """Pure pursuit of the route's centreline, and the intelligent driver model.

    Raises
    ------
    InputError
        The observation shows no preview of the route.
    """

    def __init__(self, env: DrivingEnv, config: CruiseConfig) -> None:
        self.config, self.reader, self._actuators = config, _reader(env), env.world.action_type
        if not self.reader.previews_m:
            raise InputError("observation.preview_m must name a distance for this agent, got none: add one")

    def predict(
        self,
        observation: Any,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], States]:
        """Acceleration and steering as shares of their ranges, whichever of them the environment takes."""
        inner = self._actuators
        parts = []
        if inner.longitudinal:
            parts.append(_share(self._acceleration(observation), inner.acceleration_range))
        if inner.lateral:
            parts.append(_share(pursuit_steering(self.reader, observation, self.config), inner.steering_range))
        return np.stack(parts, axis=-1).astype(np.float32), state

    def _acceleration(self, observation: Any) -> NDArray[np.float64]:
        reader, c = self.reader, self.config
        v = reader.value(observation, "ego.speed")
        return following_acceleration(v, route_speed(reader, observation, c), *nearest_ahead(reader, observation), c)


class MetaCruise:
    """Faster, slower or as it is, by limit, bends and gap; never changes lane."""

    def __init__(self, env: DrivingEnv, config: CruiseConfig) -> None:
        self.config, self.reader = config, _reader(env)
        self.reader.require(["ego.target_speed"])
        inner = env.world.action_type
        self._codes = {label: code for code, label in inner.actions.items()}
        self._levels = np.sort(np.asarray(inner.target_speeds, dtype=np.float64))

    def predict(
        self,
        observation: Any,
        state: States = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], States]:
        """The code of FASTER, SLOWER or IDLE."""
        reader, c, levels = self.reader, self.config, self._levels
        s, lead = nearest_ahead(reader, observation)
        headway = np.maximum(s - c.standstill_m, 0.0) / c.time_gap_s
        wanted = np.minimum(route_speed(reader, observation, c), np.minimum(safe_speed(s, lead, c), headway))
        level = np.argmin(np.abs(levels - reader.value(observation, "ego.target_speed")[..., None]), axis=-1)
        goal = np.maximum(np.searchsorted(levels, wanted + 1e-3 * levels[-1], side="right") - 1, 0)
        idle = np.full(level.shape, self._codes["IDLE"])
        slower = np.where(goal < level, self._codes["SLOWER"], idle)
        return np.asarray(np.where(goal > level, self._codes["FASTER"], slower)), state


def _reader(env: DrivingEnv) -> Reader:
    reader = Reader(env.config.observation)
    reader.require(NEEDED)
    return reader


def _share(value: NDArray[np.float64], bounds: tuple[float, float]) -> NDArray[np.float64]:
    """Where a value lies between its bounds, from -1 to 1."""
    low, high = bounds
    return np.clip(2.0 * (value - low) / (high - low) - 1.0, -1.0, 1.0)
