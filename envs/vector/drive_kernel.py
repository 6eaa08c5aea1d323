"""Simulation steps of compiled traffic: all decide by where all are, then all move, then they may crash.

One entry kernel for each kind of traffic, so that only those that a configuration needs are compiled. After each step
the egos' own knowledge follows: given positions at once; sensed ones are carried on, but not at the end of an epoch,
which :mod:`..batch.rows_kernel` concludes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.belief_kernel import take_given
from lanebound.envs.batch.ego_kernel import decide
from lanebound.envs.batch.records_kernel import cars_of
from lanebound.envs.batch.rows_kernel import carry_on, follow_motion
from lanebound.envs.vector.city_kernel import decide_all, drive_city, place_all
from lanebound.envs.vector.collisions_kernel import collide_all, collide_sorted
from lanebound.envs.vector.course_kernel import drive_profiles
from lanebound.envs.vector.drivers_kernel import command_ego, drivers_of, move_ego
from lanebound.envs.vector.motorway_kernel import accelerate, change_lanes, drive_others, sort_along, survey
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["Course", "run_city", "run_course", "run_motorway"]


class Course(NamedTuple):
    """What the vehicles drive by: rules (1,) RULES; world (1,) WORLD; speeds: target speeds of meta-actions.

    profile (N, S): speeds of the vehicles that drive a profile, step by step.
    """

    rules: Records
    world: Records
    speeds: NDArray[np.float64]
    profile: NDArray[np.float64]


@jit(inline=True)
def _conclude(e, final, cars, motions, tracks, b, lanes, rules):  # type: ignore[no-untyped-def]
    """Bring the ego's knowledge up to date with a step; the final one of an epoch is concluded elsewhere."""
    if tracks is None:
        take_given(b, cars_of(cars, e), lanes, rules.step_s, rules)
    elif not final:
        carry_on(tracks[e], b, lanes, rules)
    if motions is not None:
        if not final:
            follow_motion(motions, cars, e)


@jit
def run_course(first, last, rows, frames, actions, cars, drivers, motions, tracks, ego, lanes, course):  # type: ignore[no-untyped-def]
    """``frames`` steps among vehicles that drive profiles of speeds, or alone.

    actions (N,): codes of meta-actions taken up before, None for none; motions, tracks: None where nothing is sensed, or
    the egos' positions are given.
    """
    rules, world = course.rules[0], course.world[0]
    dt = rules.step_s
    for n in range(first, last):
        e = rows[n]
        car, drv, b, sc = cars_of(cars, e), drivers_of(drivers, e), ego.belief[e], ego.score[e]
        if actions is not None:
            decide(b, actions[e], lanes, course.speeds)
        for frame in range(frames):
            steering, acceleration, hold = command_ego(b, ego.command[e], car, drv, lanes, rules)
            slowest, fastest = world.speed_least_mps, world.speed_most_mps
            move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
            drive_profiles(car, drv, lanes, course.profile[e], sc.steps + 1, dt)
            collide_all(car, drv, dt)
            sc.steps += 1
            _conclude(e, frame + 1 == frames, cars, motions, tracks, b, lanes, rules)


@jit
def run_motorway(first, last, rows, frames, actions, cars, drivers, motions, tracks, ego, lanes, course):  # type: ignore[no-untyped-def]
    """``frames`` steps among the drivers of a straight motorway; parameters as of :func:`run_course`."""
    rules, world, table = course.rules[0], course.world[0], lanes.table
    dt, vehicles = rules.step_s, cars.x.shape[1]
    newest, held = np.empty(table.shape[0] + 1, np.int64), np.empty((2, vehicles), np.int64)
    pairs, slip = np.empty(vehicles * vehicles // 2 + 1, np.int64), np.empty(vehicles)
    for n in range(first, last):
        e = rows[n]
        car, drv, b, sc = cars_of(cars, e), drivers_of(drivers, e), ego.belief[e], ego.score[e]
        if actions is not None:
            decide(b, actions[e], lanes, course.speeds)
        for frame in range(frames):
            steering, acceleration, hold = command_ego(b, ego.command[e], car, drv, lanes, rules)
            survey(car, drv, table, newest, held)
            change_lanes(car, drv, table, rules.meta != 0)
            accelerate(car, drv, table)
            slowest, fastest = world.speed_least_mps, world.speed_most_mps
            move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
            drive_others(car, drv, table, dt, slip)
            sort_along(car, drv)
            collide_sorted(car, drv, dt, pairs)
            sc.steps += 1
            _conclude(e, frame + 1 == frames, cars, motions, tracks, b, lanes, rules)


@jit
def run_city(first, last, rows, frames, actions, cars, drivers, motions, tracks, ego, lanes, course):  # type: ignore[no-untyped-def]
    """``frames`` steps among the drivers of a city; parameters as of :func:`run_course`."""
    rules, world = course.rules[0], course.world[0]
    dt, places = rules.step_s, np.empty((cars.x.shape[1], lanes.table.shape[0]))
    for n in range(first, last):
        e = rows[n]
        car, drv, b, sc = cars_of(cars, e), drivers_of(drivers, e), ego.belief[e], ego.score[e]
        if actions is not None:
            decide(b, actions[e], lanes, course.speeds)
        for frame in range(frames):
            steering, acceleration, hold = command_ego(b, ego.command[e], car, drv, lanes, rules)
            place_all(car, lanes, places)
            decide_all(car, drv, lanes, places, rules.meta != 0)
            slowest, fastest = world.speed_least_mps, world.speed_most_mps
            move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
            drive_city(car, drv, lanes, dt)
            collide_all(car, drv, dt)
            sc.steps += 1
            _conclude(e, frame + 1 == frames, cars, motions, tracks, b, lanes, rules)
