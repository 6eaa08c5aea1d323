"""Simulation steps of compiled traffic: all vehicles decide by the poses of all, then move; then crashes are found.

One entry kernel for each kind of traffic, so that only those that a configuration needs are compiled. After each step
the beliefs of the egos are updated: given positions at once; sensed ones are carried on, except at the end of an epoch,
which :mod:`..batch.rows_kernel` completes.
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
from lanebound.envs.vector.drivers_kernel import Drivers, command_ego, drivers_of, move_ego, wander_all
from lanebound.envs.vector.motorway_kernel import accelerate, change_lanes, drive_others, sort_along, survey
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle
from lanebound.integrity.core.records import Records

__all__ = ["TrafficBatch", "run_city", "run_course", "run_motorway"]


class TrafficBatch(NamedTuple):
    """The vehicles of N environments, and the parameters of their motion.

    world (1,) WORLD; speeds: target speeds of meta-actions; profile (N, S): prescribed speeds of other vehicles [m/s],
    by simulation step; wander (S, K) [m]: shapes over time of the others' lines in their lanes, by simulation step.
    """

    drivers: Drivers
    world: Records
    speeds: NDArray[np.float64]
    profile: NDArray[np.float64]
    wander: NDArray[np.float64]


@jit(inline=True)
def _conclude(e, final, a, motions, tracks):  # type: ignore[no-untyped-def]
    """Update the belief of the ego after a step; :mod:`..batch.rows_kernel` completes the final one of an epoch."""
    if tracks is None:
        take_given(a.ego.belief[e], cars_of(a.cars, e), a.lanes, a.rules[0].step_s, a.rules[0])
    elif not final:
        carry_on(tracks[e], a.ego.belief[e], a.lanes, a.rules[0])
    if motions is not None:
        if not final:
            follow_motion(motions, a.cars, e)


@jit(borrows=True)
def run_course(first, last, rows, frames, actions, batch, traffic, motions, tracks):  # type: ignore[no-untyped-def]
    """``frames`` steps among vehicles that drive profiles of speeds, or alone.

    actions (N,): codes of meta-actions taken up before, None for none; batch, traffic: handles of Batch and
    TrafficBatch; motions, tracks: None where nothing is sensed, or the egos' positions are given.
    """
    a, t = unbundle(batch), unbundle(traffic)
    for n in range(first, last):
        _course(rows[n], frames, actions, a, t, motions, tracks)


@jit(borrows=True)
def _course(e, frames, actions, a, t, motions, tracks):  # type: ignore[no-untyped-def]
    """:func:`run_course` for one environment."""
    lanes, rules, world, dt = a.lanes, a.rules[0], t.world[0], a.rules[0].step_s
    car, drv, b, sc = cars_of(a.cars, e), drivers_of(t.drivers, e), a.ego.belief[e], a.ego.score[e]
    if actions is not None:
        decide(b, actions[e], lanes, t.speeds)
    for frame in range(frames):
        steering, acceleration, hold = command_ego(b, a.ego.command[e], car, drv, lanes, rules)
        slowest, fastest = world.speed_least_mps, world.speed_most_mps
        move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
        wander_all(car, drv, t.wander[min(sc.steps + 1, t.wander.shape[0] - 1)], dt)
        drive_profiles(car, drv, lanes, t.profile[e], sc.steps + 1, dt)
        collide_all(car, drv, dt)
        sc.steps += 1
        _conclude(e, frame + 1 == frames, a, motions, tracks)


@jit
def run_motorway(first, last, rows, frames, actions, batch, traffic, motions, tracks):  # type: ignore[no-untyped-def]
    """``frames`` steps among the drivers of a straight motorway; parameters as of :func:`run_course`."""
    a, t = unbundle(batch), unbundle(traffic)
    vehicles = a.cars.x.shape[1]
    newest, held = np.empty(a.lanes.table.shape[0] + 1, np.int64), np.empty((2, vehicles), np.int64)
    pairs = np.empty(vehicles * vehicles // 2 + 1, np.int64)
    scratch = newest, held, pairs, np.empty(vehicles), np.empty((5, vehicles))
    for n in range(first, last):
        _motorway(rows[n], frames, actions, a, t, motions, tracks, scratch)


@jit(borrows=True)
def _motorway(e, frames, actions, a, t, motions, tracks, scratch):  # type: ignore[no-untyped-def]
    """:func:`run_motorway` for one environment.

    ``scratch``: newest (L + 1,), held (2, V), pairs (P,), slip (V,), front (5, V).
    """
    newest, held, pairs, slip, front = scratch
    lanes, rules, world, dt = a.lanes, a.rules[0], t.world[0], a.rules[0].step_s
    car, drv, b, sc = cars_of(a.cars, e), drivers_of(t.drivers, e), a.ego.belief[e], a.ego.score[e]
    if actions is not None:
        decide(b, actions[e], lanes, t.speeds)
    for frame in range(frames):
        steering, acceleration, hold = command_ego(b, a.ego.command[e], car, drv, lanes, rules)
        survey(car, drv, lanes.table, newest, held)
        change_lanes(car, drv, lanes.table, rules.meta != 0)
        accelerate(car, drv, lanes.table, front)
        slowest, fastest = world.speed_least_mps, world.speed_most_mps
        move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
        wander_all(car, drv, t.wander[min(sc.steps + 1, t.wander.shape[0] - 1)], dt)
        drive_others(car, drv, lanes.table, dt, slip)
        sort_along(car, drv)
        collide_sorted(car, drv, dt, pairs)
        sc.steps += 1
        _conclude(e, frame + 1 == frames, a, motions, tracks)


@jit
def run_city(first, last, rows, frames, actions, batch, traffic, motions, tracks):  # type: ignore[no-untyped-def]
    """``frames`` steps among the drivers of a city; parameters as of :func:`run_course`."""
    a, t = unbundle(batch), unbundle(traffic)
    places = np.empty((a.cars.x.shape[1], a.lanes.table.shape[0]))
    for n in range(first, last):
        _city(rows[n], frames, actions, a, t, motions, tracks, places)


@jit(borrows=True)
def _city(e, frames, actions, a, t, motions, tracks, places):  # type: ignore[no-untyped-def]
    """:func:`run_city` for one environment; places (V, L) is scratch."""
    lanes, rules, world, dt = a.lanes, a.rules[0], t.world[0], a.rules[0].step_s
    car, drv, b, sc = cars_of(a.cars, e), drivers_of(t.drivers, e), a.ego.belief[e], a.ego.score[e]
    if actions is not None:
        decide(b, actions[e], lanes, t.speeds)
    for frame in range(frames):
        steering, acceleration, hold = command_ego(b, a.ego.command[e], car, drv, lanes, rules)
        place_all(car, lanes, places)
        decide_all(car, drv, lanes, places, rules.meta != 0)
        slowest, fastest = world.speed_least_mps, world.speed_most_mps
        move_ego(car, drv, steering, acceleration, hold, slowest, fastest, lanes, dt)
        wander_all(car, drv, t.wander[min(sc.steps + 1, t.wander.shape[0] - 1)], dt)
        drive_city(car, drv, lanes, dt)
        collide_all(car, drv, dt)
        sc.steps += 1
        _conclude(e, frame + 1 == frames, a, motions, tracks)
