"""What the engine can do, and the refusal of all else: nothing is done otherwise than in a single environment."""

from __future__ import annotations

from highway_env.envs.highway_env import HighwayEnv
from highway_env.vehicle.behavior import IDMVehicle

from lanebound.envs.cockpit import OTHERS_S
from lanebound.envs.config import ActionKind, EnvConfig, FaultLevel
from lanebound.envs.core import DrivingEnv
from lanebound.envs.navigation import Source
from lanebound.envs.vector.city_kernel import CALM
from lanebound.envs.vector.idm_kernel import Manners
from lanebound.envs.vector.motorway_kernel import BRISK
from lanebound.envs.world import IDM_PATH
from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld
from lanebound.integrity.core.errors import ConfigError

__all__ = ["WORLDS", "require_supported"]

WORLDS = {
    HighwayEnv: "highway-v0",
    LaneKeepingWorld: "LaneKeepingWorld",
    CarFollowingWorld: "CarFollowingWorld",
    UrbanCanyonWorld: "UrbanCanyonWorld",
}
INSTEAD = "or make the same environments with vectorization_mode='sync' or 'async', for SB3 as DummyVecEnv"


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
        _require_drivers(IDMVehicle, BRISK)
    if isinstance(world, UrbanCanyonWorld):
        if not world.config["neighbour_vehicles_connected_lanes"]:
            raise _refusal("world.neighbour_vehicles_connected_lanes", "True", False)
        _require_drivers(CityDriver, CALM)
    if world.config.get("vehicles_count", 0) > config.slots:
        raise _refusal("world.vehicles_count", f"at most slots = {config.slots}", world.config["vehicles_count"])
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


def _require_drivers(kind: type[IDMVehicle], manners: Manners) -> None:
    """Drivers must have the figures that are compiled in: highway-env's plain intersection rewrites them for all."""
    slowing = -0.25 * manners.twice_root**2 / manners.comfort
    figures = {
        "DISTANCE_WANTED": manners.gap_m, "COMFORT_ACC_MAX": manners.comfort, "COMFORT_ACC_MIN": round(slowing, 9),
        "TIME_WANTED": manners.headway_s, "LANE_CHANGE_DELAY": manners.delay_s,
        "LANE_CHANGE_MIN_ACC_GAIN": manners.gain,
    }  # fmt: skip
    for name, figure in figures.items():
        if (found := getattr(kind, name)) != figure:
            raise ConfigError(
                f"{kind.__name__}.{name} must be {figure:g} in the vector engine, got {found:g}: make the engine in "
                f"a process without highway-env's own intersection, which rewrites it, {INSTEAD}"
            )


def _refusal(name: str, allowed: str, value: object) -> ConfigError:
    return ConfigError(f"{name} must be {allowed} in the vector engine, got {value!r}: change it, {INSTEAD}")
