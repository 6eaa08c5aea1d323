"""Support of highway-env's worlds with roads that join and fork by the vector engine: start and end of episodes.

Each starter makes the random draws of its world in the same order, so that a seed gives the same traffic.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from numpy.typing import NDArray

from lanebound.envs.worlds.goals import BEYOND_CIRCLE_M
from lanebound.envs.worlds.highway import even_speeds, only_idm
from lanebound.envs.worlds.kinds import Starter, Support
from lanebound.envs.worlds.seating import put, put_on_lane

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.envs.batch.plans import Plans
    from lanebound.integrity.core.records import Records

__all__ = ["merge_support", "racetrack_support", "roundabout_support"]

Array = NDArray[np.float64]
APART_M = 20.0  # of RacetrackEnv: from all others, for a vehicle beyond the first two
GOALS = "exr", "sxr", "nxr"  # of RoundaboutEnv: where the others leave
OWN = ("ser", "ses", 0), "nxs"  # first lane and destination of the ego of RoundaboutEnv


def racetrack_support() -> Support:
    """Support of ``racetrack-v0``, ``racetrack-v1`` and the larger track of ``racetrack-large-v0`` and ``-v1``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 1 + max(int(world.config["other_vehicles"]), 0),
        starter=_on_track,
        ends=_ends_of_track,
        drivers=IDMVehicle,
        effort=_effort_on_track,
    )


def _on_track(world: AbstractEnv, table: LaneTable) -> Starter:
    network, others = world.road.network, int(world.config["other_vehicles"])

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        side = int(rng.integers(2))
        lane = network.get_lane(("a", "b", side))
        put_on_lane(cars[0], drivers[0], table, lane, float(rng.uniform(20, 50)), lane.speed_limit)
        if others <= 0:
            return 1
        along = rng.uniform(0.0, network.get_lane(("b", "c", 0)).length)
        speed = 6.0 + rng.uniform(high=3.0)
        put_on_lane(cars[1], drivers[1], table, network.get_lane(("b", "c", side)), along, speed)
        count = 2
        for _ in range(rng.integers(others)):
            lane = network.get_lane(network.random_lane_index(rng))
            along = rng.uniform(0.0, lane.length)
            speed, (x, y) = 6.0 + rng.uniform(high=3.0), lane.position(along, 0.0)
            if np.hypot(cars["x"][:count] - x, cars["y"][:count] - y).min() >= APART_M:
                put_on_lane(cars[count], drivers[count], table, lane, along, speed)
                count += 1
        return count

    return start


def _ends_of_track(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.vector.world_kernel import OF_TRACK

    c = world.config
    return {
        "duration_s": c["duration"], "off_road_ends": c["terminate_off_road"], "reward": OF_TRACK,
        "collision": c["collision_reward"], "first": c["lane_centering_reward"], "second": c["lane_centering_cost"],
    }  # fmt: skip


def _effort_on_track(world: AbstractEnv, actions: NDArray[Any]) -> Array:
    """Weighted length of each action, in the precision of the action as highway-env computes it."""
    lengths = [world.config["action_reward"] * np.linalg.norm(action) for action in actions]
    return np.array(lengths, dtype=np.float64)


def merge_support() -> Support:
    """Support of ``merge-v0`` and ``merge-v1``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 5,
        starter=_at_slip_road,
        ends=_ends_of_merge,
        refusals=only_idm,
        drivers=IDMVehicle,
        effort=_effort_of_change,
    )


def _at_slip_road(world: AbstractEnv, table: LaneTable) -> Starter:
    network = world.road.network

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        put(cars[0], drivers[0], table, network.get_lane(("a", "b", 1)).position(30.0, 0.0), 0.0, 30.0)
        for i, (along, speed) in enumerate([(90.0, 29.0), (70.0, 31.0), (5.0, 31.5)], 1):
            lane = network.get_lane(("a", "b", int(rng.integers(2))))
            position = lane.position(along + rng.uniform(-5.0, 5.0), 0.0)
            put(cars[i], drivers[i], table, position, 0.0, speed + rng.uniform(-1.0, 1.0))
        put(cars[4], drivers[4], table, network.get_lane(("j", "k", 0)).position(110.0, 0.0), 0.0, 20.0, 30.0)
        return 5

    return start


def _ends_of_merge(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.batch.lanes import lane_table
    from lanebound.envs.vector.world_kernel import OF_MERGE

    c, row = world.config, lane_table(world.road.network).row
    slow, fast = c["reward_speed_range"]
    return {
        "duration_s": np.inf, "reward": OF_MERGE, "collision": c["collision_reward"], "first": c["right_lane_reward"],
        "second": c["high_speed_reward"], "third": c["merging_speed_reward"], "merging": row["b", "c", 2],
        "slow_mps": slow, "fast_mps": fast, "ends_x_m": 370.0, "goal_road": row["c", "d", 0], "goal_m": -np.inf,
    }  # fmt: skip


def _effort_of_change(world: AbstractEnv, actions: NDArray[Any]) -> Array:
    """Weight of a change of lane, which highway-env takes actions 0 and 2 for; a single command may be 0 as well."""
    if actions.ndim > 1 and actions.shape[1] > 1:
        return np.zeros(len(actions))  # no comparison is made with several commands
    changes = (actions == 0) | (actions == 2)
    return np.where(changes.reshape(len(actions)), float(world.config["lane_change_reward"]), 0.0)


def roundabout_support() -> Support:
    """Support of ``roundabout-v0`` and ``roundabout-v1``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 5,
        starter=_at_roundabout,
        ends=_ends_of_roundabout,
        refusals=even_speeds,
        drivers=IDMVehicle,
        plans=_plans_at_roundabout,
        effort=_effort_of_change,
    )


def _plans_at_roundabout(world: AbstractEnv, table: LaneTable) -> Plans:
    from lanebound.envs.batch.plans import Plans

    own = [OWN] if isinstance(world.action_type, DiscreteMetaAction) else []
    return Plans(world.road.network, table, own, GOALS)


def _at_roundabout(world: AbstractEnv, table: LaneTable) -> Starter:
    network, plans = world.road.network, _plans_at_roundabout(world, table)
    given, planned = world.config["incoming_vehicle_destination"], plans.own > 1

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        lane = network.get_lane(OWN[0])
        put(cars[0], drivers[0], table, lane.position(125.0, 0.0), float(lane.heading_at(140.0)), 8.0)
        drivers[0]["route"] = plans.at(int(cars["lane"][0]), OWN[1]) if planned else 0
        starts = (("we", "sx", 1), 5.0), (("we", "sx", 0), 20.0), (("we", "sx", 0), -20.0), (("eer", "ees", 0), 50.0)
        for i, (index, along) in enumerate(starts, 1):
            along, speed = along + rng.normal() * 2.0, 16.0 + rng.normal() * 2.0
            put_on_lane(cars[i], drivers[i], table, network.get_lane(index), along, speed)
            goal = GOALS[given] if i == 1 and given is not None else str(rng.choice(GOALS))
            drivers[i]["route"] = plans.at(int(cars["lane"][i]), goal)
            drivers[i]["delta"] = rng.uniform(low=IDMVehicle.DELTA_RANGE[0], high=IDMVehicle.DELTA_RANGE[1])
        return 5

    return start


def _ends_of_roundabout(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.batch.lanes import lane_table
    from lanebound.envs.vector.world_kernel import OF_ROUNDABOUT

    c, inner, row = world.config, world.action_type, lane_table(world.road.network).row
    speeds = inner.target_speeds if isinstance(inner, DiscreteMetaAction) else MDPVehicle.DEFAULT_TARGET_SPEEDS
    return {
        "duration_s": c["duration"], "reward": OF_ROUNDABOUT, "collision": c["collision_reward"],
        "second": c["high_speed_reward"], "slow_mps": speeds[0], "fast_mps": speeds[-1], "levels": len(speeds) - 1,
        "normalize": c["normalize_reward"], "goal_road": row["nxs", "nxr", 0], "goal_m": BEYOND_CIRCLE_M,
    }  # fmt: skip
