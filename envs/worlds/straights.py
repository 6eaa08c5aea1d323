"""Support of highway-env's straight roads by the vector engine: an exit, a two-way road, a U-turn between two.

Each starter makes the random draws of its world in the same order, so that a seed gives the same traffic.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from lanebound.envs.worlds.highway import even_speeds, only_idm
from lanebound.envs.worlds.idm_parameters_kernel import STAYS
from lanebound.envs.worlds.kinds import Starter, Support
from lanebound.envs.worlds.seating import put, put_on_lane

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.envs.batch.plans import Plans
    from lanebound.integrity.core.records import Records

__all__ = ["exit_support", "turn_support", "two_way_support"]

Array = NDArray[np.float64]
PLACE_M = 12.0  # of Vehicle.create_random
EXIT_MPS = 25.0  # of ExitEnv: speed of the ego at the start
FIRST, BESIDE, LAST, EXIT = ("0", "1"), ("1", "2"), "3", ("2", "exit", 0)  # roads of ExitEnv, and the exit
STAYING = (70.0, 110.0, 150.0), (200.0, 300.0)  # of TwoWayEnv: stations of the others in each direction
TURN_TO = "d"  # of UTurnEnv: where all drive
AT_TURN = (  # of UTurnEnv: lane, station and speed of the others
    (("a", "b", 0), 25.0, 13.5), (("a", "b", 1), 56.0, 14.5), (("b", "c", 1), 0.5, 4.5), (("b", "c", 0), 17.5, 5.5),
    (("c", "d", 0), 1.0, 3.5), (("c", "d", 1), 30.0, 5.5),
)  # fmt: skip


def exit_support() -> Support:
    """Support of ``exit-v0`` and ``exit-v1``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 1 + int(world.config["vehicles_count"]),
        starter=_before_exit,
        ends=_ends_of_exit,
        refusals=only_idm,
        drivers=IDMVehicle,
        plans=_plans_past_exit,
    )


def _plans_past_exit(world: AbstractEnv, table: LaneTable) -> Plans:
    from lanebound.envs.batch.plans import Plans

    return Plans(world.road.network, table, goals=[LAST])


def _before_exit(world: AbstractEnv, table: LaneTable) -> Starter:
    c, network, plans = world.config, world.road.network, _plans_past_exit(world, table)
    count, lanes = int(c["vehicles_count"]), np.arange(c["lanes_count"])
    packed, spacing = np.exp(-5 / 40 * lanes.size), 1 / c["vehicles_density"]

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        gap = c["ego_spacing"] * (PLACE_M + EXIT_MPS) * packed
        along = 3 * gap + gap * rng.uniform(0.9, 1.1)
        put_on_lane(cars[0], drivers[0], table, network.get_lane((*FIRST, 0)), along, EXIT_MPS)
        for i in range(1, 1 + count):
            side = int(rng.choice(lanes, size=1, p=lanes / lanes.sum())[0])
            lane = network.get_lane((*FIRST, side))
            station = along + spacing * (PLACE_M + lane.speed_limit) * packed * rng.uniform(0.9, 1.1)
            put_on_lane(cars[i], drivers[i], table, lane, station, lane.speed_limit)
            along = max(along, station)  # highway-env counts from the vehicle ahead of all; a negative limit steps back
            drivers[i]["route"], drivers[i]["timer"] = plans.at(int(cars["lane"][i]), LAST), STAYS
        return 1 + count

    return start


def _ends_of_exit(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.batch.lanes import lane_table
    from lanebound.envs.vector.world_kernel import OF_EXIT

    c, row = world.config, lane_table(world.road.network).row
    slow, fast = c["reward_speed_range"]
    goals = row[(*BESIDE, int(c["lanes_count"]))], row[EXIT]
    return {
        "duration_s": c["duration"], "reward": OF_EXIT, "collision": c["collision_reward"],
        "first": c["right_lane_reward"], "second": c["high_speed_reward"], "third": c["goal_reward"], "slow_mps": slow,
        "fast_mps": fast, "normalize": c["normalize_reward"], "exits": sum(1 << lane for lane in goals),
        "goal_m": np.inf,
    }  # fmt: skip


def two_way_support() -> Support:
    """Support of ``two-way-v0``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 1 + sum(map(len, STAYING)),
        starter=_on_two_ways,
        ends=_ends_of_two_ways,
        refusals=even_speeds,
        drivers=IDMVehicle,
    )


def _on_two_ways(world: AbstractEnv, table: LaneTable) -> Starter:
    right, oncoming = (world.road.network.get_lane(index) for index in (("a", "b", 1), ("b", "a", 0)))

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        put_on_lane(cars[0], drivers[0], table, right, 30.0, 30.0)
        i = 1
        for lane, stations, mean, spread in ((right, STAYING[0], 24.0, 2.0), (oncoming, STAYING[1], 20.0, 5.0)):
            for station in stations:
                along = station + 10.0 * rng.normal()
                speed = mean + spread * rng.normal()
                heading = float(lane.heading_at(station))
                put(cars[i], drivers[i], table, lane.position(along, 0.0), heading, speed)
                drivers[i]["timer"] = STAYS
                i += 1
        return i

    return start


def _ends_of_two_ways(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.vector.world_kernel import OF_TWO_WAY

    c, speeds = world.config, world.action_type.target_speeds
    return {
        "duration_s": np.inf, "reward": OF_TWO_WAY, "first": c["left_lane_reward"], "second": c["high_speed_reward"],
        "slow_mps": speeds[0], "fast_mps": speeds[-1], "levels": len(speeds) - 1,
    }  # fmt: skip


def turn_support() -> Support:
    """Support of ``u-turn-v0`` and ``u-turn-v1``."""
    return Support(
        traffic="network",
        vehicles=lambda world: 1 + len(AT_TURN),
        starter=_before_turn,
        ends=_ends_of_turn,
        refusals=only_idm,
        drivers=IDMVehicle,
        plans=_plans_around,
    )


def _plans_around(world: AbstractEnv, table: LaneTable) -> Plans:
    from lanebound.envs.batch.plans import Plans

    own = [(("a", "b", 0), TURN_TO)] if isinstance(world.action_type, DiscreteMetaAction) else []
    return Plans(world.road.network, table, own, [TURN_TO])


def _before_turn(world: AbstractEnv, table: LaneTable) -> Starter:
    network, plans = world.road.network, _plans_around(world, table)
    planned = plans.own > 1

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        put_on_lane(cars[0], drivers[0], table, network.get_lane(("a", "b", 0)), 0.0, 16.0)
        drivers[0]["route"] = plans.at(int(cars["lane"][0]), TURN_TO) if planned else 0
        for i, (index, along, speed) in enumerate(AT_TURN, 1):
            along, speed = along + rng.normal() * 2.0, speed + rng.normal() * 2.0
            put_on_lane(cars[i], drivers[i], table, network.get_lane(index), along, speed)
            drivers[i]["route"] = plans.at(int(cars["lane"][i]), TURN_TO)
            if i == 1:
                drivers[i]["delta"] = rng.uniform(low=IDMVehicle.DELTA_RANGE[0], high=IDMVehicle.DELTA_RANGE[1])
        return 1 + len(AT_TURN)

    return start


def _ends_of_turn(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.vector.world_kernel import OF_TURN

    c = world.config
    slow, fast = c["reward_speed_range"]
    return {
        "duration_s": c["duration"], "reward": OF_TURN, "collision": c["collision_reward"],
        "first": c["left_lane_reward"], "second": c["high_speed_reward"], "slow_mps": slow, "fast_mps": fast,
        "normalize": c["normalize_reward"],
    }  # fmt: skip
