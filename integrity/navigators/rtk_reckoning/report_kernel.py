"""The last stages: the RTK position is taken where it is accepted, and the solution is reported."""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.alerts_kernel import INITIALISING, NO_SOLUTION, TEST_FAILED, alert_step
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import remember_velocity, sigma_and_bias
from lanebound.integrity.monitoring.jump_kernel import is_suspicious
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import cover_histories, restart
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import copy_reckoning, reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Epoch
from lanebound.integrity.positioning.codes_kernel import CODE, DOPPLER, NONE, RTK

__all__ = ["report", "take_fix"]


@jit(borrows=True)
def take_fix(first: int, last: int, epoch: Epoch) -> None:
    """Replace the position by an accepted RTK position and restart dead reckoning there; before, by that of codes."""
    par, tables = epoch.parameters[0], epoch.tables
    for v in range(first, last):
        vehicle, w, levels = epoch.vehicles[v], epoch.work[v], epoch.levels[v]
        if w.accepted:
            w.mode = RTK
            for r in range(levels.shape[0]):
                levels[r, 0], levels[r, 1] = epoch.fixed_levels[v, r, 0], epoch.fixed_levels[v, r, 1]
            cover_histories(vehicle.doubt, tables, levels)
            vehicle.position[0], vehicle.position[1] = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
            vehicle.position[2] = w.fixed.position[2]
            vehicle.since_rtk, vehicle.initialised, vehicle.unbounded = 0.0, True, False
            restart(vehicle, epoch.starts[v, LATEST], epoch.faults[v], tables, par.risk, w, levels)
            if not (w.fixed.lasting and vehicle.backup.age < par.jump.backup):
                vehicle.backup.position[0], vehicle.backup.position[1] = vehicle.position[0], vehicle.position[1]
                vehicle.backup.age = 0.0
                copy_reckoning(LATEST, BACKUP, vehicle, epoch.starts[v], epoch.faults[v])
        elif par.cold and w.fixed.coded and not vehicle.initialised:
            w.mode, g = CODE, vehicle.growth[LATEST]
            vehicle.position[0], vehicle.position[1] = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
            vehicle.position[2] = w.fixed.position[2]
            g.p_ee, g.p_en, g.p_nn = w.fixed.p_ee, w.fixed.p_en, w.fixed.p_nn
        vehicle.has_velocity = w.doppler_moves
        if w.mode != DOPPLER and w.doppler_moves:  # the next epoch may begin a trapezoid with this velocity
            for k in range(2):
                remember_velocity(w.q[0, 0], w.q[0, 1], w.q[1, 1], vehicle.growth[k])
        vehicle.velocity[0], vehicle.velocity[1] = w.v_e, w.v_n
        if not w.doppler_moves:
            course, speed = vehicle.heading.angle + w.slip, epoch.observed[v].speed
            vehicle.velocity[0], vehicle.velocity[1] = speed * math.sin(course), speed * math.cos(course)


@jit(borrows=True)
def report(first: int, last: int, epoch: Epoch) -> None:
    """Advance the alert and fill the outputs."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w, out, levels = epoch.vehicles[v], epoch.work[v], epoch.out[v], epoch.levels[v]
        g = vehicle.growth[LATEST]
        sigma_at, sigma_ct, _, _ = sigma_and_bias(w.sin_h, w.cos_h, False, g)
        if w.mode == RTK:
            sigma_h = math.sqrt(vehicle.heading.p_hh)
            sigma_at = math.hypot(w.fixed.sigma[0], par.lever.right * sigma_h)
            sigma_ct = math.hypot(w.fixed.sigma[1], par.lever.forward * sigma_h)
        whole = keep_finite(vehicle, levels)
        # A cold start knows no heading at first, and so no direction in which a level could hold.
        known = whole and vehicle.initialised and not (par.cold and vehicle.since_calibration == math.inf)
        if not known and par.cold:
            levels[:, :] = math.inf
        cause, doubted = w.cause if known else INITIALISING, is_suspicious(vehicle.jump)
        if not whole:
            cause = NO_SOLUTION
        elif doubted or (vehicle.unbounded and w.mode != RTK and w.mode != NONE):
            cause = TEST_FAILED
        at, ct = levels[0, 0], levels[0, 1]
        out.available = alert_step(cause, at, ct, sigma_at, sigma_ct, par.dt, par.alert, vehicle.alert)
        out.alert, out.reason = vehicle.alert.alert, vehicle.alert.reason
        out.sigma_at, out.sigma_ct = sigma_at, sigma_ct
        _report_state(vehicle, w, out)
        lever, variance = par.lever, vehicle.heading.p_hh
        turned_e = w.sin_h * lever.right - w.cos_h * lever.forward  # of a radian of heading
        turned_n = w.cos_h * lever.right + w.sin_h * lever.forward
        out.covariance[0, 0] = g.p_ee + turned_e * turned_e * variance
        out.covariance[1, 1] = g.p_nn + turned_n * turned_n * variance
        out.covariance[0, 1] = out.covariance[1, 0] = g.p_en + turned_e * turned_n * variance


@jit(borrows=True)
def keep_finite(vehicle: Any, levels: Any) -> bool:
    """Whether position and heading are finite; else there is no level, and the position is the last one of RTK that is.

    Only a plug-in stage can write others: measurements that are not finite do not come here.
    """
    if math.isfinite(vehicle.position[0] + vehicle.position[1] + vehicle.heading.angle):
        return True
    levels[:, :] = math.inf
    vehicle.unbounded = True
    for k in range(2):
        if not math.isfinite(vehicle.backup.position[k]):
            vehicle.backup.position[k] = 0.0
        if not math.isfinite(vehicle.position[k]):
            vehicle.position[k] = vehicle.backup.position[k]
    return False


@jit(borrows=True)
def _report_state(vehicle: Any, w: Any, out: Any) -> None:
    """Position, heading, velocity, mode and counts of a vehicle."""
    for k in range(2):
        out.position[k], out.velocity[k] = vehicle.position[k], vehicle.velocity[k]
    out.heading, out.difference[0], out.difference[1] = vehicle.heading.angle, vehicle.jump.d_e, vehicle.jump.d_n
    out.mode, out.rtk = w.mode, w.fixed.status
    out.hdop = w.fixed.hdop if w.mode == RTK else w.hdop_doppler
    out.satellites, out.satellites_doppler = w.fixed.satellites, w.satellites_doppler
    out.excluded = w.excluded + w.fixed.excluded + w.excluded_doppler
    out.since_rtk, out.since_calibration = vehicle.since_rtk, vehicle.since_calibration
    out.wrong, out.sdop = w.fixed.wrong, w.sdop
