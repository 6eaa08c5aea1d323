"""The worlds that can be driven: our own by name, highway-env's by id, under either kind of action."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv

from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.world import make_world, world_defaults
from lanebound.envs.worlds import world_kind
from lanebound.envs.worlds.base import META, World
from lanebound.envs.worlds.street_maps import EACH_CITY, MOST_CITIES
from lanebound.integrity.core.errors import ConfigError

__all__ = ["world_of"]

QUANTISED = "DiscreteAction"  # highway-env's grid of continuous commands
TYPES = {ActionKind.META: "DiscreteMetaAction", ActionKind.CONTINUOUS: "ContinuousAction"}
KINDS = {ActionKind.META: (TYPES[ActionKind.META],), ActionKind.CONTINUOUS: (TYPES[ActionKind.CONTINUOUS], QUANTISED)}


def world_of(config: EnvConfig) -> AbstractEnv:
    """The true world of a configuration.

    Raises
    ------
    ConfigError
        See :func:`lanebound.envs.world.make_world`; or the configuration asks for what the world does not have.
    """
    continuous = config.action is ActionKind.CONTINUOUS
    declared = world_kind(config.base)
    name = (declared.continuous if declared is not None and continuous else "") or config.base
    defaults = world_defaults(name)
    kind = world_kind(name)
    ours = kind is not None and kind.world is not None
    own = dict(META) if ours and not continuous else _action(defaults["action"], config.action)
    _require_kind(config)
    world = dict(config.world)
    if "seeds" in world:
        raise ConfigError("world.seeds must be left out: set cities.split and cities.count")
    if world.get("map") == EACH_CITY:
        world["seeds"] = _seeds_of(config)
    if "offroad_terminal" in defaults:
        world.setdefault("offroad_terminal", config.off_road_ends)
    made = make_world(
        name, world, {**own, **config.action_options}, config.simulation_hz, config.policy_hz, config.duration_s
    )
    _require_offered(config, made)
    return made


def _seeds_of(config: EnvConfig) -> list[int]:
    """The generated cities of a world that has a road in each."""
    cities = config.cities
    if cities.number > MOST_CITIES:
        raise ConfigError(
            f"cities.count must be at most {MOST_CITIES} with world.map 'generated', got {cities.number}: lower it"
        )
    return [cities.seed_of(k) for k in range(cities.number)]


def _require_offered(config: EnvConfig, world: AbstractEnv) -> None:
    """Refuse entries and weights that would stay at their defaults in this world: they would seem to be there."""
    network = world.road.network
    closes = isinstance(world, World) and type(world).draw_closure is not World.draw_closure
    has_goal = getattr(network, "goal", None) is not None
    tolls = bool(getattr(network, "geo_objects", None))
    forks = any(len(ends) > 1 for ends in network.graph.values())
    for name, given, there, must, worlds in (
        ("observation.closure", config.observation.closure, closes, "false where no lane closes", "WorkZoneWorld"),
        ("cost.route", config.cost.route, has_goal, "0 where the network has no goal", "GuidanceWorld"),
        ("cost.gore", config.cost.gore, forks, "0 where no road forks", "GuidanceWorld or exit-v0"),
        ("observation.tolls", config.observation.tolls, tolls, "false where no road is tolled", "TollingWorld"),
        ("cost.overcharge", config.cost.overcharge, tolls, "0 where no road is tolled", "TollingWorld"),
        ("cost.undercharge", config.cost.undercharge, tolls, "0 where no road is tolled", "TollingWorld"),
    ):
        if given and not there:
            raise ConfigError(f"{name} must be {must}, as in {config.base}, got {given}: remove it, or choose {worlds}")


def _require_kind(config: EnvConfig) -> None:
    """Refuse an action type that is not of the kind of action."""
    given, kinds = config.action_options.get("type"), KINDS[config.action]
    if given is not None and given not in kinds:
        raise ConfigError(
            f"action_options.type must be {' or '.join(kinds)} with action '{config.action.value}', got {given!r}: set "
            "action, and leave the type out"
        )


def _action(native: dict[str, Any], kind: ActionKind) -> dict[str, Any]:
    """The world's own action where it is of this kind; else the standard one, with its own choice of speeds."""
    if native["type"] == TYPES[kind]:
        return dict(native)
    if kind is ActionKind.CONTINUOUS:
        return {"type": TYPES[kind], "steering_range": [-np.pi / 4, np.pi / 4]}
    speeds = {"target_speeds": native["target_speeds"]} if "target_speeds" in native else {}
    return {"type": TYPES[kind], **speeds}
