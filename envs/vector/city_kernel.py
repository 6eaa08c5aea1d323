"""Traffic of city streets that join end to end: ``CityDriver``, which slows down for bends, on lanes of any shape.

Roads continue each other: the vehicle ahead or behind may be on the next or the previous road, and a vehicle at the end
of a road takes the lane of the same number on the next one. Each step finds the station of every vehicle on all lanes
that hold it. Vehicle 0 is the ego; the others react to its true pose.

Rounding can change two results against highway-env. An exact tie may have the other outcome: two lanes at the same
distance, or a lane change with exactly the least gain. And below ``L dt / (4 tau_heading tau_lateral)``, 0.52 m/s at
20 Hz, the steering of ControlledVehicle is unstable: slow vehicles oscillate by some centimetres, depending on the last
bits.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import NOWHERE_M, advised, following, local, reachable, stations
from lanebound.envs.vector.drivers_kernel import SPEED_MOST_MPS, roll, steer_along
from lanebound.envs.vector.idm_kernel import (
    ACC_MOST,
    BRAKING_IMPOSED,
    braking,
    free,
    gap_wanted,
    wanted_speed,
)
from lanebound.envs.worlds.idm_parameters_kernel import BESIDE_M, CALM, REACTION_S
from lanebound.integrity.core.accel import jit

__all__ = ["decide_all", "drive_city", "place_all"]

WALKING_MPS = 1.0  # slower vehicles do not change lanes


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


@jit(borrows=True)
def _place(table, places, lane, j):  # type: ignore[no-untyped-def]
    """Where a vehicle is along a lane, the one after it and the one before: on the first of them that holds it."""
    s, onward, before = places[j, lane], table[lane].onward, table[lane].before
    if s == NOWHERE_M and onward >= 0:
        s = places[j, onward] + table[lane].length_m
    if s == NOWHERE_M and before >= 0:
        s = places[j, before] - table[before].length_m
    return s


@jit(borrows=True)
def _neighbours(v, lanes, places, lane, i):  # type: ignore[no-untyped-def]
    """The vehicles next ahead of and behind vehicle i on a lane and those that it joins, -1 for none."""
    s, front, rear, front_m, rear_m = _along(v, lanes, places, lane, i), -1, -1, math.inf, NOWHERE_M
    for j in range(v.x.shape[0]):
        if j == i:
            continue
        place = _place(lanes.table, places, lane, j)
        if s <= place <= front_m:
            front, front_m = j, place
        elif rear_m < place < s:
            rear, rear_m = j, place
    return front, rear


@jit(borrows=True)
def _follow(v, lanes, places, i, front, delta):  # type: ignore[no-untyped-def]
    """IDM's acceleration of vehicle i behind another one, -1 for none."""
    a = free(v.speed[i], wanted_speed(v, i, lanes.table[v.lane[i]].speed_limit_mps), delta, CALM)
    if front >= 0:
        a -= braking(v, i, front, _gap(v, lanes, places, i, front), CALM)
    return a


@jit(borrows=True)
def _bend(v, lanes, places, i):  # type: ignore[no-untyped-def]
    """The acceleration that leads to the speed advised for where the driver will be after its reaction time."""
    speed = v.speed[i]
    s = _along(v, lanes, places, v.lane[i], i) + max(speed, 0.0) * REACTION_S
    return (advised(lanes, v.lane[i], s) - speed) / REACTION_S


@jit(inline=True)
def decide_all(v, lanes, places, ego_has_target):  # type: ignore[no-untyped-def]
    """The decisions of all drivers one after the other: later ones see the new targets of those before."""
    for i in range(1, v.x.shape[0]):
        if v.crashed[i] != 0:
            continue
        v.target[i] = following(lanes, v.target[i], v.x[i], v.y[i])
        if v.lane[i] != v.target[i]:
            _give_up(v, lanes, places, i, 0 if ego_has_target else 1)
        elif v.timer[i] > CALM.delay_s:
            v.timer[i] = 0.0
            _consider(v, lanes, places, i)
        _accelerate(v, lanes, places, i)


@jit(borrows=True)
def _give_up(v, lanes, places, i, first):  # type: ignore[no-untyped-def]
    """Return to the own lane when a vehicle close ahead is changing into the same one."""
    goal = v.target[i]
    if lanes.table[goal].road != lanes.table[v.lane[i]].road:
        return
    for j in range(first, v.x.shape[0]):
        if j != i and v.target[j] == goal and v.lane[j] != goal:
            if 0.0 < _gap(v, lanes, places, i, j) < gap_wanted(v, i, j, CALM):
                v.target[i] = v.lane[i]
                return


@jit(borrows=True)
def _consider(v, lanes, places, i):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken."""
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
        there, follower = _neighbours(v, lanes, places, lane, i)
        if follower >= 0 and _follow(v, lanes, places, follower, i, delta) < -BRAKING_IMPOSED:
            continue
        here, _ = _neighbours(v, lanes, places, own, i)
        bend = _bend(v, lanes, places, i)
        gain = min(_follow(v, lanes, places, i, there, delta), bend) - min(
            _follow(v, lanes, places, i, here, delta), bend
        )
        if not gain < CALM.gain:
            v.target[i] = lane


@jit(borrows=True)
def _accelerate(v, lanes, places, i):  # type: ignore[no-untyped-def]
    """A driver's acceleration, by the vehicle ahead in its lane and in the one that it changes to."""
    front, _ = _neighbours(v, lanes, places, v.lane[i], i)
    a = min(_follow(v, lanes, places, i, front, v.delta[i]), _bend(v, lanes, places, i))
    if v.lane[i] != v.target[i]:
        front, _ = _neighbours(v, lanes, places, v.target[i], i)
        a = min(a, _follow(v, lanes, places, i, front, v.delta[i]))
    v.acceleration[i] = min(max(a, -ACC_MOST), ACC_MOST)


@jit(inline=True)
def drive_city(v, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of all others; braking ends at standstill."""
    for i in range(1, v.x.shape[0]):
        steering, a = 0.0, 0.0
        if v.crashed[i] == 0:
            steering = steer_along(v, lanes, i)
            a = max(v.acceleration[i], -v.speed[i] / dt)
        v.timer[i] += dt
        roll(v, i, steering, a, -SPEED_MOST_MPS, SPEED_MOST_MPS, lanes, dt)
