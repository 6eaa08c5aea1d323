"""A motorway with a collector road beside it: which of them a car is on decides its speed and its lane.

Both have two lanes, and lanes for exits at the same places, so that a camera cannot tell them apart. The goal is an
exit of the collector road. From the motorway a slip road leads to the collector road; at the same place the collector
road has an exit that does not lead to the goal. Distances along x [m], lanes from the left:

===========  =========================================  ==============================================
x            motorway                                   collector road
===========  =========================================  ==============================================
0 to 400     two lanes                                  two lanes
400 to 700   a third lane on the right: the slip road   a third lane on the right: another exit
700          the slip road leaves (S-bend)              that exit leaves
from 824     two lanes to its end                       a third lane on the left, 200 m: the slip road joins
to 1124                                                 two lanes, 100 m
to 1374                                                 a third lane on the right, 250 m: the goal's exit
===========  =========================================  ==============================================
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.base import META, Array, Seat, World
from lanebound.envs.worlds.networks import StreetNetwork
from lanebound.envs.worlds.paths import Path, Piece, Pose, s_bend, straight

__all__ = ["GuidanceWorld", "has_taken_exit", "parallel_roads"]

MOTORWAY_MPS, COLLECTOR_MPS = 27.8, 13.9  # 100 and 50 km/h
RADIUS_M, TRANSITION_M = 250.0, 20.0  # of slip roads: 0.8 m/s2 at 50 km/h
NOSE_M, EXIT_SHIFT_M = 10.0, 13.0  # straight before and behind the bends of a slip road; shift of the other exits
FORK_M = 700.0  # where slip road and exit leave
AHEAD_M, EXIT_LANE_M = 400.0, 300.0  # before the lanes of the exits, and along them; they end at FORK_M
JOIN_M, BETWEEN_M, GOAL_LANE_M = 200.0, 100.0, 250.0
BEYOND_M = 300.0  # of roads that do not lead to the goal, and of the goal's
GOAL, GOAL_M = ("g", "goal"), 20.0  # road of the goal, and how far along it the goal is
START_M = (20.0, 180.0)
START_MPS = COLLECTOR_MPS  # on both roads: the speed at the start does not tell the road
TARGET_SPEEDS_MPS = [MOTORWAY_MPS * k / 6.0 for k in range(7)]  # every second one of them near half or all of a limit
ROOM_M = 40.0  # between the middles of vehicles of one lane at the start
OTHERS_M = (-60.0, 500.0)  # about the ego's place
OTHERS_SHARE = (0.75, 0.95)  # of the limit that others want to drive


def parallel_roads(width_m: float, separation_m: float) -> StreetNetwork:
    """Both roads; ``separation_m``: from the middle of the right motorway lane to that of the left collector lane."""
    w, south = width_m, width_m + separation_m  # y of the left collector lane
    network = StreetNetwork(GOAL)

    def add(start: str, end: str, x: float, y: float, pieces: list[Piece], lanes: range, limit: float) -> Pose:
        path = Path.of(Pose(x, y, 0.0), pieces)
        network.add_beside((start, end), path, lanes, w, limit)
        return path.pose_at(path.station[-1])

    def leaves(shift_m: float, beyond_m: float) -> list[Piece]:
        return [*straight(NOSE_M), *s_bend(shift_m, RADIUS_M, TRANSITION_M), *straight(beyond_m)]

    for name, y, limit in (("abc", 0.0, MOTORWAY_MPS), ("pqs", south, COLLECTOR_MPS)):
        add(name[0], name[1], 0.0, y, straight(AHEAD_M), range(2), limit)
        add(name[1], name[2], AHEAD_M, y, straight(EXIT_LANE_M), range(3), limit)
    join = add("c", "t", FORK_M, 2.0 * w, leaves(south - 3.0 * w, NOSE_M), range(1), COLLECTOR_MPS)
    exit_m = join.x + JOIN_M + BETWEEN_M + GOAL_LANE_M
    add("c", "d", FORK_M, 0.0, straight(exit_m + BEYOND_M - FORK_M), range(2), MOTORWAY_MPS)
    add("s", "t", FORK_M, south, straight(join.x - FORK_M), range(2), COLLECTOR_MPS)
    add("s", "w", FORK_M, south + 2.0 * w, leaves(EXIT_SHIFT_M, BEYOND_M), range(1), COLLECTOR_MPS)
    add("t", "u", join.x, south, straight(JOIN_M), range(-1, 2), COLLECTOR_MPS)
    add("u", "v", join.x + JOIN_M, south, straight(BETWEEN_M), range(2), COLLECTOR_MPS)
    add("v", "g", exit_m - GOAL_LANE_M, south, straight(GOAL_LANE_M), range(3), COLLECTOR_MPS)
    add("g", "e", exit_m, south, straight(BEYOND_M), range(2), COLLECTOR_MPS)
    add(*GOAL, exit_m, south + 2.0 * w, leaves(EXIT_SHIFT_M, BEYOND_M), range(1), COLLECTOR_MPS)
    return network


def has_taken_exit(world: AbstractEnv) -> bool:
    """Whether the ego is at the goal."""
    vehicle = world.vehicle
    return vehicle.lane_index[:2] == GOAL and bool(vehicle.lane.local_coordinates(vehicle.position)[0] >= GOAL_M)


class GuidanceWorld(World):
    """Find the way to an exit of a collector road, from there or from the motorway beside it.

    Action, observation, reward
        Those of :class:`World`; meta-actions at 2 Hz by default, from 0 to 27.8 m/s in steps of 4.6.
    Start
        On a random lane of either road, at 13.9 m/s; the others on both roads, behind and ahead.
    Episode end
        That of :class:`World`, and terminated at the goal.
    Configuration
        ``separation`` [m] (from the middle of the motorway's right lane to that of the collector's left lane),
        ``lane_width`` [m], ``vehicles_count`` (largest number of others; one without room is left out).
    """

    OTHERS: ClassVar[type[Vehicle]] = IDMVehicle
    TRAFFIC: ClassVar[str] = "network"
    ENDS_M: ClassVar[float | None] = None

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {
            "action": META | {"target_speeds": TARGET_SPEEDS_MPS},
            "policy_frequency": 2,
            "lane_width": 3.5,
            "duration": 150.0,
            "separation": 18.0,
            "vehicles_count": 6,
        }

    def _network(self) -> StreetNetwork:
        return parallel_roads(self.config["lane_width"], self.config["separation"])

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """Number of the ego and all others, some of which may be left out."""
        return 1 + int(config["vehicles_count"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw the road, lane and place of the ego, and those of the others on both roads."""
        roads, network = (("a", "b"), ("p", "q")), self.road.network
        index: LaneIndex = (*roads[int(rng.integers(2))], int(rng.integers(2)))
        along = float(rng.uniform(*START_M))
        seats, taken = [Seat(index, along, START_MPS)], {(index, along)}
        for _ in range(int(self.config["vehicles_count"])):
            there: LaneIndex = (*roads[int(rng.integers(2))], int(rng.integers(2)))
            place, share = along + float(rng.uniform(*OTHERS_M)), float(rng.uniform(*OTHERS_SHARE))
            exponent = float(rng.uniform(*IDMVehicle.DELTA_RANGE))
            if not 0.0 < place < AHEAD_M or any(lane == there and abs(s - place) < ROOM_M for lane, s in taken):
                continue
            wanted = share * network.get_lane(there).speed_limit
            seats.append(Seat(there, place, min(wanted, START_MPS), wanted, exponent))
            taken.add((there, place))
        return seats, None

    @staticmethod
    def _ends(world: AbstractEnv) -> dict[str, float]:
        from lanebound.envs.batch.lanes import lane_table

        row = lane_table(world.road.network).row
        return World._ends(world) | {"goal_road": row[(*GOAL, 0)], "goal_m": GOAL_M}
