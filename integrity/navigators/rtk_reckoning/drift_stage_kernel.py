"""Stage of the drift watch: RTK displacements against gyro and odometer, before the jump monitor judges RTK."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.jump_kernel import is_suspicious
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import heading_bias
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.drift_watch_kernel import advance, begin_watch, find_drift, learn, walk_of

__all__ = ["watch_drift"]


@jit
def watch_drift(first: int, last: int, epoch: Epoch) -> None:
    """Advance the windows while RTK positions follow one another; a drift becomes one of the jump monitor's state."""
    par, watch, measured = epoch.parameters[0], epoch.state.drift, epoch.measured
    if watch.anchors.shape[1] == 0:
        return
    rules = par.drift
    for v in range(first, last):
        vehicle, w, d, anchors = epoch.state.vehicles[v], epoch.work.vehicles[v], watch.rows[v], watch.anchors[v]
        fixed, speed, heading = w.fixed, measured.speed[v], vehicle.heading
        walk = walk_of(par.heading.angle_random_walk, heading.p_bb, heading.p_ss, w.turning, rules)
        advance(par.dt, par.dt * speed, w.slip, w.turning, w.resting, walk, rules, d)
        vehicle.jump.drifts = False
        followed = fixed.usable and fixed.lasting and not is_suspicious(vehicle.jump)
        if not followed or vehicle.watch.doubted or vehicle.unbounded:
            begin_watch(d)
            continue
        east, north = reference_point(fixed, par.lever, w.sin_h, w.cos_h)
        variance = fixed.p_ee + fixed.p_nn
        drifts, drift_e, drift_n = find_drift(east, north, variance, speed, rules, d, anchors)
        if drifts:
            vehicle.jump.drifts, vehicle.jump.drift_e, vehicle.jump.drift_n = True, drift_e, drift_n
            begin_watch(d)
            continue
        bias = heading_bias(vehicle, par.odometer)
        learn(east, north, variance, speed, heading.angle, heading.p_hh + bias * bias, rules, d, anchors)
