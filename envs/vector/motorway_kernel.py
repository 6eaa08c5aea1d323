"""Traffic of a straight motorway along x: highway-env's IDM drivers with MOBIL lane changes, sorted once a step.

An environment's vehicles are kept in order along x, so that neighbours are found by a short walk. Headings and slip
enter by their sines and cosines: steering asks for ``sin(beta)``, and by ``tan(beta) = tan(steering) / 2`` arctangent
and tangent cancel. Vehicle 0 is the ego, whom others see as it truly is.

Below ``L dt / (4 tau_heading tau_lateral)``, at 20 Hz 0.52 m/s, the steering of ControlledVehicle multiplies whatever
rounding there is. Angles are wrapped with highway-env's rounding, so that drivers who are in the middle of their lane
stay there; an ego that crawls while it changes lanes by meta-actions sways by up to some millimetres, and how is a
matter of the last bits.
"""

from __future__ import annotations

import math

from lanebound.envs.vector.arithmetic_kernel import FLAT_MOST_RAD, arcsine, cosine, sine
from lanebound.envs.vector.collisions_kernel import LENGTH_M
from lanebound.envs.vector.columns_kernel import (
    ACCELERATION,
    COS,
    CRASHED,
    DELTA,
    FRONT,
    HEADING,
    IMPACT_X,
    IMPACT_Y,
    LANE,
    ORDER,
    RANK,
    SIN,
    SPEED,
    STRUCK,
    TARGET,
    TIMER,
    X,
    Y,
)
from lanebound.envs.vector.idm_kernel import (
    ACC_MAX,
    BRAKING_IMPOSED,
    SPEED_MOST_MPS,
    Manners,
    braking,
    free,
    gap_wanted,
    not_zero,
    wanted_speed,
)
from lanebound.envs.vector.lanes_kernel import LENGTH, LIMIT, OFFSET, WIDTH, wrap
from lanebound.integrity.core.accel import jit

__all__ = ["BRISK", "SIN_SLIP_MOST", "accelerate", "change_lanes", "drive_others", "sort_along", "survey"]

BRISK = Manners(10.0, 1.5, 3.0, 2.0 * math.sqrt(15.0), 1.0, 0.2)  # of highway-env's IDMVehicle
KP_HEADING, KP_LATERAL = 1.0 / 0.2, 1.0 / 0.6  # of ControlledVehicle
MARGIN_M, BEYOND_M = 1.0, 5.0  # beside and past the ends of a lane, to be on it
SIN_COURSE_MOST = math.sin(0.25 * math.pi)
TAN_SLIP_MOST = 0.5 * math.tan(math.pi / 3.0)
SIN_SLIP_MOST = math.sin(math.atan(TAN_SLIP_MOST))


@jit
def _braking(c, i, j):  # type: ignore[no-untyped-def]
    """What vehicle j ahead takes off IDM's acceleration of vehicle i."""
    return braking(c, i, j, c[X, j] - c[X, i], BRISK)


@jit
def _stands_on(c, k, table, lane):  # type: ignore[no-untyped-def]
    beside = abs(c[Y, k] - table[lane, OFFSET]) <= 0.5 * table[lane, WIDTH] + MARGIN_M
    return beside & (-BEYOND_M <= c[X, k]) & (c[X, k] < table[lane, LENGTH] + BEYOND_M)


@jit
def _ahead(c, w, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle ahead of i on a lane, -1 for none."""
    for at in range(w[RANK, i] + 1, c.shape[1]):
        k = w[ORDER, at]
        if _stands_on(c, k, table, lane):
            return k
    return -1


@jit
def _behind(c, w, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle behind i on a lane, -1 for none."""
    for at in range(w[RANK, i] - 1, -1, -1):
        k = w[ORDER, at]
        if _stands_on(c, k, table, lane):
            return k
    return -1


@jit
def sort_along(c, w):  # type: ignore[no-untyped-def]
    """Bring ``ORDER`` up to date: nearly sorted, so by insertion."""
    for a in range(1, c.shape[1]):
        k = w[ORDER, a]
        x = c[X, k]
        if c[X, w[ORDER, a - 1]] <= x:
            continue
        at = a - 1
        while at >= 0 and c[X, w[ORDER, at]] > x:
            w[ORDER, at + 1] = w[ORDER, at]
            at -= 1
        w[ORDER, at + 1] = k


@jit
def survey(c, w, table, newest, held):  # type: ignore[no-untyped-def]
    """Ranks along the road, and the vehicle in front of each in its lane.

    One sweep against the traffic: the last vehicle met on a lane is in front of all that follow. ``newest`` (L + 1,)
    and ``held`` (2, V) are scratch.
    """
    _occupy(c, w, table, held)
    newest[:] = -1
    for at in range(c.shape[1] - 1, -1, -1):
        k = w[ORDER, at]
        w[RANK, k], w[FRONT, k] = at, newest[w[LANE, k]]
        newest[held[0, k]] = newest[held[1, k]] = k


@jit
def _occupy(c, w, table, held):  # type: ignore[no-untyped-def]
    """The lanes that every vehicle stands on, ``held`` (2, V): its own, and the one on its side of it; L for none."""
    lowest, width, end, none = table[0, OFFSET], table[0, WIDTH], table[0, LENGTH] + BEYOND_M, table.shape[0]
    reach = 0.5 * width + MARGIN_M
    for i in range(c.shape[1]):
        lane, along = w[LANE, i], (-BEYOND_M <= c[X, i]) & (c[X, i] < end)
        aside = c[Y, i] - (lowest + lane * width)
        beside = lane + (1 if aside > 0.0 else -1)
        there = along & (abs(c[Y, i] - (lowest + beside * width)) <= reach) & (beside >= 0) & (beside < none)
        held[0, i] = lane if along & (abs(aside) <= reach) else none
        held[1, i] = beside if there else none


@jit
def change_lanes(c, w, table, ego_has_target):  # type: ignore[no-untyped-def]
    """Every driver's decision, one after the other: later ones see the new targets of those before."""
    for i in range(1, c.shape[1]):
        changing = w[LANE, i] != w[TARGET, i]
        if not (changing | (c[TIMER, i] > BRISK.delay_s)) or w[CRASHED, i] != 0:
            continue
        if changing:
            _give_up(c, w, i, 0 if ego_has_target else 1)
        else:
            c[TIMER, i] = 0.0
            _consider(c, w, i, table)


@jit
def _give_up(c, w, i, first):  # type: ignore[no-untyped-def]
    """Go back to the own lane when somebody close ahead is changing into the same one."""
    goal = w[TARGET, i]
    for k in range(first, c.shape[1]):
        if w[TARGET, k] == goal and w[LANE, k] != goal and k != i:
            distance = c[X, k] - c[X, i]
            if 0.0 < distance < gap_wanted(c, i, k, BRISK):
                w[TARGET, i] = w[LANE, i]
                return


@jit
def _consider(c, w, i, table):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken."""
    if abs(c[SPEED, i]) < 1.0:
        return
    own, delta, here = w[LANE, i], c[DELTA, i], w[FRONT, i]
    alone = free(c[SPEED, i], wanted_speed(c, i, table[own, LIMIT]), delta, BRISK)
    now = alone - (_braking(c, i, here) if here >= 0 else 0.0)
    for side in (-1, 1):
        lane = own + side
        if not 0 <= lane < table.shape[0]:
            continue
        aside = abs(c[Y, i] - table[lane, OFFSET])
        if not (aside <= 2.0 * table[lane, WIDTH] and 0.0 <= c[X, i] < table[lane, LENGTH] + BEYOND_M):
            continue
        follower = _behind(c, w, i, table, lane)
        if follower >= 0:
            limit = table[w[LANE, follower], LIMIT]
            theirs = free(c[SPEED, follower], wanted_speed(c, follower, limit), delta, BRISK)
            if theirs - _braking(c, follower, i) < -BRAKING_IMPOSED:
                continue
        there = _ahead(c, w, i, table, lane)
        gain = alone - (_braking(c, i, there) if there >= 0 else 0.0) - now
        if not gain < BRISK.gain:
            w[TARGET, i] = lane


@jit
def accelerate(c, w, table):  # type: ignore[no-untyped-def]
    """IDM's acceleration of every driver, from the places at the beginning of the step; wrecks do not care."""
    for i in range(1, c.shape[1]):
        c[ACCELERATION, i] = wanted_speed(c, i, table[w[LANE, i], LIMIT])
    for i in range(1, c.shape[1]):
        c[ACCELERATION, i] = free(c[SPEED, i], c[ACCELERATION, i], c[DELTA, i], BRISK)
    for i in range(1, c.shape[1]):
        front = w[FRONT, i]
        less = _braking(c, i, front) if front >= 0 else 0.0
        if w[LANE, i] != w[TARGET, i]:
            front = _ahead(c, w, i, table, w[TARGET, i])
            if front >= 0:
                less = max(less, _braking(c, i, front))
        c[ACCELERATION, i] = min(max(c[ACCELERATION, i] - less, -ACC_MAX), ACC_MAX)


@jit
def drive_others(c, w, table, dt, slip):  # type: ignore[no-untyped-def]
    """One step of all others: the modified bicycle model of highway-env, wrecks braking to rest.

    A loop for each quantity, so that the compiler takes several vehicles at once; ``slip`` (V,) is scratch.
    """
    _steer(c, w, table, slip)
    _move(c, slip, dt)
    _turn(c, slip, dt)
    _speed_up(c, w, dt)
    _find_lanes(c, w, table)


@jit
def _steer(c, w, table, slip):  # type: ignore[no-untyped-def]
    """Sine of the slip angle by which every driver heads for the middle of its lane; wrecks roll straight on."""
    for i in range(1, c.shape[1]):
        slip[i] = table[w[TARGET, i], OFFSET]
    for i in range(1, c.shape[1]):
        inverse = 1.0 / not_zero(c[SPEED, i])
        course = -KP_LATERAL * (c[Y, i] - slip[i]) * inverse
        turn = arcsine(min(max(course, -SIN_COURSE_MOST), SIN_COURSE_MOST)) - c[HEADING, i]
        turn = wrap(turn)
        rate = 0.5 * LENGTH_M * inverse * KP_HEADING * turn
        slip[i] = 0.0 if w[CRASHED, i] != 0 else min(max(rate, -SIN_SLIP_MOST), SIN_SLIP_MOST)


@jit
def _move(c, slip, dt):  # type: ignore[no-untyped-def]
    """Everybody to where it is at the end of the step."""
    for i in range(1, c.shape[1]):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        c[X, i] += c[SPEED, i] * (c[COS, i] * cosine_of_slip - c[SIN, i] * slip[i]) * dt
    for i in range(1, c.shape[1]):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        c[Y, i] += c[SPEED, i] * (c[SIN, i] * cosine_of_slip + c[COS, i] * slip[i]) * dt


@jit
def _turn(c, slip, dt):  # type: ignore[no-untyped-def]
    """The new headings, their sines and cosines."""
    for i in range(1, c.shape[1]):
        c[HEADING, i] += c[SPEED, i] * slip[i] / (0.5 * LENGTH_M) * dt
    for i in range(1, c.shape[1]):
        c[COS, i], c[SIN, i] = cosine(c[HEADING, i]), sine(c[HEADING, i])
    for i in range(1, c.shape[1]):
        if abs(c[HEADING, i]) > FLAT_MOST_RAD:
            c[COS, i], c[SIN, i] = math.cos(c[HEADING, i]), math.sin(c[HEADING, i])


@jit
def _speed_up(c, w, dt):  # type: ignore[no-untyped-def]
    """Take over the new speeds; who was struck is thrown as well, and has crashed."""
    for i in range(1, c.shape[1]):
        a = -c[SPEED, i] if w[CRASHED, i] != 0 else c[ACCELERATION, i]
        a = min(a, SPEED_MOST_MPS - c[SPEED, i]) if c[SPEED, i] > SPEED_MOST_MPS else a
        a = max(a, -SPEED_MOST_MPS - c[SPEED, i]) if c[SPEED, i] < -SPEED_MOST_MPS else a
        c[SPEED, i] += a * dt
        c[TIMER, i] += dt
    for i in range(1, c.shape[1]):
        if w[STRUCK, i] != 0:
            c[X, i] += c[IMPACT_X, i]
            c[Y, i] += c[IMPACT_Y, i]
            w[CRASHED, i], w[STRUCK, i] = 1, 0


@jit
def _find_lanes(c, w, table):  # type: ignore[no-untyped-def]
    """The nearest lane of every vehicle; half way between two highway-env takes the first."""
    lowest, width, last = table[0, OFFSET], table[0, WIDTH], table.shape[0] - 1
    for i in range(1, c.shape[1]):
        place = (c[Y, i] - lowest) / width
        w[LANE, i] = int(min(max(math.ceil(place - 0.5), 0.0), float(last)))
