"""Traffic of city streets that join end to end: ``CityDriver``, who slows down for bends, on lanes of any shape.

A road ends where another goes on, so that whoever is ahead or behind may be on the next one or the one before, and a
driver that comes to an end takes the lane of the same number there. Everybody is placed once a step on all lanes that
hold it. Vehicle 0 is the ego, whom others see as it truly is.

Two things are highway-env's but for rounding, and rounding is all that they need to differ. Of exact ties one may be
broken the other way: between two lanes as near, or where a change is worth exactly what is asked for. And the steering
of ControlledVehicle swings out below ``L dt / (4 tau_heading tau_lateral)``, at 20 Hz 0.52 m/s: drivers that crawl sway
by up to some centimetres, and how is a matter of the last bits.
"""

from __future__ import annotations

import math

from lanebound.envs.vector.columns_kernel import (
    ACCELERATION,
    CRASHED,
    DELTA,
    HEADING,
    LANE,
    SPEED,
    TARGET,
    TIMER,
    X,
    Y,
    population,
)
from lanebound.envs.vector.ego_kernel import roll, steering_to
from lanebound.envs.vector.idm_kernel import (
    ACC_MAX,
    BRAKING_IMPOSED,
    SPEED_MOST_MPS,
    Manners,
    braking,
    free,
    gap_wanted,
    wanted_speed,
)
from lanebound.envs.vector.lanes_kernel import (
    BEFORE,
    COUNT,
    LENGTH,
    LIMIT,
    NOWHERE,
    ONWARD,
    ROAD,
    SIDE,
    advised,
    following,
    local,
    reachable,
    stations,
)
from lanebound.integrity.core.accel import jit

__all__ = ["CALM", "decide_all", "drive_city", "place_everybody"]

CALM = Manners(8.0, 1.0, 1.5, 2.0 * math.sqrt(3.0), 2.0, 0.4)  # of worlds/drivers.py: CityDriver
REACTION_S = 0.8
BESIDE_M = 1.0  # of a lane, to be on it for those who look for neighbours
WALKING_MPS = 1.0  # slower vehicles do not change lanes


@jit
def place_everybody(c, w, lanes, places):  # type: ignore[no-untyped-def]
    """Fill ``places`` (V, L): how far along each lane every vehicle is, ``NOWHERE`` where it is not."""
    for i in range(population(w)):
        stations(lanes, c[X, i], c[Y, i], BESIDE_M, places[i])


@jit
def _along(c, lanes, places, lane, i):  # type: ignore[no-untyped-def]
    """How far along a lane a vehicle is, where the lane does not hold it too."""
    s = places[i, lane]
    if s == NOWHERE:
        s, _, _ = local(lanes, lane, c[X, i], c[Y, i])
    return s


@jit
def _gap(c, w, lanes, places, i, j):  # type: ignore[no-untyped-def]
    """How far vehicle j is ahead of i, along the lane of i."""
    return _along(c, lanes, places, w[LANE, i], j) - _along(c, lanes, places, w[LANE, i], i)


@jit
def _place(table, places, lane, j):  # type: ignore[no-untyped-def]
    """Where a vehicle is along a lane, the one after it and the one before: on the first of them that holds it."""
    s, onward, before = places[j, lane], int(table[lane, ONWARD]), int(table[lane, BEFORE])
    if s == NOWHERE and onward >= 0:
        s = places[j, onward] + table[lane, LENGTH]
    if s == NOWHERE and before >= 0:
        s = places[j, before] - table[before, LENGTH]
    return s


@jit
def _neighbours(c, w, lanes, places, lane, i):  # type: ignore[no-untyped-def]
    """Who is next ahead of vehicle i and behind it on a lane and those that it joins, -1 for nobody."""
    s, front, rear, front_m, rear_m = _along(c, lanes, places, lane, i), -1, -1, math.inf, NOWHERE
    for j in range(population(w)):
        if j == i:
            continue
        place = _place(lanes.table, places, lane, j)
        if s <= place <= front_m:
            front, front_m = j, place
        elif rear_m < place < s:
            rear, rear_m = j, place
    return front, rear


@jit
def _follow(c, w, lanes, places, i, front, delta):  # type: ignore[no-untyped-def]
    """IDM's acceleration of vehicle i behind another one, -1 for nobody."""
    a = free(c[SPEED, i], wanted_speed(c, i, lanes.table[w[LANE, i], LIMIT]), delta, CALM)
    if front >= 0:
        a -= braking(c, i, front, _gap(c, w, lanes, places, i, front), CALM)
    return a


@jit
def _bend(c, w, lanes, places, i):  # type: ignore[no-untyped-def]
    """The acceleration that leads to the speed advised for where the driver will be after its reaction time."""
    speed = c[SPEED, i]
    s = _along(c, lanes, places, w[LANE, i], i) + max(speed, 0.0) * REACTION_S
    return (advised(lanes, w[LANE, i], s) - speed) / REACTION_S


@jit
def decide_all(c, w, lanes, places, ego_has_target):  # type: ignore[no-untyped-def]
    """Every driver's decisions, one after the other: later ones see the new targets of those before."""
    for i in range(1, population(w)):
        if w[CRASHED, i] != 0:
            continue
        w[TARGET, i] = following(lanes, w[TARGET, i], c[X, i], c[Y, i])
        if w[LANE, i] != w[TARGET, i]:
            _give_up(c, w, lanes, places, i, 0 if ego_has_target else 1)
        elif c[TIMER, i] > CALM.delay_s:
            c[TIMER, i] = 0.0
            _consider(c, w, lanes, places, i)
        _accelerate(c, w, lanes, places, i)


@jit
def _give_up(c, w, lanes, places, i, first):  # type: ignore[no-untyped-def]
    """Go back to the own lane when somebody close ahead is changing into the same one."""
    goal = w[TARGET, i]
    if lanes.table[goal, ROAD] != lanes.table[w[LANE, i], ROAD]:
        return
    for j in range(first, population(w)):
        if j != i and w[TARGET, j] == goal and w[LANE, j] != goal:
            if 0.0 < _gap(c, w, lanes, places, i, j) < gap_wanted(c, i, j, CALM):
                w[TARGET, i] = w[LANE, i]
                return


@jit
def _consider(c, w, lanes, places, i):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken."""
    if abs(c[SPEED, i]) < WALKING_MPS:
        return
    own, table, delta = w[LANE, i], lanes.table, c[DELTA, i]
    for turn in (-1, 1):
        lane = own + turn
        if not 0 <= table[own, SIDE] + turn < table[own, COUNT]:
            continue
        s, r, _ = local(lanes, lane, c[X, i], c[Y, i])
        if not reachable(table, lane, s, r):
            continue
        there, follower = _neighbours(c, w, lanes, places, lane, i)
        if follower >= 0 and _follow(c, w, lanes, places, follower, i, delta) < -BRAKING_IMPOSED:
            continue
        here, _ = _neighbours(c, w, lanes, places, own, i)
        bend = _bend(c, w, lanes, places, i)
        gain = min(_follow(c, w, lanes, places, i, there, delta), bend) - min(
            _follow(c, w, lanes, places, i, here, delta), bend
        )
        if not gain < CALM.gain:
            w[TARGET, i] = lane


@jit
def _accelerate(c, w, lanes, places, i):  # type: ignore[no-untyped-def]
    """A driver's acceleration, by whoever is ahead in its lane and in the one that it changes to."""
    front, _ = _neighbours(c, w, lanes, places, w[LANE, i], i)
    a = min(_follow(c, w, lanes, places, i, front, c[DELTA, i]), _bend(c, w, lanes, places, i))
    if w[LANE, i] != w[TARGET, i]:
        front, _ = _neighbours(c, w, lanes, places, w[TARGET, i], i)
        a = min(a, _follow(c, w, lanes, places, i, front, c[DELTA, i]))
    c[ACCELERATION, i] = min(max(a, -ACC_MAX), ACC_MAX)


@jit
def drive_city(c, w, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of all others; braking ends at standstill."""
    for i in range(1, population(w)):
        steering, a = 0.0, 0.0
        if w[CRASHED, i] == 0:
            steering = steering_to(lanes, w[TARGET, i], c[X, i], c[Y, i], c[HEADING, i], c[SPEED, i])
            a = max(c[ACCELERATION, i], -c[SPEED, i] / dt)
        c[TIMER, i] += dt
        roll(c, w, i, steering, a, -SPEED_MOST_MPS, SPEED_MOST_MPS, lanes, dt)
