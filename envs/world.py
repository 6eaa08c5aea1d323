"""The true world: an environment of highway-env with the ego and all other vehicles.

Its dynamics, traffic, rewards and end rules are unchanged. Three things are set here: the observation (none, because
lanebound makes its own), reward terms that fail for array actions or where a speed of 0 is wanted (merge, roundabout),
and the drivers at intersections with their right of way (:mod:`.worlds.crossing`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.error import Error as GymnasiumError
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.parking_env import ParkingEnv
from highway_env.vehicle.controller import ControlledVehicle
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import IDLE
from lanebound.envs.worlds import world_kind, world_kinds
from lanebound.envs.worlds.crossing import CrossingRoad
from lanebound.envs.worlds.drivers import IntersectionDriver
from lanebound.envs.worlds.highway import IDM_PATH
from lanebound.envs.worlds.intersection import DESTINATIONS
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import deep_merge, nearest

__all__ = ["checked_command", "guard", "make_world", "within_rounding", "world_defaults"]

ROUNDING_ULP = 16  # of the larger bound; a scale and an offset in float32 round by 1 or 2, or by 15 on a narrow range
NOTHING = {"type": "AttributesObservation", "attributes": []}
SLOW_MERGING, MERGING_LANE = "merging_speed_reward", ("b", "c", 2)
RESERVED = ("observation", "action", "simulation_frequency", "policy_frequency", "manual_control")
DIRECT = "ContinuousAction"
CROSSING_PATH = f"{IntersectionDriver.__module__}.{IntersectionDriver.__qualname__}"


def _guarded_rewards(world: AbstractEnv, action: Any) -> dict[str, float]:
    """The world's own reward terms; where they compare an array with integers, those of an idle action.

    Vehicles of Merge that are to stand take no part in the term that divides by the speed that they want.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        try:
            terms: dict[str, float] = type(world)._rewards(world, action)
        except ValueError:
            terms = type(world)._rewards(world, IDLE)
    if not np.isfinite(terms.get(SLOW_MERGING, 0.0)):
        driving = [v for v in world.road.vehicles if isinstance(v, ControlledVehicle) and v.target_speed != 0.0]
        terms[SLOW_MERGING] = sum(
            (v.target_speed - v.speed) / v.target_speed for v in driving if v.lane_index == MERGING_LANE
        )
    return terms


def _crossing_road(world: IntersectionEnv) -> None:
    """The world's own road, with the right of way of its drivers."""
    type(world)._make_road(world)
    world.road.__class__ = CrossingRoad


def _class_of(base: str, called: str = "base") -> type[AbstractEnv]:
    """The class behind the name of one of our worlds, or behind a registered id of highway-env's."""
    declared = world_kind(base)
    if declared is not None and declared.world is not None:
        return declared.world
    try:
        spec = gymnasium.spec(base)
    except GymnasiumError:
        known = [name for name, s in gymnasium.registry.items() if "highway_env" in str(s.entry_point)]
        own = [kind.name for kind in world_kinds() if kind.world is not None]
        ours = f"lanebound/{base}"
        advice = _make_it(ours) if ours in gymnasium.registry else nearest(base, [*own, *known])
        raise ConfigError(
            f"{called} must be a highway-env id or one of {', '.join(own)}, got {base!r}: {advice}"
        ) from None
    creator = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    if not (isinstance(creator, type) and issubclass(creator, AbstractEnv)):
        advice = _make_it(base) if base.startswith("lanebound/") else "wrap one of highway-env's ids"
        raise ConfigError(f"{called} must be a highway-env environment, got {base!r}: {advice}")
    if issubclass(creator, ParkingEnv):
        raise ConfigError(
            f"{called} must have lanes to drive along, got {base!r}, where the goal is a pose: choose another id"
        )
    return creator


def _make_it(env_id: str) -> str:
    return f"'{env_id}' has navigation already, make it with gymnasium.make('{env_id}')"


def world_defaults(base: str, called: str = "base") -> dict[str, Any]:
    """A world's own configuration, to be overridden key by key; ``called`` names the parameter in a refusal.

    Raises
    ------
    ConfigError
        No such world, or one that cannot be driven along lanes.
    """
    defaults: dict[str, Any] = _class_of(base, called).default_config()
    return defaults


def make_world(
    base: str, overrides: Mapping[str, Any], action: Mapping[str, Any], simulation_hz: int, policy_hz: int,
    duration_s: float | None = None,
) -> AbstractEnv:  # fmt: skip
    """A highway-env environment with deep-merged overrides and no observation; the rates divide (EnvConfig sees to it).

    A longer ``duration_s`` takes the place of the world's own duration, which would end the episode earlier.

    Raises
    ------
    ConfigError
        An unknown id or key, a key that is set elsewhere, or an agent count other than one.
    """
    kind = _class_of(base)
    defaults = kind.default_config()
    _check_keys(overrides, defaults, "world")
    config = deep_merge(defaults, overrides)
    if duration_s is not None and config.get("duration", duration_s) < duration_s:
        config["duration"] = duration_s
    _check_figures(config)
    if config.get("controlled_vehicles", 1) != 1:
        raise ConfigError("world.controlled_vehicles must be 1: one ego drives on its belief, the others are traffic")
    config.update(
        observation=dict(NOTHING), action=dict(action), simulation_frequency=simulation_hz, policy_frequency=policy_hz
    )
    _check_action(config["action"])
    if issubclass(kind, IntersectionEnv) and config["other_vehicles_type"] == IDM_PATH:
        config["other_vehicles_type"] = CROSSING_PATH
    try:
        return guard(kind, config)
    except AttributeError as error:  # highway-env's racetracks make the ego by a method that meta-actions lack
        taken, given = (ACTION_NAMES.get(name, name) for name in (defaults["action"]["type"], config["action"]["type"]))
        raise ConfigError(f"action must be '{taken}' in {base}, got '{given}': leave it out") from error


ACTION_NAMES = {"DiscreteMetaAction": "meta", DIRECT: "continuous"}
"""Values of ``action`` of an environment, by the action types of highway-env."""
WHOLE = {"lanes_count": (1, 20), "vehicles_count": (0, 1000), "layout": (0, 10**6), "initial_vehicle_count": (0, 1000),
         "incoming_vehicle_destination": (0, 2), "platoon": (1, 4), "vehicles": (4, 8), "place": (2, 8),
         "route": (0, 1000), "roads": (1, 64)}  # fmt: skip
"""Keys of worlds that are whole numbers, with the least and most: highway-env fails far from what is wrong."""
NUMBERS = {"vehicles_density": (0.01, 10.0), "initial_speed": (0.0, 60.0), "lane_width": (2.0, 20.0),
           "ego_spacing": (0.01, 100.0), "duration": (0.1, 1e6), "spawn_probability": (0.0, 1.0),
           "closed_length": (2.0, 500.0), "closed_limit": (1.0, 60.0)}  # fmt: skip
"""Those that are numbers."""
RANGES = "reward_speed_range", "time_gap", "spread", "ahead"
"""Those that are two numbers, the lower one first."""


def _check_figures(config: Mapping[str, Any]) -> None:
    """Refuse figures of a world that it cannot be made of."""
    for key, (low, high) in (WHOLE | NUMBERS).items():
        value, kinds = config.get(key), (int, np.integer) if key in WHOLE else (int, float, np.integer, np.floating)
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
            kind = "a whole number" if key in WHOLE else "a number"
            raise ConfigError(f"world.{key} must be {kind} between {low:g} and {high:g}, got {value!r}: correct it")
    for key in RANGES:
        value = config.get(key)
        both = isinstance(value, list | tuple) and len(value) == 2 and all(isinstance(v, int | float) for v in value)
        if value is not None and not (both and value[0] < value[1]):
            raise ConfigError(f"world.{key} must be two numbers, the lower one first, got {value!r}: correct it")
    if config.get("destination") not in (None, "", *DESTINATIONS):
        raise ConfigError(
            f"world.destination must be one of {', '.join(DESTINATIONS)}, or None to draw one, got "
            f"{config['destination']!r}: correct it"
        )
    if (place := config.get("place")) is not None and place > config["vehicles"]:
        raise ConfigError(f"world.place must be at most world.vehicles = {config['vehicles']}, got {place}: lower it")
    lane, count = config.get("initial_lane_id"), config.get("lanes_count", 1)
    if lane is not None and not (isinstance(lane, int) and 0 <= lane < count):
        raise ConfigError(f"world.initial_lane_id must be None or 0 to {count - 1} on {count} lanes, got {lane!r}: "
                          "None draws one")  # fmt: skip


def guard(kind: type[AbstractEnv], config: dict[str, Any]) -> AbstractEnv:
    """highway-env's environment itself, except for reward terms that would fail (:func:`_guarded_rewards`)."""
    world: AbstractEnv = object.__new__(kind)
    world._rewards = partial(_guarded_rewards, world)  # before __init__, which resets
    if config.get("other_vehicles_type") == CROSSING_PATH:
        world._make_road = partial(_crossing_road, world)
    kind.__init__(world, config=config)
    return world


AXES = ("acceleration_range", "steering_range", "speed_range", "longitudinal", "lateral", "dynamical", "clip")
OPTIONS: dict[str, tuple[str, ...]] = {
    "DiscreteMetaAction": ("longitudinal", "lateral", "target_speeds"),
    "DiscreteAction": (*AXES, "target_speeds", "actions_per_axis"),
    DIRECT: (*AXES, "target_speeds"),
}


def _check_action(action: Mapping[str, Any]) -> None:
    """Refuse options that highway-env's action type would swallow, and speeds that are none."""
    kind = action["type"]
    if kind not in OPTIONS:
        raise ConfigError(f"action_options.type must be one of {', '.join(OPTIONS)}, got {kind!r}: leave it out")
    for key in action:
        if key != "type" and key not in OPTIONS[kind]:
            raise ConfigError(f"action_options.{key} must be an option of {kind}: {nearest(key, OPTIONS[kind])}")
    speeds = action.get("target_speeds")
    if speeds is not None:
        row = list(speeds) if isinstance(speeds, list | tuple | np.ndarray) else []
        if (
            len(row) < 2
            or not all(isinstance(v, int | float) and np.isfinite(v) for v in row)
            or not all(slower < faster for slower, faster in pairwise(row))
        ):
            raise ConfigError(f"action_options.target_speeds must be two or more rising speeds in m/s, got {speeds!r}")


def _check_keys(given: Mapping[str, Any], known: Mapping[str, Any], path: str) -> None:
    for key, value in given.items():
        if key in RESERVED:
            raise ConfigError(f"{path}.{key} must not be set: use the environment's own fields for actions and rates")
        if key not in known:
            advice = nearest(key, map(str, known))
            raise ConfigError(f"{path}.{key} must be a key of this world, got {value!r} for an unknown one: {advice}")
        _check_value(f"{path}.{key}", value, known[key])


def _check_value(path: str, value: Any, default: Any) -> None:
    """Refuse what highway-env would choke on: another kind than the default, or a negative count or duration."""
    number = isinstance(default, int | float) and not isinstance(default, bool)
    if number and (not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value)):
        raise ConfigError(f"{path} must be a number, got {value!r}: the default is {default!r}")
    if path.endswith(("count", "duration", "_gap", "speed", "layout")) and number and value < 0:
        raise ConfigError(f"{path} must be >= 0, got {value!r}: the default is {default!r}")
    if path.endswith("duration") and number and value == 0:
        raise ConfigError(f"{path} must be > 0, got 0: the default is {default!r}")


def within_rounding(commands: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> NDArray[Any]:
    """Commands of a Box, those beyond a bound by no more than rounding moved onto it; others and NaN stay as they are.

    Arithmetic of wrappers in float32, such as Gymnasium's ``RescaleAction``, gives 1.0000001 for 1.
    """
    nearest_inside = np.clip(commands, low, high)
    rounding = ROUNDING_ULP * np.spacing(np.maximum(np.abs(low), np.abs(high)))
    return np.where(np.abs(commands - nearest_inside) <= rounding, nearest_inside, commands)


def checked_command(space: gymnasium.Space[Any], action: Any) -> Any:
    """The command as the world takes it: an int, or an array of the space's type.

    Raises
    ------
    InputError
        A command outside the action space: naming the space, the command and what to do.
    """
    if isinstance(space, gymnasium.spaces.Box):
        given = np.asarray(action)
        if given.dtype.kind not in "iuf" or given.shape != space.shape:
            wanted = f"{space.dtype} numbers of shape {space.shape}"
            raise InputError(f"action must be {wanted}, got {action!r}: convert or reshape it")
        command = within_rounding(given.astype(space.dtype), space.low, space.high)
        if not np.isfinite(command).all():
            raise InputError(f"action must be finite, got {action!r}: check the policy for NaN")
        if not space.contains(command):
            raise InputError(f"action must lie in {space}, got {action!r}: clip it")
        return command
    whole = np.asarray(action)
    if whole.dtype.kind not in "iu" or whole.size != 1 or not space.contains(np.int64(whole.item())):
        wanted = (
            f"an integer from 0 to {space.n - 1}" if isinstance(space, gymnasium.spaces.Discrete) else f"one of {space}"
        )
        raise InputError(f"action must be {wanted}, got {action!r}: correct it")
    return int(whole.item())
