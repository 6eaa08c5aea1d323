"""Simulation steps of compiled traffic: all vehicles decide by the poses of all, then move; then crashes are found.

One entry kernel for each kind of traffic, so that only those that a configuration needs are compiled. After each step
the beliefs of the egos are carried on; :class:`..batch.episodes.Episodes` completes an epoch.

``kernel(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, lanes, rules, traffic)``: ``frames``
steps, with which the policy step ``ends`` or not; codes (N,) of meta-actions to be taken up before, (0,) for none;
drivers (N, V) DRIVER; the others as in :mod:`..batch.rows_kernel`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import decide
from lanebound.envs.batch.rows_kernel import carry_on
from lanebound.envs.vector.city_kernel import decide_all, drive_city, place_all
from lanebound.envs.vector.collisions_kernel import collide_all, collide_sorted
from lanebound.envs.vector.course_kernel import drive_profiles
from lanebound.envs.vector.drivers_kernel import (
    NUMBERS,
    WHOLES,
    command_ego,
    load,
    move_ego,
    show,
    store,
    vehicles_in,
    wander_all,
)
from lanebound.envs.vector.motorway_kernel import accelerate, change_lanes, drive_others, sort_along, survey
from lanebound.envs.vector.world_kernel import judge
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["TrafficFigures", "run_city", "run_course", "run_motorway"]


class TrafficFigures(NamedTuple):
    """The parameters of the motion of vehicles.

    world (1,) WORLD; speeds: target speeds of meta-actions; profile (N, S): prescribed speeds of other vehicles [m/s],
    by simulation step; wander (S, K) [m]: shapes over time of the others' lines in their lanes, by simulation step.
    """

    world: Records
    speeds: NDArray[np.float64]
    profile: NDArray[np.float64]
    wander: NDArray[np.float64]


@jit
def run_course(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, lanes, rules, traffic):  # type: ignore[no-untyped-def]
    """Vehicles that drive profiles of speeds, or the ego alone."""
    numbers, wholes = np.empty((NUMBERS, cars.shape[1])), np.empty((WHOLES, cars.shape[1]), np.int64)
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        v = _begin(e, codes, here, drivers[e], egos[e], lanes, traffic, numbers, wholes)
        _course(e, frames, v, here, egos[e], motions[e], lanes, rules[0], traffic)
        _end(v, here, drivers[e], egos[e], lanes, rules[0], traffic.world[0], ends)


@jit(inline=True)
def _begin(e, codes, cars, drivers, ego, lanes, traffic, numbers, wholes):  # type: ignore[no-untyped-def]
    """The vehicles of environment e as they begin to drive, with its meta-action taken up."""
    if codes.size > 0:
        decide(ego.belief, codes[e], lanes, traffic.speeds)
    v = vehicles_in(numbers, wholes, cars.shape[0])
    load(cars, drivers, v)
    return v


@jit(inline=True)
def _end(v, cars, drivers, ego, lanes, rules, world, ends):  # type: ignore[no-untyped-def]
    """Store the vehicles after the last step, and judge the policy step if it ends."""
    store(v, cars, drivers)
    if ends:
        judge(cars[0], ego, lanes, rules, world, False)


@jit(inline=True)
def _conclude(v, cars, ego, motions, lanes, rules, ends_epoch):  # type: ignore[no-untyped-def]
    """Carry the belief of the ego on after a step; only those that navigate are seen before the end."""
    show(v, cars[: max(motions.shape[0], 1)])
    carry_on(ego, cars, motions, lanes, rules, ends_epoch)


@jit(borrows=True)
def _course(e, frames, v, cars, ego, motions, lanes, rules, traffic):  # type: ignore[no-untyped-def]
    """:func:`run_course` for environment e."""
    world, dt = traffic.world[0], rules.step_s
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, rules)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps += 1
        wander_all(v, traffic.wander[min(ego.score.steps, traffic.wander.shape[0] - 1)], dt)
        drive_profiles(v, lanes, traffic.profile[e], ego.score.steps, dt)
        collide_all(v, dt)
        _conclude(v, cars, ego, motions, lanes, rules, frame + 1 == frames)


@jit
def run_motorway(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, lanes, rules, traffic):  # type: ignore[no-untyped-def]
    """The drivers of a straight motorway."""
    vehicles = cars.shape[1]
    numbers, wholes = np.empty((NUMBERS, vehicles)), np.empty((WHOLES, vehicles), np.int64)
    newest, held = np.empty(lanes.table.shape[0] + 1, np.int64), np.empty((2, vehicles), np.int64)
    pairs = np.empty(vehicles * vehicles // 2 + 1, np.int64)
    scratch = newest, held, pairs, np.empty(vehicles), np.empty((5, vehicles))
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        v = _begin(e, codes, here, drivers[e], egos[e], lanes, traffic, numbers, wholes)
        _motorway(frames, v, here, egos[e], motions[e], lanes, rules[0], traffic, scratch)
        _end(v, here, drivers[e], egos[e], lanes, rules[0], traffic.world[0], ends)


@jit(borrows=True)
def _motorway(frames, v, cars, ego, motions, lanes, rules, traffic, scratch):  # type: ignore[no-untyped-def]
    """:func:`run_motorway` for one environment.

    ``scratch``: newest (L + 1,), held (2, V), pairs (P,), slip (V,), front (5, V).
    """
    newest, held, pairs, slip, front = scratch
    world, dt = traffic.world[0], rules.step_s
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, rules)
        survey(v, lanes.table, newest, held)
        change_lanes(v, lanes.table, rules.meta != 0)
        accelerate(v, lanes.table, front)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps += 1
        wander_all(v, traffic.wander[min(ego.score.steps, traffic.wander.shape[0] - 1)], dt)
        drive_others(v, lanes.table, dt, slip)
        sort_along(v)
        collide_sorted(v, dt, pairs)
        _conclude(v, cars, ego, motions, lanes, rules, frame + 1 == frames)


@jit
def run_city(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, lanes, rules, traffic):  # type: ignore[no-untyped-def]
    """The drivers of a city."""
    numbers, wholes = np.empty((NUMBERS, cars.shape[1])), np.empty((WHOLES, cars.shape[1]), np.int64)
    places = np.empty((cars.shape[1], lanes.table.shape[0]))
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        v = _begin(e, codes, here, drivers[e], egos[e], lanes, traffic, numbers, wholes)
        _city(frames, v, here, egos[e], motions[e], lanes, rules[0], traffic, places)
        _end(v, here, drivers[e], egos[e], lanes, rules[0], traffic.world[0], ends)


@jit(borrows=True)
def _city(frames, v, cars, ego, motions, lanes, rules, traffic, places):  # type: ignore[no-untyped-def]
    """:func:`run_city` for one environment; places (V, L) is scratch."""
    world, dt = traffic.world[0], rules.step_s
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, rules)
        place_all(v, lanes, places)
        decide_all(v, lanes, places, rules.meta != 0)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps += 1
        wander_all(v, traffic.wander[min(ego.score.steps, traffic.wander.shape[0] - 1)], dt)
        drive_city(v, lanes, dt)
        collide_all(v, dt)
        _conclude(v, cars, ego, motions, lanes, rules, frame + 1 == frames)
