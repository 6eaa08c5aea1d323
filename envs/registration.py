"""The ids, and what each of them presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode, VectorEnv

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.ids import CLASSES, CONTINUOUS, IDS, META, MORE, enter, every_id
from lanebound.envs.world import world_defaults
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["IDS", "JOURNEY_ID", "base_of", "make_config", "register_all", "wrap", "wrap_vec"]

NEXT_STEP = AutoresetMode.NEXT_STEP
JOURNEY_ID = "lanebound/Journey-v0"


def make_config(env_id: str, overrides: Mapping[str, Any] | None = None) -> EnvConfig:
    """The configuration of an id with ``overrides`` merged deeply over what it presets.

    Raises
    ------
    InputError
        An unknown id, with the nearest one.
    ConfigError
        An unknown key or a value out of range, with its path.
    """
    presets = every_id()
    if env_id == JOURNEY_ID:
        raise InputError(f"env_id must be a driving world, got {env_id!r}: its configuration is JourneyConfig")
    if env_id not in presets:
        raise InputError(f"env_id must be one of {', '.join(presets)}, got {env_id!r}: {nearest(env_id, presets)}")
    return EnvConfig.build(presets[env_id], overrides)


def base_of(env_id: str) -> str:
    """The world of an id of ours, with or without ``lanebound/``; any other id is its own."""
    ours = f"lanebound/{env_id.removeprefix('lanebound/')}"
    return make_config(ours).base if ours in every_id() else env_id


def wrap(env_id: str, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> DrivingEnv:
    """Make an environment on another id of highway-env, with the same navigation as the ids of this package.

    >>> wrap("two-way-v0", {"sky": "open"}).config.base
    'two-way-v0'

    Raises
    ------
    ConfigError
        The id is not of highway-env, or its ego is not a car of highway-env with one of its actions.
    """
    defaults = world_defaults(env_id, "env_id")
    kind = {"DiscreteMetaAction": META, "ContinuousAction": CONTINUOUS}.get(defaults["action"]["type"])
    if kind is None:
        raise ConfigError(f"env_id must be driven by one agent, got {env_id!r} with {defaults['action']['type']}")
    return DrivingEnv(EnvConfig.build({"base": env_id, **kind}, config), render_mode)


def wrap_vec(
    env_id: str,
    num_envs: int,
    config: Mapping[str, Any] | None = None,
    autoreset_mode: AutoresetMode | str = NEXT_STEP,
    processes: int = 1,
) -> VectorEnv[Any, Any, Any]:
    """Make N environments as :func:`wrap` in the vector engine; arguments as for ``gymnasium.make_vec``.

    >>> wrap_vec("two-way-v0", 2, {"sky": "open"}).num_envs
    2

    Raises
    ------
    ConfigError
        As :func:`wrap`; or the engine does not support the id or the configuration. The message names the ids.
    """
    from lanebound.envs.vector.env import WrappedVectorEnv

    return WrappedVectorEnv(env_id, num_envs, config, autoreset_mode, processes)


def register_all() -> None:
    """Register every id with Gymnasium; doing so twice changes nothing."""
    for kind in (*CLASSES, *MORE):
        enter(kind)
    if JOURNEY_ID not in gymnasium.registry:  # no driving world: it is not among the ids that sweeps drive
        place = "lanebound.envs.journeys.env"
        gymnasium.register(JOURNEY_ID, f"{place}:Journey", vector_entry_point=f"{place}:VectorJourney")
