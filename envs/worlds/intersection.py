"""Support of highway-env's intersection by the vector engine: start and end of episodes, vehicles that enter.

Each start makes the random draws of ``IntersectionEnv`` in the same order, so that a seed gives the same traffic.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from numpy.typing import NDArray

from lanebound.envs.worlds.drivers import IntersectionDriver
from lanebound.envs.worlds.kinds import Entrance, Refusal, Starter, Support
from lanebound.envs.worlds.seating import close_up, put, put_on_lane

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.envs.batch.plans import Plans
    from lanebound.integrity.core.records import Records

__all__ = ["intersection_support"]

Array = NDArray[np.float64]
ARMS = range(4)
DESTINATIONS = "o1", "o2", "o3"
OWN = "o0", "ir0", 0  # first lane of the ego
BEFORE_S = 3  # of traffic before the ego is there
APART_M, EGO_APART_M = 15.0, 20.0  # from others, for a vehicle that enters and for those that are there before the ego
ARRIVED_M = 25.0  # beyond the crossing
FAR_M = 1e6  # where the ego is while the traffic drives without it
DRIVER_PATH = f"{IntersectionDriver.__module__}.{IntersectionDriver.__qualname__}"


def intersection_support() -> Support:
    """Support of ``intersection-v0``, ``intersection-v1`` and ``intersection-v2``."""
    return Support(
        traffic="crossing",
        vehicles=lambda world: 1 + max(int(world.config["initial_vehicle_count"]), 1),
        starter=_at_crossing,
        ends=_ends,
        refusals=_refusals,
        drivers=IntersectionDriver,
        plans=_plans,
        before=lambda world: BEFORE_S * int(world.config["simulation_frequency"]),
        entrance=_entrance,
    )


def _refusals(world: AbstractEnv) -> list[Refusal]:
    c, out = world.config, []
    if c["other_vehicles_type"] != DRIVER_PATH:
        out.append(("world.other_vehicles_type", "left out", c["other_vehicles_type"]))
    if c["destination"] not in DESTINATIONS:
        out.append(("world.destination", "o1, o2 or o3", c["destination"]))
    return out


def _plans(world: AbstractEnv, table: LaneTable) -> Plans:
    from lanebound.envs.batch.plans import Plans

    meta = isinstance(world.action_type, DiscreteMetaAction)
    own = [(OWN, str(world.config["destination"]))] if meta else []
    return Plans(world.road.network, table, own, [f"o{arm}" for arm in ARMS])


def _ends(world: AbstractEnv) -> Mapping[str, Any]:
    from lanebound.envs.batch.lanes import lane_table
    from lanebound.envs.vector.world_kernel import OF_CROSSING

    c, row = world.config, lane_table(world.road.network).row
    slow, fast = c["reward_speed_range"]
    exits = [n for (start, end, _), n in row.items() if "il" in start and "o" in end]
    goal = [n for (start, end, _), n in row.items() if "il" in start and end == c["destination"]]
    return {
        "duration_s": c["duration"], "off_road_ends": c["offroad_terminal"], "reward": OF_CROSSING,
        "collision": c["collision_reward"], "first": c["high_speed_reward"], "second": c["arrived_reward"],
        "slow_mps": slow, "fast_mps": fast, "normalize": c["normalize_reward"], "goal_m": ARRIVED_M,
        "goal_road": goal[0] if goal else -1, "exits": sum(1 << n for n in exits),
    }  # fmt: skip


class _Spawning:
    """``IntersectionEnv._spawn_vehicle``, for one road network."""

    def __init__(self, world: AbstractEnv, table: LaneTable) -> None:
        self.network, self.table, self.plans = world.road.network, table, _plans(world, table)

    def __call__(
        self, rng: np.random.Generator, cars: Records, drivers: Records, count: int, probability: float,
        along: float = 0.0, deviation: float = 1.0, speed_deviation: float = 1.0, straight: bool = False,
    ) -> int:  # fmt: skip
        """Let a vehicle enter, perhaps, behind ``count`` others; returns the number after that."""
        if rng.uniform() > probability:
            return count
        start, end = rng.choice(ARMS, size=2, replace=False).tolist()
        lane = self.network.get_lane((f"o{start}", f"ir{start}", 0))
        along = along + 5.0 + rng.normal() * deviation
        speed, (x, y) = 8.0 + rng.normal() * speed_deviation, lane.position(along, 0.0)
        if np.hypot(cars["x"][:count] - x, cars["y"][:count] - y).min() < APART_M:
            return count
        car, driver = cars[count], drivers[count]
        put_on_lane(car, driver, self.table, lane, along, speed)
        goal = (start + 2) % len(ARMS) if straight else end
        driver["route"] = self.plans.at(int(car["lane"]), f"o{goal}")
        driver["delta"] = rng.uniform(low=IntersectionDriver.DELTA_RANGE[0], high=IntersectionDriver.DELTA_RANGE[1])
        return count + 1


def _entrance(world: AbstractEnv, table: LaneTable) -> Entrance:
    spawn, probability = _Spawning(world, table), float(world.config["spawn_probability"])

    def enter(rng: np.random.Generator, cars: Records, drivers: Records, count: int) -> int:
        return spawn(rng, cars, drivers, count, probability)

    return enter


def _at_crossing(world: AbstractEnv, table: LaneTable) -> Starter:
    from lanebound.envs.vector.drive_kernel import run_unattended
    from lanebound.envs.vector.support import drivers_of, roads_of

    c, network, spawn = world.config, world.road.network, _Spawning(world, table)
    idm, roads = drivers_of(intersection_support(), world), roads_of(world, table, spawn.plans)
    hz, attempts = int(c["simulation_frequency"]), int(c["initial_vehicle_count"])
    planned, goal = spawn.plans.own > 1, str(c["destination"])

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        cars["x"][0] = cars["y"][0] = FAR_M
        count = 1
        for along in np.linspace(0, 80, attempts)[: attempts - 1].tolist():
            count = spawn(rng, cars, drivers, count, 0.6, along)
        run_unattended(cars[:count], drivers, BEFORE_S * hz, table.lanes, idm, roads, 1.0 / hz)
        count = spawn(rng, cars, drivers, count, 1.0, 60.0, 0.1, 0.0, True)
        lane = network.get_lane(OWN)
        position = lane.position(60.0 + 5.0 * rng.normal(1.0), 0.0)
        put(cars[0], drivers[0], table, position, float(lane.heading_at(60.0)), lane.speed_limit)
        drivers[0]["route"] = spawn.plans.at(int(cars["lane"][0]), goal) if planned else 0
        away = np.hypot(cars["x"][:count] - cars["x"][0], cars["y"][:count] - cars["y"][0])
        away[0] = np.inf
        count = close_up(cars, drivers, away >= EGO_APART_M)
        drivers[0]["order"] = count - 1  # it comes last in the list of vehicles
        return count

    return start
