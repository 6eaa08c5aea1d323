"""Stage of the odometer's scale: windows between accepted RTK positions, and the estimate in use."""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.jump_kernel import is_suspicious
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Epoch
from lanebound.integrity.positioning.codes_kernel import FIXED
from lanebound.integrity.positioning.wheel_scale_kernel import (
    advance_window,
    close_window,
    forget_scale,
    oldest_of,
    open_window,
    scale_of,
)

__all__ = ["adopt_scale", "learn_scale"]


@jit(borrows=True)
def learn_scale(first: int, last: int, epoch: Epoch) -> None:
    """Advance the windows; a contradiction ends the estimate, and the backup solution that has run with it."""
    par = epoch.parameters[0]
    rules = par.odometer
    if not rules.estimated:
        return
    for v in range(first, last):
        vehicle, w, observed, windows = epoch.vehicles[v], epoch.work[v], epoch.observed[v], epoch.windows[v]
        s, levels = vehicle.wheels, epoch.fixed_levels[v]
        advance_window(par.dt, observed.speed, w.turning, observed.delta_v[0] / par.dt, rules.estimate, s)
        if vehicle.watch.doubted or is_suspicious(vehicle.jump):
            s.open = False
        elif w.accepted and w.fixed.status == FIXED and levels[0, 0] < math.inf:
            east, north = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
            if s.open and s.path >= rules.estimate.length:
                p_bias = vehicle.heading.p_bb
                if not close_window(east, north, levels, p_bias, epoch.tables.cases, rules, windows, s):
                    forget_scale(s)
                    vehicle.backup.age = math.inf
            if not s.open and observed.speed >= rules.estimate.min_speed:
                open_window(east, north, levels, windows, s)


@jit(borrows=True)
def adopt_scale(vehicle: Any, starts: Records, windows: Records, cases: Records, odometer: Any) -> None:
    """Use the estimate where its bound is below the one declared; starts (2, R), windows (W, R).

    Only where both dead reckonings restart: neither may have moved with another scale.
    """
    s, rules = vehicle.wheels, odometer.estimate
    if not s.fresh:
        return
    s.known, s.scale, s.fresh = False, 0.0, False
    for r in range(cases.shape[0]):
        scale, bound = scale_of(windows, s.count, r, cases[r], rules)
        starts[LATEST, r].scale = starts[BACKUP, r].scale = bound
        if r == 0 and bound + rules.drift * (s.time_s - oldest_of(windows, s.count)) < odometer.scale:
            s.known, s.scale, s.since_s = True, scale, oldest_of(windows, s.count)
