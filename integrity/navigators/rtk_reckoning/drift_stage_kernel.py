"""Stage of the drift watch: RTK displacements against gyro and odometer, before the jump monitor judges RTK."""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.jump_kernel import grow_drift, is_suspicious
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import heading_bias
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.drift_watch_kernel import (
    advance,
    begin_watch,
    blames_odometer,
    find_drift,
    fold_doppler,
    learn,
    misfit,
    rates_of,
    walk_of,
)

__all__ = ["watch_drift"]


@jit
def watch_drift(first: int, last: int, epoch: Epoch) -> None:
    """Advance the windows while RTK positions follow one another; a drift becomes one of the jump monitor's state."""
    par = epoch.parameters[0]
    if epoch.anchors.shape[1] == 0:  # no window: the watch is off
        return
    rules = par.drift
    for v in range(first, last):
        vehicle, w, anchors = epoch.vehicles[v], epoch.work[v], epoch.anchors[v]
        d, fixed, speed, heading = vehicle.drift, w.fixed, epoch.observed[v].speed, vehicle.heading
        walk = walk_of(par.heading.angle_random_walk, heading.p_bb, heading.p_ss, w.turning, rules)
        advance(par.dt, par.dt * speed, w.slip, w.turning, w.resting, walk, rules, d)
        # Carriers drift as RTK does: that they agree with it does not blame the odometer.
        tested = w.solved and not w.by_carriers and w.hdop_doppler < par.heading.calibration.max_hdop
        fold_doppler(par.dt, tested, w.v_e, w.v_n, d)
        vehicle.jump.drifts = False
        grow_drift(par.dt, speed, w.sin_h, w.cos_h, vehicle.jump)
        followed = fixed.usable and fixed.lasting and not is_suspicious(vehicle.jump)
        if not followed or vehicle.watch.doubted or vehicle.unbounded:
            begin_watch(d)
            continue
        east, north = reference_point(fixed, par.lever, w.sin_h, w.cos_h)
        variance = worst_variance(fixed)
        found = find_drift(east, north, variance, speed, rules, d, anchors)
        if found >= 0:
            report_drift(found, east, north, variance, speed, rules, d, anchors, vehicle.jump)
            begin_watch(d)
            continue
        bias = heading_bias(vehicle, par.odometer)
        learn(east, north, variance, speed, heading.angle, heading.p_hh + bias * bias, rules, d, anchors)


@jit
def worst_variance(fixed: Any) -> float:
    """Variance of the fixed position on its worst axis [m^2]."""
    return float(
        0.5 * (fixed.p_ee + fixed.p_nn) + math.sqrt(0.25 * (fixed.p_ee - fixed.p_nn) ** 2 + fixed.p_en * fixed.p_en)
    )


@jit
def report_drift(
    found: int, east: float, north: float, variance: float, speed: float, rules: Any, d: Any, anchors: Records,
    jump: Any,
) -> None:  # fmt: skip
    """Hand a drift of RTK at (east, north) [m] since the anchor ``found`` to the jump monitor.

    Where the odometer explains it, its scale is learnt anew from the prior.
    """
    along, across, sin_u, cos_u = misfit(east, north, d, anchors[found])
    jump.drifts, jump.drift_speed = True, abs(speed)
    jump.drift_e, jump.drift_n = along * sin_u + across * cos_u, along * cos_u - across * sin_u
    jump.rate_at, jump.rate_ct = rates_of(east, north, variance, speed, rules, d, anchors)
    jump.by_odometer = blames_odometer(east, north, variance, speed, rules, d, anchors[found])
    if jump.by_odometer:
        d.has_scale = False
