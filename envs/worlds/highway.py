"""Support of highway-env's motorways by the vector engine: start and end of episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from lanebound.envs.worlds.kinds import Refusal, Starter, Support

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.integrity.core.records import Records

__all__ = ["IDM_PATH", "even_speeds", "motorway_support", "only_idm"]

IDM_PATH = "highway_env.vehicle.behavior.IDMVehicle"


def motorway_support() -> Support:
    """Support of ``highway-v0`` and ``highway-fast-v0`` by the vector engine."""
    return Support(
        traffic="motorway",
        vehicles=_vehicles,
        starter=_lined_up,
        ends=_ends,
        refusals=only_idm,
        drivers=IDMVehicle,
    )


def _vehicles(world: AbstractEnv) -> int:
    """The ego and those ahead; followers come on top."""
    return 1 + int(world.config["vehicles_count"])


def _lined_up(world: AbstractEnv, table: LaneTable) -> Starter:
    """Starter with the random draws of ``HighwayEnv`` in the same order."""
    from lanebound.envs.vector.start_kernel import line_up

    c, lane = world.config, world.config["initial_lane_id"]
    count = _vehicles(world)
    ego_lane, spacings = -1 if lane is None else int(lane), (float(c["ego_spacing"]), 1.0 / c["vehicles_density"])

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: NDArray[np.float64]) -> int:
        line_up(rng, cars[:count], drivers[:count], table.lanes.table, ego_lane, *spacings)
        return count

    return start


def _ends(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.vector.world_kernel import OF_HIGHWAY

    c = world.config
    slow, fast = c["reward_speed_range"]
    return {
        "duration_s": c["duration"], "tolerance_s": 0.0, "off_road_ends": c["offroad_terminal"], "against_ends": False,
        "end_m": -1.0, "reward": OF_HIGHWAY, "collision": c["collision_reward"], "first": c["right_lane_reward"],
        "second": c["high_speed_reward"], "slow_mps": slow, "fast_mps": fast, "normalize": c["normalize_reward"],
        "only_ego_crashes": isinstance(world, HighwayEnvFast),
    }  # fmt: skip


def only_idm(world: AbstractEnv) -> list[Refusal]:
    """Refuse drivers other than those of highway-env's own class."""
    found = world.config["other_vehicles_type"]
    return [] if found == IDM_PATH else [("world.other_vehicles_type", IDM_PATH, found)]


def even_speeds(world: AbstractEnv) -> list[Refusal]:
    """Refuse what :func:`only_idm` refuses, and uneven target speeds: the reward takes their number from the speed."""
    found = only_idm(world)
    if isinstance(world.action_type, DiscreteMetaAction):
        speeds = np.array(world.action_type.target_speeds, dtype=np.float64)
        if not np.allclose(speeds, np.linspace(speeds[0], speeds[-1], speeds.size)):
            found.append(("action_options.target_speeds", "evenly spaced", speeds.tolist()))
    return found
