"""Simulation steps of compiled traffic: all vehicles decide by the poses of all, then move; then crashes are found.

One entry kernel for each kind of traffic, so that only those that a configuration needs are compiled. After each step
the beliefs of the egos are carried on; :class:`..batch.episodes.Episodes` completes an epoch.

``kernel(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, rules, traffic)``: ``frames`` steps, with
which the policy step ``ends`` or not; codes (N,) of meta-actions to be taken up before, (0,) for none; drivers (N, V)
DRIVER; traffic: TrafficFigures; the others as in :mod:`..batch.rows_kernel`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.ego_kernel import decide, follow_road
from lanebound.envs.batch.lane_sensor_kernel import body_of
from lanebound.envs.batch.lanes_kernel import Lanes
from lanebound.envs.batch.next_lane_kernel import keep_to_route
from lanebound.envs.batch.records_kernel import GIVEN
from lanebound.envs.batch.rows_kernel import carry_on
from lanebound.envs.vector.collisions_kernel import collide_all, collide_ego, collide_sorted
from lanebound.envs.vector.course_kernel import drive_profiles, lead
from lanebound.envs.vector.crossing_kernel import give_way
from lanebound.envs.vector.drivers_kernel import (
    NUMBERS,
    WHOLES,
    command_ego,
    fill_onward,
    load,
    move_ego,
    place_objects,
    seat,
    show,
    store,
    take_effect,
    vehicles_in,
    wander_all,
)
from lanebound.envs.vector.motorway_kernel import accelerate, change_lanes, drive_others, sort_along, survey
from lanebound.envs.vector.network_kernel import Roads, decide_all, drive_network, place_all, wander_each
from lanebound.envs.vector.world_kernel import judge
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["TrafficFigures", "run_course", "run_motorway", "run_network", "run_unattended"]


class TrafficFigures(NamedTuple):
    """The parameters of the motion of vehicles.

    world (1,) WORLD; speeds: target speeds of meta-actions; profile (N, K, S): prescribed speeds of other vehicles
    [m/s], by simulation step; wander (S, K) [m]: shapes over time of the others' lines in their lanes, by simulation
    step; idm (1,) DRIVERS: of the others on a network of roads; lanes of the roads, and what they have beyond them;
    before: simulation steps of the traffic before an episode.
    """

    world: Records
    speeds: NDArray[np.float64]
    profile: NDArray[np.float64]
    wander: NDArray[np.float64]
    idm: Records
    lanes: Lanes
    roads: Roads
    before: int


@jit
def run_course(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, rules, traffic):  # type: ignore[no-untyped-def]
    """Vehicles that drive profiles of speeds, or the ego alone."""
    scratch = np.empty((NUMBERS, cars.shape[1])), np.empty((WHOLES, cars.shape[1]), np.int64)
    for n in range(first, last):
        _course(rows[n], frames, ends, codes, cars, drivers, egos, motions, rules[0], traffic, scratch)


@jit(inline=True)
def _begin(e, codes, cars, drivers, ego, lanes, rules, traffic, numbers, wholes):  # type: ignore[no-untyped-def]
    """The vehicles of environment e as they begin to drive, with its meta-action taken up."""
    if codes.size > 0:
        follow_road(ego, lanes, traffic.roads.routes, rules)
        decide(body_of(ego, rules), codes[e], lanes, traffic.speeds)
    v = vehicles_in(numbers, wholes, cars.shape[0] + traffic.roads.objects.shape[1])
    load(cars, drivers, v)
    place_objects(v, cars.shape[0], traffic.roads.objects[e])
    return v


@jit(inline=True)
def _end(v, cars, drivers, ego, lanes, rules, world, ends):  # type: ignore[no-untyped-def]
    """Store the vehicles after the last step, and judge the policy step if it ends."""
    store(v, cars, drivers)
    if ends:
        judge(cars, drivers, ego, lanes, rules, world, False)


@jit(inline=True)
def _conclude(v, cars, ego, motions, lanes, rules, traffic, ends_epoch):  # type: ignore[no-untyped-def]
    """Carry the belief of the ego on after a step; only those that navigate are seen before the end."""
    show(v, cars[: max(motions.shape[0], 1)])
    carry_on(ego, cars, motions, lanes, rules, ends_epoch)
    if rules.source == GIVEN or not ends_epoch:  # a sensed position waits for its solution
        keep_to_route(ego, lanes, traffic.roads.routes, rules)


@jit(borrows=True)
def _course(e, frames, ends, codes, cars, drivers, egos, motions, rules, traffic, scratch):  # type: ignore[no-untyped-def]
    """:func:`run_course` for environment e; ``scratch``: for :func:`vehicles_in`."""
    ego, world, lanes, dt = egos[e], traffic.world[0], traffic.lanes, rules.step_s
    here = cars[e, : ego.vehicles]
    v = _begin(e, codes, here, drivers[e], ego, lanes, rules, traffic, scratch[0], scratch[1])
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, traffic.roads.routes, rules)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps += 1
        wander_all(v, traffic.wander[min(ego.score.steps, traffic.wander.shape[0] - 1)], dt)
        drive_profiles(v, lanes, traffic.profile[e], ego.score.steps, dt)
        collide_all(v, here.shape[0], 0, dt)
        _conclude(v, here, ego, motions[e], lanes, rules, traffic, frame + 1 == frames)
    _end(v, here, drivers[e], ego, lanes, rules, world, ends)


@jit
def run_motorway(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, rules, traffic):  # type: ignore[no-untyped-def]
    """The drivers of a straight motorway."""
    vehicles, lanes = cars.shape[1], traffic.lanes
    numbers, wholes = np.empty((NUMBERS, vehicles)), np.empty((WHOLES, vehicles), np.int64)
    newest, held = np.empty(lanes.table.shape[0] + 1, np.int64), np.empty((2, vehicles), np.int64)
    pairs = np.empty(vehicles * vehicles // 2 + 1, np.int64)
    scratch = newest, held, pairs, np.empty(vehicles), np.empty((5, vehicles))
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        v = _begin(e, codes, here, drivers[e], egos[e], lanes, rules[0], traffic, numbers, wholes)
        _motorway(frames, v, here, drivers[e], egos[e], motions[e], lanes, rules[0], traffic, scratch)
        _end(v, here, drivers[e], egos[e], lanes, rules[0], traffic.world[0], ends)


@jit(borrows=True)
def _motorway(frames, v, cars, drivers, ego, motions, lanes, rules, traffic, scratch):  # type: ignore[no-untyped-def]
    """:func:`run_motorway` for one environment.

    ``scratch``: newest (L + 1,), held (2, V), pairs (P,), slip (V,), front (5, V).
    """
    newest, held, pairs, slip, front = scratch
    world, dt = traffic.world[0], rules.step_s
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, traffic.roads.routes, rules)
        survey(v, lanes.table, newest, held)
        change_lanes(v, lanes.table, rules.meta != 0)
        accelerate(v, lanes.table, front)
        take_effect(v, cars.shape[0], drivers, dt)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps += 1
        wander_all(v, traffic.wander[min(ego.score.steps, traffic.wander.shape[0] - 1)], dt)
        drive_others(v, lanes.table, dt, slip)
        sort_along(v)
        if world.only_ego_crashes != 0:
            collide_ego(v, dt)
        else:
            collide_sorted(v, dt, pairs)
        _conclude(v, cars, ego, motions, lanes, rules, traffic, frame + 1 == frames)


@jit
def run_network(first, last, rows, frames, ends, codes, cars, drivers, egos, motions, rules, traffic):  # type: ignore[no-untyped-def]
    """The drivers of a network of roads."""
    places, lanes = cars.shape[1] + traffic.roads.objects.shape[1], traffic.lanes
    numbers, wholes = np.empty((NUMBERS, places)), np.empty((WHOLES, places), np.int64)
    stations, order = np.empty((places, lanes.table.shape[0])), np.empty(places, np.int64)
    for e in rows[first:last]:
        here = cars[e, : egos[e].vehicles]
        v = _begin(e, codes, here, drivers[e], egos[e], lanes, rules[0], traffic, numbers, wholes)
        _network(e, frames, v, here, drivers[e], egos[e], motions[e], lanes, rules[0], traffic, stations, order)
        _end(v, here, drivers[e], egos[e], lanes, rules[0], traffic.world[0], ends)
        fill_onward(here, drivers[e], egos[e], lanes, traffic.roads.routes)


@jit(borrows=True)
def _network(e, frames, v, cars, drivers, ego, motions, lanes, rules, traffic, stations, order):  # type: ignore[no-untyped-def]
    """:func:`run_network` for environment e; stations (V, L) and order (V,) are scratch."""
    world, roads, dt, count = traffic.world[0], traffic.roads, rules.step_s, cars.shape[0]
    for frame in range(frames):
        steering, acceleration, hold = command_ego(ego, v, lanes, roads.routes, rules)
        step = ego.score.steps + 1
        ago = traffic.before + step
        decide_network(v, count, drivers, lanes, traffic.idm[0], roads, rules.meta != 0, ago, stations, order)
        take_effect(v, count, drivers, dt)
        lead(v, count, traffic.profile[e], step, dt)
        move_ego(v, steering, acceleration, hold, world, lanes, dt)
        ego.score.steps = step
        wander_each(v, count, drivers, traffic.wander, step, dt)
        drive_network(v, count, lanes, traffic.idm[0], dt)
        collide_all(v, count, ego.place, dt)
        _conclude(v, cars, ego, motions, lanes, rules, traffic, frame + 1 == frames)


@jit(borrows=True)
def decide_network(v, count, drivers, lanes, idm, roads, ego_has_target, step, stations, order):  # type: ignore[no-untyped-def]
    """What all others of a network decide in simulation step number ``step`` of the traffic."""
    place_all(v, lanes, stations)
    decide_all(v, count, drivers, lanes, roads, stations, idm, ego_has_target)
    if idm.rules_every > 0 and step % idm.rules_every == 0:
        give_way(v, count, drivers, lanes, roads.crossing, roads.routes, order)


@jit
def run_unattended(cars, drivers, steps, lanes, idm, roads, dt):  # type: ignore[no-untyped-def]
    """Let the traffic of a network drive on before an episode, where car 0 is far away and not moved.

    cars (v,), drivers (V,): of one environment.
    """
    places = cars.shape[0] + roads.objects.shape[1]
    v = vehicles_in(np.zeros((NUMBERS, places)), np.zeros((WHOLES, places), np.int64), places)
    stations, order = np.empty((places, lanes.table.shape[0])), np.empty(places, np.int64)
    seat(cars, drivers, cars.shape[0])
    load(cars, drivers, v)
    place_objects(v, cars.shape[0], roads.objects[0])
    for step in range(1, steps + 1):
        decide_network(v, cars.shape[0], drivers, lanes, idm[0], roads, False, step, stations, order)
        drive_network(v, cars.shape[0], lanes, idm[0], dt)
        collide_all(v, cars.shape[0], 0, dt)
    store(v, cars, drivers)
