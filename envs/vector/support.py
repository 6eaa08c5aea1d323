"""What the engine can do, and the refusal of all else: nothing is done otherwise than in a single environment."""

from __future__ import annotations

from highway_env.envs.highway_env import HighwayEnv
from highway_env.vehicle.behavior import IDMVehicle

from lanebound.envs.cockpit import OTHERS_S
from lanebound.envs.config import ActionKind, EnvConfig, FaultLevel
from lanebound.envs.core import DrivingEnv
from lanebound.envs.navigation import Source
from lanebound.envs.world import IDM_PATH
from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.integrity.errors import ConfigError

__all__ = ["WORLDS", "require_supported"]

WORLDS = {HighwayEnv: "highway-v0", LaneKeepingWorld: "LaneKeepingWorld", CarFollowingWorld: "CarFollowingWorld"}
DRIVERS = {"DISTANCE_WANTED": 10.0, "COMFORT_ACC_MAX": 3.0, "COMFORT_ACC_MIN": -5.0, "TIME_WANTED": 1.5}
"""highway-env's figures of IDMVehicle, which are compiled in (see :mod:`.motorway_kernel`)."""
INSTEAD = "or make the same environments with vectorization_mode='sync' or 'async'"


def require_supported(single: DrivingEnv) -> None:
    """Raise ConfigError for what the engine does not do, naming what it does and the alternative."""
    config, world = single.config, single.world
    if type(world) not in WORLDS:
        raise ConfigError(f"base must have an engine, as {', '.join(WORLDS.values())} do, got {config.base!r}: "
                          f"choose one of these, {INSTEAD}")  # fmt: skip
    _require_sources(config)
    if isinstance(world, HighwayEnv):
        if world.config["other_vehicles_type"] != IDM_PATH:
            raise _refusal("world.other_vehicles_type", IDM_PATH, world.config["other_vehicles_type"])
        if world.config["vehicles_count"] > config.slots:
            raise _refusal("world.vehicles_count", f"at most slots = {config.slots}", world.config["vehicles_count"])
        _require_drivers()
    if config.action is ActionKind.CONTINUOUS and world.action_type.dynamical:
        raise _refusal("action_options.dynamical", "False", True)


def _require_sources(config: EnvConfig) -> None:
    navigation = config.navigation
    if navigation.source is Source.OFFSET:
        raise _refusal("navigation.source", "'navigator' or 'perfect'", navigation.source.value)
    if config.faults is not FaultLevel.NONE:
        raise _refusal("faults", "'none'", config.faults.value)
    if config.perception.source in ("v2v", "both") and navigation.warm_up_s > OTHERS_S:
        raise _refusal("navigation.warm_up_s", f"at most {OTHERS_S:g} where others broadcast", navigation.warm_up_s)
    per_policy, per_epoch = config.simulation_hz // config.policy_hz, config.simulation_hz / config.navigation.rate_hz
    if per_policy % max(1, round(per_epoch)):
        raise _refusal(
            "policy_hz", f"a divisor of navigation.rate_hz = {config.navigation.rate_hz:g}", config.policy_hz
        )


def _require_drivers() -> None:
    """Other drivers must be highway-env's: its plain intersection rewrites their figures for the whole process."""
    for name, figure in DRIVERS.items():
        if (found := getattr(IDMVehicle, name)) != figure:
            raise ConfigError(
                f"IDMVehicle.{name} must be {figure:g} in the vector engine, got {found:g}: make the engine in "
                f"a process without highway-env's own intersection, which rewrites it, {INSTEAD}"
            )


def _refusal(name: str, allowed: str, value: object) -> ConfigError:
    return ConfigError(f"{name} must be {allowed} in the vector engine, got {value!r}: change it, {INSTEAD}")
