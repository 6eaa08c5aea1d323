"""Stages of the positioning modes that bridge the time since an RTK position.

A mode moves the positions of the vehicles that it is usable for and that no mode before it has moved: both dead
reckonings, LATEST and BACKUP, with the growth of their errors. At rest every mode leaves the position; the bound grows
by the creep that the odometer may not show.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import step_doppler, step_odometer, step_still
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import heading_bias
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Array, Epoch
from lanebound.integrity.positioning.codes_kernel import DOPPLER, IMU_ODOMETER, NONE, UNDECIDED

CREEPING_MPS = 1.0  # slower, levels count what the side slip adds to the error; chosen
SIGMAS = 5.0  # of the yaw rate in that bound; beyond the factor of a level at 1e-5 (4.6)

__all__ = ["advance_doppler", "advance_imu_odometer", "advance_nothing", "doppler_is_tighter", "move", "stand"]


@jit(borrows=True)
def advance_doppler(first: int, last: int, epoch: Epoch) -> None:
    """Doppler: ``p += dt/2 (v_{t-1} + v_t)`` where its velocity is usable and the last RTK position is recent."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if w.mode != UNDECIDED or not (vehicle.initialised and w.doppler_moves):
            continue
        if not vehicle.since_rtk <= par.modes.doppler_max_s:
            continue
        # Changes of carriers add up to less than any odometer in seconds, although one of them is as noisy.
        if (
            par.modes.doppler_if_tighter
            and not w.by_carriers
            and not doppler_is_tighter(w, vehicle, epoch.observed[v].speed, epoch.tables.cases[0].k_dead, par)
        ):
            continue
        w.mode, w.integrates = DOPPLER, not w.resting
        if w.resting:
            stand(par, w, vehicle)
            continue
        before_e, before_n = (vehicle.velocity[0], vehicle.velocity[1]) if vehicle.has_velocity else (w.v_e, w.v_n)
        if not w.by_carriers:
            move(vehicle, 0.5 * par.dt * (before_e + w.v_e), 0.5 * par.dt * (before_n + w.v_n))
            for k in range(2):
                step_doppler(w.step, w.q[0, 0], w.q[0, 1], w.q[1, 1], par.doppler.bias, vehicle.growth[k])
            continue
        # Their velocity is the mean of the epoch, and drifts with the reference and with a spoofer as RTK does: the
        # backup solution, which RTK is compared with, moves by gyro and odometer.
        vehicle.position[0] += par.dt * w.mean_e
        vehicle.position[1] += par.dt * w.mean_n
        latest = vehicle.growth[LATEST]
        latest.have_l = False
        step_doppler(w.step, w.q[0, 0], w.q[0, 1], w.q[1, 1], par.doppler.bias, latest)
        speed = epoch.observed[v].speed
        w.backup_run = par.dt * speed
        vehicle.backup.position[0] += w.backup_run * math.sin(w.middle)
        vehicle.backup.position[1] += w.backup_run * math.cos(w.middle)
        _grow_by_odometer(par, speed, vehicle, w, vehicle.growth[BACKUP])


@jit
def doppler_is_tighter(w: Any, vehicle: Any, speed: float, k_md: Array, par: Any) -> bool:
    """Whether the bound of the Doppler velocity is smaller than that of gyro and odometer, squared and over both axes.

    Doppler: ``K^2 (q_EE + q_NN)`` and its bias; gyro and odometer: ``v (K_CT sigma_theta + b_theta)`` across and ``K_AT
    sigma_v + b_v`` along, infinite while the odometer is doubted. Bounds of one epoch are compared: in long outages the
    error of Doppler grows with the root of time, that of the heading with time. Nothing of the errors themselves
    enters. A reflected range rate moves a Doppler position by metres in seconds; the heading that it calibrated
    averages it.
    """
    if vehicle.watch.doubted:
        return True
    rules, k = par.odometer, max(k_md[0], k_md[1])
    doppler = k * math.sqrt(w.q[0, 0] + w.q[1, 1]) + math.sqrt(2.0) * par.doppler.bias
    across = abs(speed) * (k_md[1] * math.sqrt(vehicle.heading.p_hh) + heading_bias(vehicle, rules))
    along = k_md[0] * rules.sigma + rules.bias + rules.scale * abs(speed)
    return bool(doppler * doppler < across * across + along * along)


@jit(borrows=True)
def advance_imu_odometer(first: int, last: int, epoch: Epoch) -> None:
    """IMU and odometer: ``p += V dt [sin t, cos t]``; usable after a first position."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if w.mode != UNDECIDED or not vehicle.initialised:
            continue
        w.mode = IMU_ODOMETER
        if w.resting:
            stand(par, w, vehicle)
            continue
        speed = epoch.observed[v].speed
        w.run = par.dt * speed
        move(vehicle, w.run * math.sin(w.middle), w.run * math.cos(w.middle))
        for k in range(2):
            _grow_by_odometer(par, speed, vehicle, w, vehicle.growth[k])


@jit(borrows=True)
def _grow_by_odometer(par: Any, speed: float, vehicle: Any, w: Any, g: Any) -> None:
    """Grow the errors of a dead reckoning that gyro and odometer have moved; speed [m/s]."""
    rules = par.odometer
    b_theta, bias = heading_bias(vehicle, rules), rules.bias + rules.scale * abs(speed)
    aside = _slip_bound(vehicle.heading, par, speed, w.turning)
    step_odometer(w.step, speed, math.sin(w.middle), math.cos(w.middle), rules.sigma, bias, b_theta, g)
    g.box_e += aside * abs(w.cos_h)
    g.box_n += aside * abs(w.sin_h)


@jit
def _slip_bound(heading: Any, par: Any, speed: float, turning: float) -> float:
    """Bound of how far an error of the yaw rate moves the reference point sideways in an epoch of creeping [m].

    ``axle`` times the error of the yaw rate, added up over epochs as if it always had one sign.
    """
    # Faster cars: the error of the heading over the path, which levels count, outgrows this within a length of the car.
    if abs(speed) > CREEPING_MPS:
        return 0.0
    return float(par.dt * par.lever.axle * SIGMAS * math.sqrt(heading.p_bb + heading.p_ss * turning * turning))


@jit(borrows=True)
def advance_nothing(first: int, last: int, epoch: Epoch) -> None:
    """No mode is usable: the position stays, and no level holds for it before the next RTK position."""
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if w.mode == UNDECIDED:
            w.mode = NONE
            vehicle.unbounded = vehicle.unbounded or vehicle.initialised
            stand(epoch.parameters[0], w, vehicle)


@jit
def move(vehicle: Any, east: float, north: float) -> None:
    """Move the position and the backup solution [m]."""
    vehicle.position[0] += east
    vehicle.position[1] += north
    vehicle.backup.position[0] += east
    vehicle.backup.position[1] += north


@jit
def stand(par: Any, w: Any, vehicle: Any) -> None:
    """An epoch at rest, of both dead reckonings."""
    creep = par.dt * par.odometer.still_speed
    for k in range(2):
        g = vehicle.growth[k]
        step_still(w.step, g)
        g.cv_e += creep * w.sin_h
        g.cv_n += creep * w.cos_h
