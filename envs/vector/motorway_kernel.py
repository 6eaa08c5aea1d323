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
def _braking(car, drv, i, j):  # type: ignore[no-untyped-def]
    """Reduction of IDM's acceleration of vehicle i by vehicle j ahead."""
    return braking(car, drv, i, j, car.x[j] - car.x[i], BRISK)


@jit(inline=True)
def _stands_on(car, k, table, lane):  # type: ignore[no-untyped-def]
    """Whether a vehicle is on a lane, or beside it by no more than the margin."""
    beside = abs(car.y[k] - table[lane].y_m) <= 0.5 * table[lane].width_m + BESIDE_M
    return beside & (-PAST_END_M <= car.x[k]) & (car.x[k] < table[lane].length_m + PAST_END_M)


@jit(inline=True)
def _ahead(car, drv, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle ahead of i on a lane, -1 for none."""
    for at in range(drv.rank[i] + 1, car.present):
        k = drv.order[at]
        if _stands_on(car, k, table, lane):
            return k
    return -1


@jit(inline=True)
def _behind(car, drv, i, table, lane):  # type: ignore[no-untyped-def]
    """The vehicle behind i on a lane, -1 for none."""
    for at in range(drv.rank[i] - 1, -1, -1):
        k = drv.order[at]
        if _stands_on(car, k, table, lane):
            return k
    return -1


@jit(inline=True)
def sort_along(car, drv):  # type: ignore[no-untyped-def]
    """Bring ``order`` up to date: nearly sorted, so by insertion."""
    for a in range(1, car.present):
        k = drv.order[a]
        x = car.x[k]
        if car.x[drv.order[a - 1]] <= x:
            continue
        at = a - 1
        while at >= 0 and car.x[drv.order[at]] > x:
            drv.order[at + 1] = drv.order[at]
            at -= 1
        drv.order[at + 1] = k


@jit(inline=True)
def survey(car, drv, table, newest, held):  # type: ignore[no-untyped-def]
    """Ranks along the road, and the vehicle in front of each in its lane.

    One sweep against the traffic: the last vehicle met on a lane is in front of all that follow. ``newest`` (L + 1,)
    and ``held`` (2, V) are scratch.
    """
    _occupy(car, table, held)
    newest[:] = -1
    for at in range(car.present - 1, -1, -1):
        k = drv.order[at]
        drv.rank[k], drv.front[k] = at, newest[car.lane[k]]
        newest[held[0, k]] = newest[held[1, k]] = k


@jit(inline=True)
def _occupy(car, table, held):  # type: ignore[no-untyped-def]
    """The lanes that every vehicle stands on, ``held`` (2, V): its own, and the one on its side of it; L for none."""
    lowest, width, end, none = table[0].y_m, table[0].width_m, table[0].length_m + PAST_END_M, table.shape[0]
    reach = 0.5 * width + BESIDE_M
    for i in range(car.present):
        lane, along = car.lane[i], (-PAST_END_M <= car.x[i]) & (car.x[i] < end)
        aside = car.y[i] - (lowest + lane * width)
        beside = lane + (1 if aside > 0.0 else -1)
        there = along & (abs(car.y[i] - (lowest + beside * width)) <= reach) & (beside >= 0) & (beside < none)
        held[0, i] = lane if along & (abs(aside) <= reach) else none
        held[1, i] = beside if there else none


@jit(inline=True)
def change_lanes(car, drv, table, ego_has_target):  # type: ignore[no-untyped-def]
    """The decisions of all drivers one after the other: later ones see the new targets of those before."""
    for i in range(1, car.present):
        changing = car.lane[i] != drv.target[i]
        if not (changing | (drv.timer[i] > BRISK.delay_s)) or car.crashed[i] != 0:
            continue
        if changing:
            _give_up(car, drv, i, 0 if ego_has_target else 1)
        else:
            drv.timer[i] = 0.0
            _consider(car, drv, i, table)


@jit(inline=True)
def _give_up(car, drv, i, first):  # type: ignore[no-untyped-def]
    """Return to the own lane when a vehicle close ahead is changing into the same one."""
    goal = drv.target[i]
    for k in range(first, car.present):
        if drv.target[k] == goal and car.lane[k] != goal and k != i:
            distance = car.x[k] - car.x[i]
            if 0.0 < distance < gap_wanted(car, drv, i, k, BRISK):
                drv.target[i] = car.lane[i]
                return


@jit(inline=True)
def _consider(car, drv, i, table):  # type: ignore[no-untyped-def]
    """MOBIL without politeness, left before right: the last lane that is worth it is taken."""
    if abs(car.speed[i]) < 1.0:
        return
    own, delta, here = car.lane[i], drv.delta[i], drv.front[i]
    alone = free(car.speed[i], wanted_speed(drv, i, table[own].speed_limit_mps), delta, BRISK)
    now = alone - (_braking(car, drv, i, here) if here >= 0 else 0.0)
    for side in (-1, 1):
        lane = own + side
        if not 0 <= lane < table.shape[0]:
            continue
        aside = abs(car.y[i] - table[lane].y_m)
        if not (aside <= 2.0 * table[lane].width_m and 0.0 <= car.x[i] < table[lane].length_m + PAST_END_M):
            continue
        follower = _behind(car, drv, i, table, lane)
        if follower >= 0:
            limit = table[car.lane[follower]].speed_limit_mps
            theirs = free(car.speed[follower], wanted_speed(drv, follower, limit), delta, BRISK)
            if theirs - _braking(car, drv, follower, i) < -BRAKING_IMPOSED:
                continue
        there = _ahead(car, drv, i, table, lane)
        gain = alone - (_braking(car, drv, i, there) if there >= 0 else 0.0) - now
        if not gain < BRISK.gain:
            drv.target[i] = lane


@jit(inline=True)
def accelerate(car, drv, table, front):  # type: ignore[no-untyped-def]
    """IDM's acceleration of every driver, from the places at the beginning of the step; that of a wreck is not used.

    A loop for each quantity, so that the compiler takes several vehicles at once; ``front`` (5, V) is scratch.
    """
    _look_ahead(car, drv, front)
    for i in range(1, car.present):
        drv.acceleration[i] = wanted_speed(drv, i, table[car.lane[i]].speed_limit_mps)
    for i in range(1, car.present):
        drv.acceleration[i] = free(car.speed[i], drv.acceleration[i], drv.delta[i], BRISK)
    for i in range(1, car.present):
        closing = (front[3, i] - front[0, i]) * drv.cos[i] + (front[4, i] - front[1, i]) * drv.sin[i]
        front[2, i] = braking_of(car.speed[i], closing, front[2, i], BRISK)
    for i in range(1, car.present):
        if car.lane[i] != drv.target[i]:
            k = _ahead(car, drv, i, table, drv.target[i])
            if k >= 0:
                front[2, i] = max(front[2, i], _braking(car, drv, i, k))
    for i in range(1, car.present):
        drv.acceleration[i] = min(max(drv.acceleration[i] - front[2, i], -ACC_MOST), ACC_MOST)


@jit(inline=True)
def _look_ahead(car, drv, front):  # type: ignore[no-untyped-def]
    """Velocity of the vehicle in front of each (rows 0, 1), its gap (2; inf for none), and the own velocity (3, 4)."""
    for i in range(car.present):
        front[3, i], front[4, i] = car.speed[i] * drv.cos[i], car.speed[i] * drv.sin[i]
    for i in range(1, car.present):
        k = drv.front[i]
        if k >= 0:
            front[0, i], front[1, i], front[2, i] = front[3, k], front[4, k], car.x[k] - car.x[i]
        else:
            front[0, i], front[1, i], front[2, i] = 0.0, 0.0, math.inf


@jit(inline=True)
def drive_others(car, drv, table, dt, slip):  # type: ignore[no-untyped-def]
    """One step of all others: the modified bicycle model of highway-env, wrecks braking to rest.

    A loop for each quantity, so that the compiler takes several vehicles at once; ``slip`` (V,) is scratch.
    """
    _steer(car, drv, table, slip)
    _move(car, drv, slip, dt)
    _turn(car, drv, slip, dt)
    _speed_up(car, drv, dt)
    _find_lanes(car, drv, table)


@jit(inline=True)
def _steer(car, drv, table, slip):  # type: ignore[no-untyped-def]
    """Sine of the slip angle that steers every vehicle to its line in its lane; wrecks roll straight on."""
    for i in range(1, car.present):
        slip[i] = table[drv.target[i]].y_m + drv.aside[i]
    for i in range(1, car.present):
        inverse = 1.0 / not_zero(car.speed[i])
        course = -KP_LATERAL * (car.y[i] - slip[i]) * inverse
        turn = arcsine(min(max(course, -SIN_COURSE_MOST), SIN_COURSE_MOST)) - car.heading[i]
        turn = wrap(turn)
        rate = 0.5 * car.length[i] * inverse * KP_HEADING * turn
        slip[i] = 0.0 if car.crashed[i] != 0 else min(max(rate, -SIN_SLIP_MOST), SIN_SLIP_MOST)


@jit(inline=True)
def _move(car, drv, slip, dt):  # type: ignore[no-untyped-def]
    """Every vehicle to its place at the end of the step."""
    for i in range(1, car.present):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        car.x[i] += car.speed[i] * (drv.cos[i] * cosine_of_slip - drv.sin[i] * slip[i]) * dt
    for i in range(1, car.present):
        cosine_of_slip = math.sqrt(1.0 - slip[i] * slip[i])
        car.y[i] += car.speed[i] * (drv.sin[i] * cosine_of_slip + drv.cos[i] * slip[i]) * dt


@jit(inline=True)
def _turn(car, drv, slip, dt):  # type: ignore[no-untyped-def]
    """The new headings, their sines and cosines."""
    for i in range(1, car.present):
        car.heading[i] += car.speed[i] * slip[i] / (0.5 * car.length[i]) * dt
    for i in range(1, car.present):
        drv.cos[i], drv.sin[i] = cosine(car.heading[i]), sine(car.heading[i])
    for i in range(1, car.present):
        if abs(car.heading[i]) > FLAT_MOST_RAD:
            drv.cos[i], drv.sin[i] = math.cos(car.heading[i]), math.sin(car.heading[i])


@jit(inline=True)
def _speed_up(car, drv, dt):  # type: ignore[no-untyped-def]
    """The new speeds; a vehicle that was struck is thrown as well, and has crashed."""
    for i in range(1, car.present):
        a = -car.speed[i] if car.crashed[i] != 0 else drv.acceleration[i]
        a = min(a, SPEED_MOST_MPS - car.speed[i]) if car.speed[i] > SPEED_MOST_MPS else a
        a = max(a, -SPEED_MOST_MPS - car.speed[i]) if car.speed[i] < -SPEED_MOST_MPS else a
        car.speed[i] += a * dt
        drv.timer[i] += dt
    for i in range(1, car.present):
        if drv.struck[i] != 0:
            car.x[i] += drv.impact_x[i]
            car.y[i] += drv.impact_y[i]
            car.crashed[i], drv.struck[i] = 1, 0


@jit(inline=True)
def _find_lanes(car, drv, table):  # type: ignore[no-untyped-def]
    """The nearest lane of every vehicle; half way between two highway-env takes the first."""
    lowest, width, last = table[0].y_m, table[0].width_m, table.shape[0] - 1
    for i in range(1, car.present):
        place = (car.y[i] - lowest) / width
        car.lane[i] = int(min(max(math.ceil(place - 0.5), 0.0), float(last)))
