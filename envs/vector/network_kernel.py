"""Traffic of any network of roads: IDM drivers with MOBIL lane changes, as highway-env has them, on lanes of any shape.

Roads join, fork and meet: the vehicle ahead or behind may be on a road that goes on from the own one or leads to it,
and a vehicle near the end of its lane takes the next one, by its route if it has one. Each step finds the station of
every vehicle on all lanes that hold it. Vehicle 0 is the ego; the others react to its true pose. Behind the vehicles
are the objects that stand on the road.

Rounding can change two results against highway-env. An exact tie may have the other outcome: two lanes at the same
distance, or a lane change with exactly the least gain. And below ``L dt / (4 tau_heading tau_lateral)``, 0.52 m/s at
20 Hz, the steering of ControlledVehicle is unstable: slow vehicles oscillate by some centimetres, depending on the last
bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from lanebound.envs.batch.lanes_kernel import NOWHERE_M, advised, local, reachable, stations
from lanebound.envs.batch.next_lane_kernel import following
from lanebound.envs.vector.crossing_kernel import Crossing, follows, stop_at_line
from lanebound.envs.vector.drivers_kernel import SPEED_MOST_MPS, move_line, roll, steer_along
from lanebound.envs.vector.idm_kernel import (
    ACC_MOST,
    BRAKING_IMPOSED,
    braking,
    free,
    gap_wanted,
    wanted_speed,
)
from lanebound.envs.worlds.idm_parameters_kernel import BESIDE_M, STAYS, WANDER_SHAPES
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["DRIVERS", "Roads", "decide_all", "drive_network", "place_all", "wander_each"]

WALKING_MPS = 1.0  # slower vehicles do not change lanes


class Roads(NamedTuple):
    """A network of roads beyond its lanes.

    routes (Q,) STEP: all that are planned; objects (N, O) CAR: what stands on the road in each environment, of one
    where it is the same in all before a start; crossing: with a right of way.
    """

    routes: Records
    objects: Records
    crossing: Crossing


DRIVERS = record(
    gap_m="wanted at standstill, middle to middle",
    headway_s="time gap",
    comfort="comfortable acceleration a [m/s2]",
    deceleration="comfortable deceleration b [m/s2]",
    twice_root="2 sqrt(a b) [m/s2]",
    delay_s="time between decisions on lane changes",
    gain="least advantage of a lane change [m/s2]",
    reaction_s="after which the speed advised for a bend is reached; 0 for drivers that do not slow down for bends",
    stops=("i8", "1 where braking ends at standstill; highway-env's own drivers reverse"),
    most_mps2="acceleration at most, inf for no bound but that of IDMVehicle",
    rules_every=("i8", "simulation steps between decisions on the right of way at a crossing, 0 without such a rule"),
    joined=("i8", "1 where vehicles on the roads before and after are neighbours, neighbour_vehicles_connected_lanes"),
)
"""Parameters of the other drivers: those of ``IdmParameters`` first."""


@jit(inline=True)
def place_all(v, lanes, places):  # type: ignore[no-untyped-def]
    """Fill ``places`` (V, L): how far along each lane every vehicle is, ``NOWHERE_M`` where it is not."""
    for i in range(v.x.shape[0]):
        stations(lanes, v.x[i], v.y[i], BESIDE_M, places[i])


@jit(borrows=True)
def _along(v, lanes, places, lane, i):  # type: ignore[no-untyped-def]
    """How far along a lane a vehicle is, where the lane does not hold it too."""
    s = places[i, lane]
    if s == NOWHERE_M:
        s, _, _ = local(lanes, lane, v.x[i], v.y[i])
    return s


@jit(borrows=True)
def _gap(v, lanes, places, i, j):  # type: ignore[no-untyped-def]
    """How far vehicle j is ahead of i, along the lane of i."""
    return _along(v, lanes, places, v.lane[i], j) - _along(v, lanes, places, v.lane[i], i)


@jit(inline=True)
def _joined(lanes, k, side):  # type: ignore[no-untyped-def]
    """The lane of a number on the road of joint k, its first lane where there is none."""
    road = lanes.joints[k].road
    return road + (side if side < lanes.table[road].count else 0)


@jit(borrows=True)
def _place(lanes, places, lane, j, joined):  # type: ignore[no-untyped-def]
    """Where a vehicle is along a lane, those after it and those before: on the first of them that holds it."""
    s, own = places[j, lane], lanes.table[lane]
    if s != NOWHERE_M or joined == 0:
        return s
    for k in range(own.joint_onward, own.joint_last):
        s = places[j, _joined(lanes, k, own.side)]
        if s != NOWHERE_M:
            return s + own.length_m
    for k in range(own.joint_first, own.joint_onward):
        before = _joined(lanes, k, own.side)
        s = places[j, before]
        if s != NOWHERE_M:
            return s - lanes.table[before].length_m
    return s


@jit(borrows=True)
def _neighbours(v, lanes, places, lane, i, joined):  # type: ignore[no-untyped-def]
    """The vehicles next ahead of and behind vehicle i on a lane and those that it joins, -1 for none."""
    s, front, rear, front_m, rear_m = _along(v, lanes, places, lane, i), -1, -1, math.inf, NOWHERE_M
    for j in range(v.x.shape[0]):
        if j == i:
            continue
        place = _place(lanes, places, lane, j, joined)
        if s <= place <= front_m:
            front, front_m = j, place
        elif rear_m < place < s:
            rear, rear_m = j, place
    return front, rear


@jit(borrows=True)
def _follow(v, lanes, places, i, front, delta, idm):  # type: ignore[no-untyped-def]
    """IDM's acceleration of vehicle i behind another one, -1 for none."""
    limit = lanes.table[v.lane[i]].speed_limit_mps
    wanted = wanted_speed(v, i, limit) if limit > 0.0 else v.target_speed[i]
    a = free(v.speed[i], wanted, delta, idm)
    if front >= 0:
        a -= braking(v, i, front, _gap(v, lanes, places, i, front), idm)
    return a


@jit(borrows=True)
def _bend(v, lanes, places, i, idm):  # type: ignore[no-untyped-def]
    """The acceleration that leads to the speed advised for where the driver will be after its reaction time."""
    own = lanes.table[v.lane[i]]
    if idm.reaction_s == 0.0 or own.advice_first == own.advice_last:
        return math.inf
    speed = v.speed[i]
    s = _along(v, lanes, places, v.lane[i], i) + max(speed, 0.0) * idm.reaction_s
    return (advised(lanes, v.lane[i], s) - speed) / idm.reaction_s


@jit(borrows=True)
def decide_all(v, count, drivers, lanes, roads, places, idm, ego_has_target):  # type: ignore[no-untyped-def]
    """The decisions of all drivers one after the other: later ones see the new targets of those before.

    count: of the vehicles; the objects of the road come after them. roads: see :class:`Roads`.
    """
    routes = roads.routes
    for i in range(1, count):
        if v.crashed[i] != 0:
            continue
        v.target[i], at = following(lanes, routes, drivers[i].route, v.target[i], v.x[i], v.y[i])
        drivers[i].route = at
        if v.timer[i] == STAYS:
            pass
        elif v.lane[i] != v.target[i]:
            _give_up(v, count, lanes, places, i, idm, 0 if ego_has_target else 1)
        elif v.timer[i] > idm.delay_s:
            v.timer[i] = 0.0
            _consider(v, count, lanes, places, i, routes[at], idm)
        _accelerate(v, drivers, lanes, roads.crossing, places, i, idm)


@jit(borrows=True)
def _give_up(v, count, lanes, places, i, idm, first):  # type: ignore[no-untyped-def]
    """Return to the own lane when a vehicle close ahead is changing into the same one."""
    goal = v.target[i]
    if lanes.table[goal].road != lanes.table[v.lane[i]].road:
        return
    for j in range(first, count):
        if j != i and v.target[j] == goal and v.lane[j] != goal:
            if 0.0 < _gap(v, lanes, places, i, j) < gap_wanted(v, i, j, idm):
                v.target[i] = v.lane[i]
                return


@jit(borrows=True)
def _consider(v, count, lanes, places, i, step, idm):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken.

    step: the next one of the route. Where it names a lane, that lane alone is worth a change.
    """
    if abs(v.speed[i]) < WALKING_MPS:
        return
    own, table, delta = v.lane[i], lanes.table, v.delta[i]
    for turn in (-1, 1):
        lane = own + turn
        if not 0 <= table[own].side + turn < table[own].count:
            continue
        s, r, _ = local(lanes, lane, v.x[i], v.y[i])
        if not reachable(lanes, lane, s, r):
            continue
        there, follower = _neighbours(v, lanes, places, lane, i, idm.joined)
        if 0 <= follower < count and _follow(v, lanes, places, follower, i, delta, idm) < -BRAKING_IMPOSED:
            continue
        bend = _bend(v, lanes, places, i, idm)
        changed = min(_follow(v, lanes, places, i, there, delta, idm), bend)
        if step.road >= 0 and step.side >= 0:
            side = table[v.target[i]].side
            if _sign(table[lane].side - side) != _sign(step.side - side) or changed < -BRAKING_IMPOSED:
                continue
            v.target[i] = lane
            continue
        here, _ = _neighbours(v, lanes, places, own, i, idm.joined)
        gain = changed - min(_follow(v, lanes, places, i, here, delta, idm), bend)
        if not gain < idm.gain:
            v.target[i] = lane


@jit(inline=True)
def _sign(number):  # type: ignore[no-untyped-def]
    """-1, 0 or 1."""
    return (1 if number > 0 else 0) - (1 if number < 0 else 0)


@jit(borrows=True)
def _accelerate(v, drivers, lanes, crossing, places, i, idm):  # type: ignore[no-untyped-def]
    """A driver's acceleration, by the vehicle ahead in its lane and in the one that it changes to."""
    a = _behind(v, drivers, lanes, crossing, places, v.lane[i], i, idm)
    a = min(a, _bend(v, lanes, places, i, idm), idm.most_mps2)
    if crossing.parts.shape[0] > 0:
        a = min(a, stop_at_line(v, drivers, lanes, crossing, i))
    if v.lane[i] != v.target[i]:
        a = min(a, _behind(v, drivers, lanes, crossing, places, v.target[i], i, idm))
    v.acceleration[i] = min(max(a, -ACC_MOST), ACC_MOST)


@jit(inline=True)
def _behind(v, drivers, lanes, crossing, places, lane, i, idm):  # type: ignore[no-untyped-def]
    """IDM's acceleration of driver i behind the vehicle ahead of it on a lane."""
    front, _ = _neighbours(v, lanes, places, lane, i, idm.joined)
    if front >= 0 and crossing.parts.shape[0] > 0 and not follows(v, drivers, lanes, crossing, i, front):
        front = -1
    return _follow(v, lanes, places, i, front, v.delta[i], idm)


@jit(borrows=True)
def wander_each(v, count, drivers, shapes, step, dt):  # type: ignore[no-untyped-def]
    """:func:`.drivers_kernel.wander_all` at simulation step number ``step``, by the time since each vehicle entered."""
    for i in range(1, count):
        shape, line = shapes[min(step - drivers[i].entered, shapes.shape[0] - 1)], 0.0
        for k in range(WANDER_SHAPES):
            line += shape[k] * v.wander[k, i]
        move_line(v, i, line, dt)


@jit(inline=True)
def drive_network(v, count, lanes, idm, dt):  # type: ignore[no-untyped-def]
    """One step of all others."""
    for i in range(1, count):
        steering, a = 0.0, 0.0
        if v.crashed[i] == 0:
            steering, a = steer_along(v, lanes, i), v.acceleration[i]
            if idm.stops != 0:
                a = max(a, -v.speed[i] / dt)
        v.timer[i] += dt
        roll(v, i, steering, a, -SPEED_MOST_MPS, SPEED_MOST_MPS, lanes, dt)
