"""How a filter begins: its first heading, its first position, and the positions that must confirm both.

The first heading is by the compass, or by the Doppler velocity of a moving car. Reflected range rates of a street can
turn a Doppler velocity by any angle, and then agree with each other. A velocity therefore counts only where its length
is that of the wheels, and only a trial of velocities that agree with the gyro over some distance gives a heading. A
filter whose next positions do not fit begins anew, and has no level until some fit: a wrong heading or a wrong first
position then shows, and not a level that is wrong with it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.navigators.vehicle_filter.position_kernel import (
    LOST,
    REJECTED,
    USED,
    fill_slow_columns,
    take_slow_error,
)
from lanebound.integrity.navigators.vehicle_filter.records_kernel import (
    BIASES,
    GNSS_EAST_BIAS,
    GNSS_NORTH_BIAS,
    FilterState,
    PositionFix,
)
from lanebound.integrity.positioning.filters.correction_kernel import Vector
from lanebound.integrity.positioning.filters.vehicle_states_kernel import (
    EAST,
    GNSS_EAST,
    GNSS_NORTH,
    GYRO_ANGLE,
    HEADING,
    NORTH,
    STATES,
)

__all__ = ["CONFIRMATIONS", "begin", "give_headings", "judge_start", "place_vehicles"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
COURSE_MPS = 2.0  # speed from which on a Doppler velocity gives the first heading
SIGMAS = 3.0  # of the Doppler velocity
WIDEST_RAD = math.radians(15.0)  # bound of a course that counts
COURSE_RAD = math.radians(0.5)  # beside: slip, and noise of the gyro during the trial
TRIAL, TRIAL_M = 10, 10.0  # velocities that must agree, and distance: reflections change over metres; chosen
CONFIRMATIONS = 3  # positions that must fit; chosen
LASTING_START = math.sqrt(2.0)
"""Variance factor of the first position. Its fast error e lasts, and the next positions count with ``f = (1 + phi) / (1
- phi)`` times the variance of e. The weighted mean of a first position of variance factor g and of n more then has no
more variance than it states for all n if ``g >= sqrt(2)`` (the limit of many positions within the correlation time)."""
HEADING_RAD2 = 1e-10  # keeps the covariance of heading and integrated gyro regular


@jit
def judge_start(state: FilterState, v: int, outcome: int) -> None:
    """Confirm the filter by a position that fits, or let it begin anew."""
    vehicle = state.vehicles[v]
    if outcome == USED and vehicle.unconfirmed > 0:
        vehicle.unconfirmed -= 1
    if outcome == LOST or (outcome == REJECTED and vehicle.unconfirmed > 0):
        vehicle.known = vehicle.aligned = False
        vehicle.trial.count = 0


@jit
def begin(par: Any, state: FilterState, v: int, measured: Any, fix: PositionFix, w: Vector) -> None:
    """Begin at a position from codes, with the heading of compass or Doppler velocity."""
    vehicle, found = state.vehicles[v], fix.vehicles[v]
    if not vehicle.aligned:
        if par.compass:
            give_heading(state, v, measured.compass, par.compass_start)
        else:
            _try_course(par, state, v, measured, found)
    if vehicle.aligned and not vehicle.known and found.valid:
        fast = LASTING_START * max(vehicle.excess, 1.0) * found.fast
        begin_at(state, v, found.position, fast + found.slow)
        _share_constant_error(state, v)
        vehicle.unconfirmed = CONFIRMATIONS
        if par.sensor_errors:
            _share_slow_error(par, state, v, fix, w)
        vehicle.fix_age = vehicle.used_age = vehicle.moved = 0.0


@jit
def _try_course(par: Any, state: FilterState, v: int, measured: Any, fix: Any) -> None:
    """Count a Doppler velocity in the trial of the first heading."""
    vehicle, odometer = state.vehicles[v], measured.speed
    trial, speed = vehicle.trial, math.hypot(fix.velocity[0], fix.velocity[1])
    trial.moved += abs(measured.distance)
    if not fix.valid or speed <= COURSE_MPS or odometer <= 0.5 * COURSE_MPS:
        return
    bound = SIGMAS * par.doppler_sigma * math.sqrt(fix.velocity_m2[0, 0] + fix.velocity_m2[1, 1])
    if bound > WIDEST_RAD * speed:
        return
    turned = math.atan2(fix.velocity[0], fix.velocity[1]) - vehicle.turned
    apart = wrap(turned - trial.turned)
    if abs(speed - odometer) > bound + par.wheel_bound * odometer:
        trial.count = 0
    elif trial.count == 0 or abs(apart) > bound / speed + COURSE_RAD:
        trial.turned, trial.count, trial.moved = turned, 1, 0.0
    else:
        trial.count += 1
        trial.turned += apart / trial.count
    if trial.count >= TRIAL and trial.moved >= TRIAL_M:
        give_heading(state, v, trial.turned + vehicle.turned, bound / speed + COURSE_RAD)


@jit
def give_heading(state: FilterState, v: int, heading: float, sigma: float) -> None:
    """Set the heading of a vehicle and its 1-sigma; the gyro's integral begins anew, its bias stays."""
    for j in range(state.models.shape[1]):
        x, p, influence = state.models[v, j].x, state.models[v, j].p, state.influence[v, j]
        for k in range(STATES):
            p[HEADING, k] = p[k, HEADING] = p[GYRO_ANGLE, k] = p[k, GYRO_ANGLE] = 0.0
        x[HEADING], x[GYRO_ANGLE] = heading, -heading
        p[HEADING, HEADING], p[GYRO_ANGLE, GYRO_ANGLE] = sigma * sigma, sigma * sigma + HEADING_RAD2
        p[HEADING, GYRO_ANGLE] = p[GYRO_ANGLE, HEADING] = -sigma * sigma
        influence[HEADING] = 0.0
        influence[GYRO_ANGLE] = 0.0
    state.vehicles[v].turned, state.vehicles[v].aligned = 0.0, True


@jit
def begin_at(state: FilterState, v: int, position: Array, covariance: Array) -> None:
    """Set the position (2,) of a vehicle and its covariance (2, 2); slow errors of positions have no prior yet."""
    vehicle = state.vehicles[v]
    for j in range(state.models.shape[1]):
        x, p, influence = state.models[v, j].x, state.models[v, j].p, state.influence[v, j]
        for place in (EAST, NORTH, GNSS_EAST, GNSS_NORTH):
            x[place] = 0.0
            influence[place] = 0.0
            for k in range(STATES):
                p[place, k] = p[k, place] = 0.0
        x[EAST], x[NORTH] = position[0], position[1]
        for i in range(2):
            for k in range(2):
                p[i, k] = covariance[i, k]
    vehicle.known, vehicle.biased, vehicle.unconfirmed = True, False, 0
    vehicle.fix_age = vehicle.used_age = vehicle.moved = math.inf
    vehicle.rejected[:] = 0.0


@jit
def _share_constant_error(state: FilterState, v: int) -> None:
    """The position that a vehicle begins with has the constant error of GNSS positions; a given pose has none."""
    for j in range(state.models.shape[1]):
        state.influence[v, j, EAST, GNSS_EAST_BIAS] = state.influence[v, j, NORTH, GNSS_NORTH_BIAS] = 1.0


@jit
def _share_slow_error(par: Any, state: FilterState, v: int, fix: PositionFix, w: Vector) -> None:
    """The position that a vehicle begins with has the slow error of its GNSS position."""
    take_slow_error(par, state, v, fix)
    w.errors[:] = 0.0
    fill_slow_columns(fix, v, w.errors)
    for j in range(state.models.shape[1]):
        p, influence = state.models[v, j].p, state.influence[v, j]
        for i in range(2):
            for k in range(2):
                p[i, GNSS_EAST + k] = p[GNSS_EAST + i, k] = -fix.vehicles[v].slow[i, k]
            influence[i, BIASES:] = w.errors[i, BIASES:]


@jit
def give_headings(state: FilterState, rows: Ints, heading: Array, sigma: float) -> None:
    """:func:`give_heading` to vehicles (n,)."""
    for k in range(rows.shape[0]):
        give_heading(state, rows[k], heading[k], sigma)


@jit
def place_vehicles(state: FilterState, rows: Ints, position: Array, variance: float) -> None:
    """Begin at positions (n, 2) of vehicles (n,) with a variance on each axis; they need no confirmation."""
    for k in range(rows.shape[0]):
        begin_at(state, rows[k], position[k], variance * np.eye(2))
        vehicle = state.vehicles[rows[k]]
        vehicle.doubt = vehicle.doubt_left = 0.0
