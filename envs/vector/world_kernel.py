"""End rules and rewards of the wrapped worlds, compiled."""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.batch.lanes_kernel import STRAIGHT, local, on_lane, width_at
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import record

__all__ = [
    "NO_REWARD",
    "OF_CROSSING",
    "OF_EXIT",
    "OF_HIGHWAY",
    "OF_MERGE",
    "OF_ROADS",
    "OF_ROUNDABOUT",
    "OF_TRACK",
    "OF_TURN",
    "OF_TWO_WAY",
    "WORLD",
    "judge",
    "judge_rows",
]

(NO_REWARD, OF_HIGHWAY, OF_ROADS, OF_TRACK, OF_MERGE, OF_ROUNDABOUT, OF_CROSSING, OF_EXIT, OF_TURN,
 OF_TWO_WAY) = range(10)  # fmt: skip
"""Kinds of rewards."""
SPEEDS_BEFORE_LAST = 2.0  # of MDPVehicle.DEFAULT_TARGET_SPEEDS, whatever the speeds of the ego are

WORLD = record(
    speed_least_mps="the ego is held above",
    speed_most_mps="the ego is held below",
    episode_s="when an episode is truncated",
    duration_s="when the wrapped world truncates it",
    tolerance_s="by which it does so earlier, for rounding",
    off_road_ends=("i8", "1 where the wrapped world ends an episode off the road"),
    against_ends=("i8", "1 where driving against the lane ends it at once"),
    only_ego_crashes=("i8", "1 where others drive through each other (highway-fast)"),
    end_m="before the end of the road an episode is over; negative for roads without an end",
    reward=("i8", "kind of the world's own reward"),
    collision="weight of a crash in it",
    first="weight of progress, of the right lane, of the left one (two-way), or of the middle of the lane (track)",
    second="weight of the middle of the lane, of speed, or of the goal (crossing); per square metre off (track)",
    third="weight of vehicles that merge slowly (merge), or of the exit (exit)",
    merging=("i8", "lane on which they do"),
    slow_mps="speed that is worth nothing",
    fast_mps="speed that is worth all",
    levels="target speeds less 1 that lie evenly between these two (roundabout, two-way)",
    normalize=("i8", "1 where the reward is brought to [0, 1]"),
    ends_x_m="the episode ends beyond this x, inf for none",
    goal_road=("i8", "road on which the goal is, NONE without a goal"),
    exits=("i8", "lanes, by bit, on which the episode ends as far along (crossing), or that are rewarded; 0 for none"),
    goal_m="along the lanes of that road to the goal",
)


@jit(borrows=True)
def judge_rows(first, last, rows, cars, drivers, egos, lanes, rules, world, start):  # type: ignore[no-untyped-def]
    """:func:`judge` for environments ``rows[first:last]``."""
    for e in rows[first:last]:
        judge(cars[e, : egos[e].vehicles], drivers[e], egos[e], lanes, rules[0], world[0], start)


@jit(borrows=True)
def judge(cars, drivers, ego, lanes, rules, world, start):  # type: ignore[no-untyped-def]
    """Fill the facts of a policy step: ends and reward of the wrapped world; of a start, where no time has passed."""
    car, sc, facts, policy = cars[0], ego.score, ego.facts, rules.policy_s
    lane, speed, crashed = car.lane, car.speed, car.crashed != 0
    s, r, direction = local(lanes, lane, car.x, car.y)
    angle, on_road = wrap(car.heading - direction), on_lane(lanes, lane, s, r, 0.0)
    facts.on_road, facts.terminated, facts.truncated, facts.base = 1 if on_road else 0, 0, 0, 0.0
    beyond = car.x > world.ends_x_m
    arrived = lanes.table[lane].road == world.goal_road and s >= world.goal_m
    arrived = arrived and (beyond or world.ends_x_m == math.inf)
    facts.arrived = 1 if arrived or world.goal_road < 0 else 0
    if start:
        facts.terminated = 1 if arrived else 0
        return
    sc.time_s += policy
    left = s >= world.goal_m and (world.exits >> lane) & 1 != 0
    over = crashed or arrived or left or beyond or (world.off_road_ends != 0 and not on_road)
    over = over or (world.against_ends != 0 and abs(angle) > 0.5 * math.pi)
    late = sc.time_s >= world.duration_s - world.tolerance_s
    late = late or (world.end_m >= 0.0 and s > lanes.table[lane].length_m - world.end_m)
    late = late or sc.steps * rules.step_s >= world.episode_s - 0.5 * policy
    facts.terminated, facts.truncated = 1 if over else 0, 1 if late else 0
    if world.reward == OF_ROADS:
        facts.base = _of_roads(lanes, lane, s, r, speed * math.cos(angle), crashed, world)
    elif world.reward == OF_HIGHWAY:
        wanted = ego.belief.target_lane if rules.meta != 0 else lane
        facts.base = _of_highway(lanes, wanted, speed * math.cos(car.heading), crashed, world)
        facts.base *= 1.0 if on_road else 0.0
    elif world.reward == OF_TRACK:
        facts.base = _of_track(lanes.table[lane].kind, r, ego.command.effort, crashed, world)
        facts.base *= 1.0 if on_road else 0.0
    elif world.reward == OF_MERGE:
        facts.base = _of_merge(cars, drivers, ego, lanes, rules, world)
    elif world.reward == OF_ROUNDABOUT:
        wanted = ego.belief.target_speed_mps if rules.meta != 0 else speed
        facts.base = _of_roundabout(wanted, ego.command.effort, crashed, world) * (1.0 if on_road else 0.0)
    elif world.reward == OF_CROSSING:
        facts.base = _of_crossing(speed, left, crashed, on_road, world)
    elif world.reward == OF_TURN:
        facts.base = _of_highway(lanes, lane, speed, crashed, world) * (1.0 if on_road else 0.0)
    elif world.reward == OF_EXIT:
        wanted = ego.belief.target_lane if rules.meta != 0 else lane
        facts.base = _of_exit(lanes, wanted, speed, crashed, world)
    elif world.reward == OF_TWO_WAY:
        b = ego.belief
        facts.base = _of_two_way(lanes, lane, b.target_lane, b.target_speed_mps, world)


@jit(inline=True)
def _of_roads(lanes, lane, s, r, along, crashed, world):  # type: ignore[no-untyped-def]
    """The reward of the worlds of our own, :meth:`lanebound.envs.worlds.base.World._rewards`."""
    progress = min(max(along / lanes.table[lane].speed_limit_mps, 0.0), 1.0)
    nearness = max(1.0 - (2.0 * r / width_at(lanes, lane, s)) ** 2, 0.0)
    total = world.first * progress + world.second * (nearness * min(4.0 * progress, 1.0))
    total += world.collision * (1.0 if crashed else 0.0)
    return min(max((total - world.collision) / (world.first + world.second - world.collision), 0.0), 1.0)


@jit(inline=True)
def _of_highway(lanes, wanted, ahead, crashed, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``HighwayEnv`` on the road; ``ahead`` is the speed along x."""
    lane = lanes.table[wanted]
    right = lane.side / max(lane.count - 1.0, 1.0)
    fast = min(max((ahead - world.slow_mps) / (world.fast_mps - world.slow_mps), 0.0), 1.0)
    total = world.collision * (1.0 if crashed else 0.0) + world.first * right + world.second * fast
    if world.normalize != 0:
        total = (total - world.collision) / (world.second + world.first - world.collision)
    return total


@jit(inline=True)
def _of_track(kind, r, effort, crashed, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``RacetrackEnv`` on the road.

    NumPy sums it in float32 on straight lanes: their offset is a Python float, and the action is of float32.
    """
    middle, crash = world.first * (1.0 / (1.0 + world.second * (r * r))), world.collision * (1.0 if crashed else 0.0)
    total = middle + effort + crash
    if kind == STRAIGHT:
        total = float(np.float32(middle) + np.float32(effort) + np.float32(crash))
    return (total - world.collision) / (1.0 - world.collision)


@jit(borrows=True)
def _of_merge(cars, drivers, ego, lanes, rules, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``MergeEnv``."""
    slow, most = 0.0, world.second + world.first
    for i in range(cars.shape[0]):
        if cars[i].lane == world.merging and (i > 0 or rules.meta != 0):
            wanted = drivers[i].target_speed if i > 0 else ego.belief.target_speed_mps
            if wanted != 0.0:  # one that is to stand takes no part: highway-env divides by zero
                slow += (wanted - cars[i].speed) / wanted
    total = world.collision * (1.0 if cars[0].crashed != 0 else 0.0) + world.first * lanes.table[cars[0].lane].side
    total += world.second * ((cars[0].speed - world.slow_mps) / (world.fast_mps - world.slow_mps))
    total += ego.command.effort + world.third * slow
    least = world.collision + world.third
    return (total - least) / (most - least)


@jit(inline=True)
def _of_roundabout(wanted, effort, crashed, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``RoundaboutEnv`` on the road, for the speed that is wanted."""
    share = (wanted - world.slow_mps) / (world.fast_mps - world.slow_mps)
    index = min(max(round(share * world.levels), 0.0), world.levels)
    total = world.collision * (1.0 if crashed else 0.0) + world.second * (index / SPEEDS_BEFORE_LAST) + effort
    if world.normalize != 0:
        total = (total - world.collision) / (world.second - world.collision)
    return total


@jit(inline=True)
def _of_crossing(speed, left, crashed, on_road, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``IntersectionEnv``; ``left``: on an exit, far enough."""
    fast = min(max((speed - world.slow_mps) / (world.fast_mps - world.slow_mps), 0.0), 1.0)
    total = world.collision * (1.0 if crashed else 0.0) + world.first * fast
    total = (world.second if left else total) * (1.0 if on_road else 0.0)
    if world.normalize != 0:
        total = (total - world.collision) / (world.second - world.collision)
    return total


@jit(inline=True)
def _of_exit(lanes, wanted, speed, crashed, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``ExitEnv``, for the lane that is wanted."""
    fast = min(max((speed - world.slow_mps) / (world.fast_mps - world.slow_mps), 0.0), 1.0)
    total = world.collision * (1.0 if crashed else 0.0) + world.third * ((world.exits >> wanted) & 1)
    total += world.second * fast + world.first * lanes.table[wanted].side
    if world.normalize != 0:
        total = min(max((total - world.collision) / (world.third - world.collision), 0.0), 1.0)
    return total


@jit(inline=True)
def _of_two_way(lanes, lane, wanted, speed, world):  # type: ignore[no-untyped-def]
    """The reward of highway-env's ``TwoWayEnv``, for the lane and the speed that are wanted.

    highway-env fails where the ego is on the road of the oncoming traffic, which has one lane; here it counts as two.
    """
    share = (speed - world.slow_mps) / (world.fast_mps - world.slow_mps)
    most = max(lanes.table[lane].count - 1.0, 1.0)
    return world.second * (round(share * world.levels) / world.levels) + world.first * (
        (lanes.table[lane].count - 1.0 - lanes.table[wanted].side) / most
    )
