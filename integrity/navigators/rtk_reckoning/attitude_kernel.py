"""Standstill, and the heading by the gyro, calibrated by Doppler."""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.small_matrix_kernel import cholesky_2
from lanebound.integrity.monitoring.heading_doubt_kernel import (
    NONE,
    due,
    find_difference,
    follow_gyro,
    note_agreement,
    note_course,
    note_refusal,
    turn_to_doppler,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.heading_kernel import (
    correct,
    correlate,
    doppler_heading_usable,
    doppler_heading_variance,
    expect_turn,
    observe,
    predict_heading,
    rest_heading,
)
from lanebound.integrity.positioning.mode_kernel import doppler_usable, speed_dilution
from lanebound.integrity.positioning.odometer_watch_kernel import STANDING_MPS, turning_at_rest

__all__ = ["admit_doppler", "find_attitude"]

MOST_SLIP = 0.9  # sine of the side slip at most; that of a car at full lock is 0.65, more is noise at creeping speed
REST_S = 0.5  # without motion, until the vehicle is at rest
REST_DOPPLER_MPS = 0.1  # Doppler speed that is no motion, at least


@jit(borrows=True)
def find_attitude(first: int, last: int, epoch: Epoch) -> None:
    """Heading at the end of the epoch, and the course in its middle."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w, observed = epoch.vehicles[v], epoch.work[v], epoch.observed[v]
        heading, speed, turn = vehicle.heading, observed.speed, observed.turn[2]
        w.turning = turn * (1.0 - heading.gyro_scale) / par.dt - heading.gyro_bias
        _move_velocity(vehicle, par, w)
        w.resting = _find_rest(vehicle, par, speed, w)
        w.slip = side_slip(par.lever.axle, w.turning, speed)
        slip_rate = w.turning / (speed * math.cos(w.slip)) if abs(speed) > STANDING_MPS else 0.0
        expect_turn(turn, par.dt, par.heading.angle_random_walk, slip_rate, heading, w.step.turn)
        w.middle = wrap(_advance_heading(heading, par, turn, w) + w.slip)
        w.reckoned, w.turned = heading.angle, 0.0 if w.resting else w.turning * par.dt
        w.before_e, w.before_n = vehicle.position[0], vehicle.position[1]
        if not w.resting:
            follow_gyro(turn, par.heading, par.dt, vehicle.doubt)
        vehicle.memory_s += par.dt
        if w.checked and not w.resting and _calibrate(vehicle, par, speed, slip_rate, w):
            vehicle.since_calibration = 0.0
            vehicle.memory_s *= 1.0 - w.step.turn.k_h
        if vehicle.doubt.stage != NONE:
            find_difference(heading.angle, vehicle.doubt)
        w.sin_h, w.cos_h = math.sin(heading.angle), math.cos(heading.angle)
        step = w.step
        step.dt_s, step.axle_bias = par.dt, par.lever.axle_bound * step.turn.axle
        # Changes of carriers have errors that are independent in every epoch.
        step.phi_doppler, step.phi_odometer = par.doppler.decay, math.exp(-par.dt / par.odometer.tau)
        step.white_doppler = par.doppler.white
        if w.by_carriers:
            step.phi_doppler, step.white_doppler = 0.0, 0.0
        correlate(step.phi_doppler, step.white_doppler, heading, step.turn)


@jit(borrows=True)
def admit_doppler(first: int, last: int, epoch: Epoch) -> None:
    """Whether the Doppler velocity may move the position: tested, of good geometry, and with a heading not in doubt."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w, speed = epoch.vehicles[v], epoch.work[v], epoch.observed[v].speed
        w.sdop = math.inf
        if w.solved:
            w.sdop = speed_dilution(w.v_e, w.v_n, w.sin_h, w.cos_h, w.q, par.doppler.sigma)
        w.doppler_moves = doppler_usable(w.checked, w.v_gnss, speed, w.hdop_doppler, par.modes)
        w.doppler_moves = w.doppler_moves and w.sdop <= par.modes.doppler_max_sdop
        w.doppler_moves = w.doppler_moves and (par.risk.published or not vehicle.doubt.refuses)


@jit
def _move_velocity(vehicle: Any, par: Any, w: Any) -> None:
    """Velocity of the reference point from that of the antenna and the yaw rate."""
    sin_h, cos_h = math.sin(vehicle.heading.angle), math.cos(vehicle.heading.angle)
    forward, right = par.lever.forward, par.lever.right
    w.v_e = w.velocity[0] - w.turning * (cos_h * forward - sin_h * right)
    w.v_n = w.velocity[1] + w.turning * (sin_h * forward + cos_h * right)
    w.v_gnss = math.hypot(w.v_e, w.v_n)
    w.mean_e += w.v_e - w.velocity[0]
    w.mean_n += w.v_n - w.velocity[1]


@jit
def _find_rest(vehicle: Any, par: Any, speed: float, w: Any) -> bool:
    """Count how long the vehicle has been at rest: no pulse, no turn, and no Doppler speed beyond its noise."""
    spinning = turning_at_rest(par.dt, speed, w.turning, par.odometer.watch, vehicle.watch)
    at_rest = abs(speed) < STANDING_MPS and not spinning and not vehicle.watch.doubted
    noise = max(REST_DOPPLER_MPS, 3.0 * math.sqrt(w.q[0, 0] + w.q[1, 1]))
    at_rest = at_rest and not (w.solved and w.v_gnss > noise)
    vehicle.rest_s = vehicle.rest_s + par.dt if at_rest else 0.0
    return bool(vehicle.rest_s > REST_S)


@jit
def side_slip(axle: float, turning: float, speed: float) -> float:
    """Angle in a turn from the heading to the course of the reference point, ``axle`` [m] ahead of the rear axle [rad].

    The rear axle moves along the heading, so the reference point moves sideways at ``axle`` times the yaw rate.
    """
    sine = axle * turning / speed if abs(speed) > STANDING_MPS else 0.0
    return math.asin(min(max(sine, -MOST_SLIP), MOST_SLIP))


@jit
def _advance_heading(heading: Any, par: Any, delta_theta: float, w: Any) -> float:
    """Advance the heading by the gyro; at rest hold it and learn the gyro bias instead (ZUPT, S1 figure 1).

    Returns the mean heading over the epoch [rad].
    """
    dt, rules, before = par.dt, par.heading, heading.angle
    if w.resting:
        gains = rest_heading(delta_theta, dt, rules.angle_random_walk, rules.bias_walk, heading)
        observe(gains, True, 0.0, heading, w.step.turn)
        return float(heading.angle)
    predict_heading(delta_theta, dt, rules.angle_random_walk, rules.bias_walk, heading)
    return float(wrap(before + 0.5 * wrap(heading.angle - before)))


@jit
def _calibrate(vehicle: Any, par: Any, speed: float, slip_rate: float, w: Any) -> bool:
    """Calibrate the heading filter by the checked Doppler course where S1 table 1 allows it; True when done.

    The limit of the jump is widened to 3 sigma while the filter itself is less certain than the limit. Courses refused
    for their jump alone, for as long as a failed gyro needs for it, raise the variance of the filter. It then follows
    them; the heading by the gyro goes on in parallel (:mod:`~lanebound.integrity.monitoring.heading_doubt_kernel`).
    """
    heading, limits = vehicle.heading, par.heading.calibration
    magnitude = math.hypot(w.v_e, w.v_n)
    if not magnitude > 0.0:
        return False
    course = math.atan2(w.v_e, w.v_n) if speed >= 0.0 else math.atan2(-w.v_e, -w.v_n)
    jump = wrap(course - w.slip - heading.angle)
    allowed = max(limits.max_jump, 3.0 * math.sqrt(heading.p_hh))
    if not doppler_heading_usable(magnitude, speed, w.hdop_doppler, 0.0, limits):
        return False
    variance = doppler_heading_variance(w.v_e, w.v_n, w.q[0, 0], w.q[0, 1], w.q[1, 1])
    if abs(jump) >= allowed:
        beyond = abs(jump) > allowed + 3.0 * math.sqrt(variance)
        if beyond:
            note_refusal(par.dt, heading, vehicle.doubt)
            if due(jump, vehicle.doubt):
                turn_to_doppler(jump, par.heading, heading, vehicle.doubt)
        else:
            vehicle.doubt.refuses = False
        note_course(jump, vehicle.since_calibration, heading, vehicle.doubt)
        return False
    variance *= par.doppler.course
    # Carriers count no more than range rates here: levels without satellites have no hypothesis of a failed gyro, and
    # rest on a heading that is a hundred times better would be exceeded before they alert.
    if w.by_carriers:
        variance *= (par.doppler.sigma / par.doppler.carrier_sigma) ** 2
    turn, signed = w.step.turn, math.copysign(magnitude, speed)
    right_e, right_n = math.cos(course) / signed, -math.sin(course) / signed
    turn.right[0], turn.right[1] = right_e, right_n
    l_ee, l_ne, l_nn = cholesky_2(w.q[0, 0], w.q[0, 1], w.q[1, 1])
    turn.course[0], turn.course[1] = right_e * l_ee + right_n * l_ne, right_n * l_nn
    observe(correct(jump, 1.0, 0.0, variance, heading), False, -slip_rate, heading, w.step.turn)
    note_agreement(par.dt, limits.max_jump, heading, vehicle.doubt)
    return True
