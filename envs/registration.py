"""The ids, and what each of them presets."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import gymnasium

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.world import world_defaults
from lanebound.integrity.errors import ConfigError, InputError

__all__ = ["ENTRY_POINT", "IDS", "make", "make_config", "register_all", "wrap"]

ENTRY_POINT = "lanebound.envs.registration:make"
TOWN: dict[str, Any] = {"lane_width_m": 3.25}
CONTINUOUS: dict[str, Any] = {"action": "continuous", "policy_hz": 5}
META: dict[str, Any] = {"action": "meta", "policy_hz": 2}

IDS: dict[str, dict[str, Any]] = {
    "lanebound/LaneKeeping-v0": {"base": "LaneKeepingWorld", **CONTINUOUS, **TOWN},
    "lanebound/CarFollowing-v0": {"base": "CarFollowingWorld", **CONTINUOUS, **TOWN},
    "lanebound/Highway-v0": {"base": "highway-v0", **META, "sky": "suburban"},
    "lanebound/Merge-v0": {"base": "merge-v1", **META, "sky": "suburban"},
    "lanebound/Roundabout-v0": {"base": "roundabout-v1", **META},
    "lanebound/Intersection-v0": {"base": "intersection-v2", **META},
    "lanebound/Racetrack-v0": {"base": "racetrack-v1", **CONTINUOUS, "lane_width_m": 5.0, "keep_lane": False},
    "lanebound/UrbanCanyon-v0": {"base": "UrbanCanyonWorld", **META, **TOWN},
}


def make_config(env_id: str, overrides: Mapping[str, Any] | None = None) -> EnvConfig:
    """The configuration of an id with ``overrides`` merged deeply over what it presets.

    Raises
    ------
    InputError
        An unknown id, with the nearest one.
    ConfigError
        An unknown key or a value out of range, with its path.
    """
    if env_id not in IDS:
        near = (get_close_matches(env_id, IDS, 1, cutoff=0.3) or list(IDS))[0]
        raise InputError(f"env_id must be one of {', '.join(IDS)}, got {env_id!r}: did you mean {near!r}?")
    return EnvConfig.build(IDS[env_id], overrides)


def make(env_id: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> DrivingEnv:
    """The environment of an id: the entry point of all of them."""
    return DrivingEnv(make_config(env_id, config), render_mode)


def wrap(env_id: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> DrivingEnv:
    """The same for any other highway-env id: its world, driven on belief.

    >>> wrap("two-way-v0", {"sky": "open"}).config.base
    'two-way-v0'

    Raises
    ------
    ConfigError
        Not an id of highway-env, or one whose ego is none of highway-env's cars under one of its actions.
    """
    defaults = world_defaults(env_id)
    kind = {"DiscreteMetaAction": META, "ContinuousAction": CONTINUOUS}.get(defaults["action"]["type"])
    if kind is None:
        raise ConfigError(f"env_id must be driven by one agent, got {env_id!r} with {defaults['action']['type']}")
    return DrivingEnv(EnvConfig.build({"base": env_id, **kind}, config), render_mode)


def register_all() -> None:
    """Register every id with Gymnasium; doing so twice changes nothing."""
    for env_id in IDS:
        if env_id not in gymnasium.registry:
            gymnasium.register(env_id, entry_point=ENTRY_POINT, kwargs={"env_id": env_id, "config": {}})
