"""The options that the engine has; any other is refused, so that results equal those of single environments."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteAction
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.objects import Landmark

from lanebound.envs.batch.episodes import empty_cars
from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.plans import Plans
from lanebound.envs.config import ActionKind, EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.vector.crossing_kernel import APPROACH, EXIT, INSIDE, PART, WAY, Crossing
from lanebound.envs.vector.drive_kernel import run_course, run_motorway, run_network
from lanebound.envs.vector.network_kernel import DRIVERS, Roads
from lanebound.envs.worlds import Support, world_kind, world_kinds
from lanebound.envs.worlds.crossing import CrossingRoad, ways_through
from lanebound.envs.worlds.drivers import CityDriver, IntersectionDriver, LeadVehicle
from lanebound.envs.worlds.followers import PlatoonDriver
from lanebound.envs.worlds.idm_parameters_kernel import BRISK, CALM, IdmParameters, idm_parameters
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import nearest
from lanebound.integrity.core.records import Records, one_record

__all__ = ["drivers_of", "newcomers_of", "require_supported", "roads_of", "support_of", "traffic_of"]

INSTEAD = "or make the same environments with vectorization_mode='sync' or 'async', for SB3 as DummyVecEnv"
TRAFFIC: dict[str, tuple[Any, type, IdmParameters | None]] = {
    "course": (run_course, LeadVehicle, None),
    "city": (run_network, CityDriver, CALM),
    "platoon": (run_network, PlatoonDriver, CALM),
    "network": (run_network, IDMVehicle, BRISK),
    # highway-env's intersection gives its drivers parameters when it is made
    "crossing": (run_network, IntersectionDriver, None),
    "motorway": (run_motorway, IDMVehicle, BRISK),
}
"""Kinds of compiled traffic: entry kernel, class whose drivers it moves, and the parameters that they must have."""


def support_of(config: EnvConfig) -> Support:
    """The engine support of the world of a configuration.

    Raises
    ------
    ConfigError
        The world has none.
    """
    kind = world_kind(config.base)
    if kind is None or kind.support is None:
        driven = [other.name for other in world_kinds() if other.support is not None]
        raise ConfigError(f"base must have an engine, as {', '.join(driven)} do, got {config.base!r}: "
                          f"choose one of these, {INSTEAD}")  # fmt: skip
    return kind.support()


def newcomers_of(config: EnvConfig, support: Support) -> int:
    """Slots for vehicles that enter during an episode."""
    kind = world_kind(config.base)
    return 0 if kind is None or support.entrance is None else kind.newcomers


def traffic_of(support: Support) -> Any:
    """The entry kernel of a world's traffic.

    Raises
    ------
    ConfigError
        There is no such traffic.
    """
    if ":" in support.traffic:
        module, _, name = support.traffic.partition(":")
        return getattr(import_module(module), name)
    if support.traffic not in TRAFFIC:
        raise ConfigError(
            f"traffic of a world must be one of {', '.join(TRAFFIC)}, or package.module:kernel, got "
            f"{support.traffic!r}: {nearest(support.traffic, TRAFFIC)}"
        )
    return TRAFFIC[support.traffic][0]


def drivers_of(support: Support, world: AbstractEnv) -> Records:
    """Parameters of the other drivers on a network of roads, (1,) DRIVERS; zeros where there are none."""
    kind: Any = support.drivers
    if kind is None or not issubclass(kind, IDMVehicle):
        return np.zeros(1, DRIVERS)
    idm = idm_parameters(
        kind.DISTANCE_WANTED, kind.TIME_WANTED, kind.COMFORT_ACC_MAX, -kind.COMFORT_ACC_MIN, kind.LANE_CHANGE_DELAY,
        kind.LANE_CHANGE_MIN_ACC_GAIN,
    )  # fmt: skip
    return one_record(
        DRIVERS,
        **idm._asdict(),
        reaction_s=getattr(kind, "REACTION_S", 0.0),
        stops=getattr(kind, "STOPS", False),
        most_mps2=getattr(kind, "MOST_MPS2", np.inf),
        rules_every=_rules_every(world),
        joined=bool(world.config["neighbour_vehicles_connected_lanes"]),
    )


def _rules_every(world: AbstractEnv) -> int:
    """Simulation steps between decisions on the right of way, 0 on roads without such a rule."""
    hz, road = world.config["simulation_frequency"], world.road
    return int(1 / (1 / hz) / road.REGULATION_FREQUENCY) if isinstance(road, CrossingRoad) else 0


def roads_of(world: AbstractEnv, table: LaneTable, plans: Plans) -> Roads:
    """What the roads of a world have beyond their lanes."""
    return Roads(plans.steps, objects_of(world, table), _crossing_of(world, table))


def _crossing_of(world: AbstractEnv, table: LaneTable) -> Crossing:
    """The crossing of a world; one without lanes where drivers have no right of way."""
    if not isinstance(world.road, CrossingRoad):
        return Crossing(np.zeros(0, PART), np.zeros(0, WAY), np.zeros((0, 0, 2)))
    found = ways_through(world.road.network)
    parts, ways = np.zeros(len(table.index), PART), np.zeros(len(found), WAY)
    parts["way"] = NONE
    for part, (start, end, _) in zip(parts, table.index, strict=True):
        part["kind"] = APPROACH if end.startswith("ir") else EXIT if start.startswith("il") else INSIDE
    for n, ((start, end), way) in enumerate(found.items()):
        lane = table.row[start, end, 0]
        parts["way"][lane] = n
        leading = next(row for (_, to, _), row in table.row.items() if to == start)
        onward = next(row for (begin, _, _), row in table.row.items() if begin == end)
        ways[n] = lane, leading, onward, way.priority
    spans = np.full((len(found), len(found), 2), np.nan)
    for n, way in enumerate(found.values()):
        for k, other in enumerate(found):
            spans[n, k] = way.shared.get(other, (np.nan, np.nan))
    return Crossing(parts, ways, spans)


def objects_of(world: AbstractEnv, table: LaneTable) -> Records:
    """What stands on the road of a world, (1, O) CAR."""
    found = [thing for thing in world.road.objects if not isinstance(thing, Landmark)]
    out: Records = empty_cars(1, len(found))
    for car, thing in zip(out[0], found, strict=True):
        (car["x"], car["y"]), car["heading"] = thing.position, thing.heading
        car["length"], car["width"], car["lane"] = thing.LENGTH, thing.WIDTH, table.row[thing.lane_index]
    return out


def require_supported(single: DrivingEnv) -> None:
    """Raise ConfigError for an option that the engine does not have; the message names the alternatives."""
    config, world = single.config, single.world
    support = support_of(config)
    _require_sources(config)
    kind = world_kind(config.base)
    if kind is not None and kind.arrived is not None and "goal_road" not in support.ends(world):
        raise _refusal("base", "a world without a goal, or whose support declares it", config.base)
    for name, allowed, value in support.refusals(world):
        raise _refusal(name, allowed, value)
    traffic_of(support)  # refuses an unknown one
    if support.drivers is not None and support.traffic in TRAFFIC:
        _require_drivers(support.drivers, *TRAFFIC[support.traffic][1:], support.traffic)
    if world.config.get("vehicles_count", 0) > config.slots:
        raise _refusal("world.vehicles_count", f"at most slots = {config.slots}", world.config["vehicles_count"])
    if (others := support.vehicles(world) - 1 + config.traffic.behind) > config.slots:
        raise _refusal("slots", f"{others} or more, as many as others there may be at a start", config.slots)
    if config.action is ActionKind.CONTINUOUS and isinstance(world.action_type, DiscreteAction):
        raise _refusal("action_options.type", "ContinuousAction", "DiscreteAction")
    if config.action is ActionKind.CONTINUOUS and world.action_type.dynamical:
        raise _refusal("action_options.dynamical", "False", True)


def _require_sources(config: EnvConfig) -> None:
    per_policy, per_epoch = config.simulation_hz // config.policy_hz, config.simulation_hz / config.navigation.rate_hz
    if per_policy % max(1, round(per_epoch)):
        raise _refusal(
            "policy_hz", f"a divisor of navigation.rate_hz = {config.navigation.rate_hz:g}", config.policy_hz
        )


def _require_drivers(kind: type, moved: type, idm: IdmParameters | None, traffic: str) -> None:
    """Refuse drivers that are not compiled: of another class than the traffic moves, with methods of their own, or with
    other parameters, as highway-env's intersection changes class constants."""
    if not issubclass(kind, moved):
        raise _refusal("OTHERS of the world", f"{moved.__name__}, which the traffic {traffic!r} moves,", kind.__name__)
    for known in kind.__mro__[: kind.__mro__.index(moved)]:
        for name, value in vars(known).items():
            if callable(value) and not name.startswith("__"):
                raise _refusal(f"{known.__name__}.{name}", f"that of {moved.__name__}", "a method of its own")
    if idm is None:
        return
    figures = {
        "DISTANCE_WANTED": idm.gap_m, "COMFORT_ACC_MAX": idm.comfort, "COMFORT_ACC_MIN": -idm.deceleration,
        "TIME_WANTED": idm.headway_s, "LANE_CHANGE_DELAY": idm.delay_s, "LANE_CHANGE_MIN_ACC_GAIN": idm.gain,
    }  # fmt: skip
    for name, figure in figures.items():
        if (found := getattr(kind, name)) != figure:
            raise ConfigError(
                f"{kind.__name__}.{name} must be {figure:g} in the vector engine, got {found:g}: make the engine in "
                f"a process without highway-env's own intersection, which changes it, {INSTEAD}"
            )


def _refusal(name: str, allowed: str, value: object) -> ConfigError:
    return ConfigError(f"{name} must be {allowed} in the vector engine, got {value!r}: change it, {INSTEAD}")
