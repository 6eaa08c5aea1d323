"""End rules and rewards of the wrapped worlds, compiled."""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import local, on_lane, width_at
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import record

__all__ = ["NO_REWARD", "OF_HIGHWAY", "OF_ROADS", "WORLD", "judge", "judge_rows"]

NO_REWARD, OF_HIGHWAY, OF_ROADS = 0, 1, 2  # kinds of rewards

WORLD = record(
    speed_least_mps="the ego is held above",
    speed_most_mps="the ego is held below",
    episode_s="when an episode is truncated",
    duration_s="when the wrapped world truncates it",
    tolerance_s="by which it does so earlier, for rounding",
    off_road_ends=("i8", "1 where the wrapped world ends an episode off the road"),
    against_ends=("i8", "1 where driving against the lane ends it at once"),
    end_m="before the end of the road an episode is over; negative for roads without an end",
    reward=("i8", "kind of the world's own reward"),
    collision="weight of a crash in it",
    first="weight of progress, or of the right lane",
    second="weight of the middle of the lane, or of speed",
    slow_mps="speed that is worth nothing (highway)",
    fast_mps="speed that is worth all (highway)",
    normalize=("i8", "1 where the reward is brought to [0, 1] (highway)"),
)


@jit(borrows=True)
def judge_rows(first, last, rows, cars, egos, lanes, rules, world, start):  # type: ignore[no-untyped-def]
    """:func:`judge` for environments ``rows[first:last]``."""
    for e in rows[first:last]:
        judge(cars[e, 0], egos[e], lanes, rules[0], world[0], start)


@jit(borrows=True)
def judge(car, ego, lanes, rules, world, start):  # type: ignore[no-untyped-def]
    """Fill the facts of a policy step: ends and reward of the wrapped world; of a start, where no time has passed."""
    sc, facts, policy = ego.score, ego.facts, rules.policy_s
    lane, speed, crashed = car.lane, car.speed, car.crashed != 0
    s, r, direction = local(lanes, lane, car.x, car.y)
    angle, on_road = wrap(car.heading - direction), on_lane(lanes, lane, s, r, 0.0)
    facts.on_road, facts.terminated, facts.truncated, facts.base = 1 if on_road else 0, 0, 0, 0.0
    facts.arrived = 1
    if start:
        return
    sc.time_s += policy
    over = crashed or (world.off_road_ends != 0 and not on_road)
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
