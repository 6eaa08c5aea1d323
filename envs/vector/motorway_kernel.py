"""Traffic of a straight motorway along x: highway-env's IDM drivers with MOBIL lane changes, sorted once a step.

An environment's vehicles are kept in order along x, so that neighbours are found by a short walk. Headings and slip
enter by their sines and cosines: steering commands ``sin(beta)``, and by ``tan(beta) = tan(steering) / 2`` arctangent
and tangent cancel. Lanes are straight along x, of one width, side by side.

Below ``L dt / (4 tau_heading tau_lateral)``, 0.52 m/s at 20 Hz, the steering of ControlledVehicle amplifies rounding.
Angles are wrapped with highway-env's rounding, so vehicles on their line stay there; an ego at such
speeds that changes lanes by meta-actions oscillates by some millimetres, depending on the last bits.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.ego_kernel import KP_HEADING, KP_LATERAL, not_zero
from lanebound.envs.batch.lanes_kernel import PAST_END_M
from lanebound.envs.vector.arithmetic_kernel import FLAT_MOST_RAD, arcsine, cosine, sine
from lanebound.envs.vector.drivers_kernel import SPEED_MOST_MPS
from lanebound.envs.vector.idm_kernel import (
    ACC_MOST,
    BRAKING_IMPOSED,
    braking,
    braking_of,
    free,
    gap_wanted,
    wanted_speed,
)
from lanebound.envs.worlds.idm_parameters_kernel import BESIDE_M, BRISK
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap

__all__ = ["SIN_SLIP_MOST", "accelerate", "change_lanes", "drive_others", "sort_along", "survey"]

SIN_COURSE_MOST = math.sin(0.25 * math.pi)
TAN_SLIP_MOST = 0.5 * math.tan(math.pi / 3.0)
SIN_SLIP_MOST = math.sin(math.atan(TAN_SLIP_MOST))


@jit(inline=True)
def _braking(v, i, j):  # type: ignore[no-untyped-def]
    """Reduction of IDM's acceleration of vehicle i by vehicle j ahead."""
    return braking(v, i, j, v.x[j] - v.x[i], BRISK)


@jit(inline=True)
def _stands_on(v, k, table, lane):  # type: ignore[no-untyped-def]
    """Whether a vehicle is on a lane, or beside it by no more than the margin."""
    beside = abs(v.y[k] - table[lane].y_m) <= 0.5 * table[lane].width_m + BESIDE_M
    return beside & (-PAST_END_M <= v.x[k]) & (v.x[k] < table[lane].length_m + PAST_END_M)


@jit(inline=True)
def _ahead(v, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle ahead of i on a lane, -1 for none."""
    for at in range(v.rank[i] + 1, v.x.shape[0]):
        k = v.order[at]
        if _stands_on(v, k, table, lane):
            return k
    return -1


@jit(inline=True)
def _behind(v, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle behind i on a lane, -1 for none."""
    for at in range(v.rank[i] - 1, -1, -1):
        k = v.order[at]
        if _stands_on(v, k, table, lane):
            return k
    return -1


@jit(inline=True)
def sort_along(v):  # type: ignore[no-untyped-def]
    """Bring ``order`` up to date: nearly sorted, so by insertion."""
    for a in range(1, v.x.shape[0]):
        k = v.order[a]
        x = v.x[k]
        if v.x[v.order[a - 1]] <= x:
            continue
        at = a - 1
        while at >= 0 and v.x[v.order[at]] > x:
            v.order[at + 1] = v.order[at]
            at -= 1
        v.order[at + 1] = k


@jit(inline=True)
def survey(v, table, newest, held):  # type: ignore[no-untyped-def]
    """Ranks along the road, and the vehicle in front of each in its lane.

    One sweep against the traffic: the last vehicle met on a lane is in front of all that follow. ``newest`` (L + 1,)
    and ``held`` (2, V) are scratch.
    """
    _occupy(v, table, held)
    newest[:] = -1
    for at in range(v.x.shape[0] - 1, -1, -1):
        k = v.order[at]
        v.rank[k], v.front[k] = at, newest[v.lane[k]]
        newest[held[0, k]] = newest[held[1, k]] = k


@jit(inline=True)
def _occupy(v, table, held):  # type: ignore[no-untyped-def]
    """The lanes that every vehicle stands on, ``held`` (2, V): its own, and the one on its side of it; L for none."""
    lowest, width, end, none = table[0].y_m, table[0].width_m, table[0].length_m + PAST_END_M, table.shape[0]
    reach = 0.5 * width + BESIDE_M
    for i in range(v.x.shape[0]):
        lane, along = v.lane[i], (-PAST_END_M <= v.x[i]) & (v.x[i] < end)
        aside = v.y[i] - (lowest + lane * width)
        beside = lane + (1 if aside > 0.0 else -1)
        there = along & (abs(v.y[i] - (lowest + beside * width)) <= reach) & (beside >= 0) & (beside < none)
        held[0, i] = lane if along & (abs(aside) <= reach) else none
        held[1, i] = beside if there else none


@jit(inline=True)
def change_lanes(v, table, ego_has_target):  # type: ignore[no-untyped-def]
    """The decisions of all drivers one after the other: later ones see the new targets of those before."""
    for i in range(1, v.x.shape[0]):
        changing = v.lane[i] != v.target[i]
        if not (changing | (v.timer[i] > BRISK.delay_s)) or v.crashed[i] != 0:
            continue
        if changing:
            _give_up(v, i, 0 if ego_has_target else 1)
        else:
            v.timer[i] = 0.0
            _consider(v, i, table)


@jit(inline=True)
def _give_up(v, i, first):  # type: ignore[no-untyped-def]
    """Return to the own lane when a vehicle close ahead is changing into the same one."""
    goal = v.target[i]
    for k in range(first, v.x.shape[0]):
        if v.target[k] == goal and v.lane[k] != goal and k != i:
            distance = v.x[k] - v.x[i]
            if 0.0 < distance < gap_wanted(v, i, k, BRISK):
                v.target[i] = v.lane[i]
                return


@jit(inline=True)
def _consider(v, i, table):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken."""
    if abs(v.speed[i]) < 1.0:
        return
    own, delta, here = v.lane[i], v.delta[i], v.front[i]
    alone = free(v.speed[i], wanted_speed(v, i, table[own].speed_limit_mps), delta, BRISK)
    now = alone - (_braking(v, i, here) if here >= 0 else 0.0)
    for side in (-1, 1):
        lane = own + side
        if not 0 <= lane < table.shape[0]:
            continue
        aside = abs(v.y[i] - table[lane].y_m)
        if not (aside <= 2.0 * table[lane].width_m and 0.0 <= v.x[i] < table[lane].length_m + PAST_END_M):
            continue
        follower = _behind(v, i, table, lane)
        if follower >= 0:
            limit = table[v.lane[follower]].speed_limit_mps
            theirs = free(v.speed[follower], wanted_speed(v, follower, limit), delta, BRISK)
            if theirs - _braking(v, follower, i) < -BRAKING_IMPOSED:
                continue
        there = _ahead(v, i, table, lane)
        gain = alone - (_braking(v, i, there) if there >= 0 else 0.0) - now
        if not gain < BRISK.gain:
            v.target[i] = lane


@jit(inline=True)
def accelerate(v, table, front):  # type: ignore[no-untyped-def]
    """IDM's acceleration of every driver, from the places at the beginning of the step; that of a wreck is not used.

    A loop for each quantity, so that the compiler takes several vehicles at once; ``front`` (5, V) is scratch.
    """
    _look_ahead(v, front)
    for i in range(1, v.x.shape[0]):
        v.acceleration[i] = wanted_speed(v, i, table[v.lane[i]].speed_limit_mps)
    for i in range(1, v.x.shape[0]):
        v.acceleration[i] = free(v.speed[i], v.acceleration[i], v.delta[i], BRISK)
    for i in range(1, v.x.shape[0]):
        closing = (front[3, i] - front[0, i]) * v.cos[i] + (front[4, i] - front[1, i]) * v.sin[i]
        front[2, i] = braking_of(v.speed[i], closing, front[2, i], BRISK)
    for i in range(1, v.x.shape[0]):
        if v.lane[i] != v.target[i]:
            k = _ahead(v, i, table, v.target[i])
            if k >= 0:
                front[2, i] = max(front[2, i], _braking(v, i, k))
    for i in range(1, v.x.shape[0]):
        v.acceleration[i] = min(max(v.acceleration[i] - front[2, i], -ACC_MOST), ACC_MOST)


@jit(inline=True)
def _look_ahead(v, front):  # type: ignore[no-untyped-def]
    """Velocity of the vehicle in front of each (rows 0, 1), its gap (2; inf for none), and the own velocity (3, 4)."""
    for i in range(v.x.shape[0]):
        front[3, i], front[4, i] = v.speed[i] * v.cos[i], v.speed[i] * v.sin[i]
    for i in range(1, v.x.shape[0]):
        k = v.front[i]
        if k >= 0:
            front[0, i], front[1, i], front[2, i] = front[3, k], front[4, k], v.x[k] - v.x[i]
        else:
            front[0, i], front[1, i], front[2, i] = 0.0, 0.0, math.inf


@jit(inline=True)
def drive_others(v, table, dt, slip):  # type: ignore[no-untyped-def]
    """One step of all others: the modified bicycle model of highway-env, wrecks braking to rest.

    A loop for each quantity, so that the compiler takes several vehicles at once; ``slip`` (V,) is scratch.
    """
    _steer(v, table, slip)
    _move(v, slip, dt)
    _turn(v, slip, dt)
    _speed_up(v, dt)
    _find_lanes(v, table)


@jit(inline=True)
def _steer(v, table, slip):  # type: ignore[no-untyped-def]
    """Sine of the slip angle that steers every vehicle to its line in its lane; wrecks roll straight on."""
    for i in range(1, v.x.shape[0]):
        slip[i] = table[v.target[i]].y_m + v.aside[i]
    for i in range(1, v.x.shape[0]):
        inverse = 1.0 / not_zero(v.speed[i])
        course = -KP_LATERAL * (v.y[i] - slip[i]) * inverse
        turn = arcsine(min(max(course, -SIN_COURSE_MOST), SIN_COURSE_MOST)) - v.heading[i]
        turn = wrap(turn)
        rate = 0.5 * v.length[i] * inverse * KP_HEADING * turn
        slip[i] = 0.0 if v.crashed[i] != 0 else min(max(rate, -SIN_SLIP_MOST), SIN_SLIP_MOST)


@jit(inline=True)
def _move(v, slip, dt):  # type: ignore[no-untyped-def]
    """Every vehicle to its place at the end of the step."""
    for i in range(1, v.x.shape[0]):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        v.x[i] += v.speed[i] * (v.cos[i] * cosine_of_slip - v.sin[i] * slip[i]) * dt
    for i in range(1, v.x.shape[0]):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        v.y[i] += v.speed[i] * (v.sin[i] * cosine_of_slip + v.cos[i] * slip[i]) * dt


@jit(inline=True)
def _turn(v, slip, dt):  # type: ignore[no-untyped-def]
    """The new headings, their sines and cosines."""
    for i in range(1, v.x.shape[0]):
        v.heading[i] += v.speed[i] * slip[i] / (0.5 * v.length[i]) * dt
    for i in range(1, v.x.shape[0]):
        v.cos[i], v.sin[i] = cosine(v.heading[i]), sine(v.heading[i])
    for i in range(1, v.x.shape[0]):
        if abs(v.heading[i]) > FLAT_MOST_RAD:
            v.cos[i], v.sin[i] = math.cos(v.heading[i]), math.sin(v.heading[i])


@jit(inline=True)
def _speed_up(v, dt):  # type: ignore[no-untyped-def]
    """The new speeds; a vehicle that was struck is thrown as well, and has crashed."""
    for i in range(1, v.x.shape[0]):
        a = -v.speed[i] if v.crashed[i] != 0 else v.acceleration[i]
        a = min(a, SPEED_MOST_MPS - v.speed[i]) if v.speed[i] > SPEED_MOST_MPS else a
        a = max(a, -SPEED_MOST_MPS - v.speed[i]) if v.speed[i] < -SPEED_MOST_MPS else a
        v.speed[i] += a * dt
        v.timer[i] += dt
    for i in range(1, v.x.shape[0]):
        if v.struck[i] != 0:
            v.x[i] += v.impact_x[i]
            v.y[i] += v.impact_y[i]
            v.crashed[i], v.struck[i] = 1, 0


@jit(inline=True)
def _find_lanes(v, table):  # type: ignore[no-untyped-def]
    """The nearest lane of every vehicle; half way between two highway-env takes the first."""
    lowest, width, last = table[0].y_m, table[0].width_m, table.shape[0] - 1
    for i in range(1, v.x.shape[0]):
        place = (v.y[i] - lowest) / width
        v.lane[i] = int(min(max(math.ceil(place - 0.5), 0.0), float(last)))
