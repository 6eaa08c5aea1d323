"""What the engine can do, and the refusal of all else: nothing is done otherwise than in a single environment."""

from __future__ import annotations

from highway_env.envs.highway_env import HighwayEnv

from lanebound.envs.config import ActionKind, EnvConfig, FaultLevel
from lanebound.envs.core import DrivingEnv
from lanebound.envs.navigation import Source
from lanebound.envs.world import IDM_PATH
from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.integrity.errors import ConfigError

__all__ = ["WORLDS", "require_perfect", "require_supported"]

WORLDS = {HighwayEnv: "highway-v0", LaneKeepingWorld: "LaneKeepingWorld", CarFollowingWorld: "CarFollowingWorld"}
INSTEAD = "or make the same environments with vectorization_mode='sync' or 'async'"


def require_supported(single: DrivingEnv) -> None:
    """Raise ConfigError for what the engine does not do, naming what it does and the alternative."""
    config, world = single.config, single.world
    if type(world) not in WORLDS:
        raise ConfigError(f"base must have an engine, as {', '.join(WORLDS.values())} do, got {config.base!r}: "
                          f"choose one of these, {INSTEAD}")  # fmt: skip
    _require_sources(config, alone=len(world.road.vehicles) == 1)
    if isinstance(world, HighwayEnv):
        if world.config["other_vehicles_type"] != IDM_PATH:
            raise _refusal("world.other_vehicles_type", IDM_PATH, world.config["other_vehicles_type"])
        if world.config["vehicles_count"] > config.slots:
            raise _refusal("world.vehicles_count", f"at most slots = {config.slots}", world.config["vehicles_count"])
    if config.action is ActionKind.CONTINUOUS and world.action_type.dynamical:
        raise _refusal("action_options.dynamical", "False", True)


def require_perfect(config: EnvConfig) -> None:
    """Raise ConfigError unless positions are given: the engine's own navigation has not been shown to be the same."""
    if config.navigation.source is not Source.PERFECT:
        raise _refusal("navigation.source", "'perfect'", config.navigation.source.value)


def _require_sources(config: EnvConfig, alone: bool) -> None:
    if config.navigation.source is Source.OFFSET:
        raise _refusal("navigation.source", "'navigator' or 'perfect'", config.navigation.source.value)
    if config.faults is not FaultLevel.NONE:
        raise _refusal("faults", "'none'", config.faults.value)
    if config.perception.source not in ("truth", "none") and not alone:  # nobody to be heard or seen
        raise _refusal("perception.source", "'truth' or 'none'", config.perception.source)
    per_policy, per_epoch = config.simulation_hz // config.policy_hz, config.simulation_hz / config.navigation.rate_hz
    if per_policy % max(1, round(per_epoch)):
        raise _refusal(
            "policy_hz", f"a divisor of navigation.rate_hz = {config.navigation.rate_hz:g}", config.policy_hz
        )


def _refusal(name: str, allowed: str, value: object) -> ConfigError:
    return ConfigError(f"{name} must be {allowed} in the vector engine, got {value!r}: change it, {INSTEAD}")
