"""Stage 1: velocity from the Doppler range rates, with fault detection and exclusion, and its separations."""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, NO_REDUNDANCY, detect_and_exclude
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    AFFORDABLE,
    centre_rows,
    centred_scratch,
    clear_modes,
    exposure,
    find_satellite_influences,
    find_system_influences,
    influences_of,
    separations_of,
)
from lanebound.integrity.monitoring.heading_separation_kernel import courses_of, raise_states
from lanebound.integrity.monitoring.jump_kernel import begin_epoch, suspects_signals
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import later_by
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.rows_kernel import Rows
from lanebound.integrity.positioning.rtk_kernel import select, weigh

__all__ = ["find_velocity"]


@jit
def find_velocity(first: int, last: int, epoch: Epoch) -> None:
    """Velocity and clock drift by least squares of the range rates (df = m - 4), which may be used when ``checked``."""
    par, state, measured, work = epoch.parameters[0], epoch.state, epoch.measured, epoch.work
    satellites, thresholds, operative = epoch.tables.satellites, epoch.tables.thresholds, epoch.tables.cases[0]
    n = satellites.shape[0]
    clock, variance, used = np.zeros(n, dtype=np.int64), np.empty(n), np.empty(n, dtype=np.bool_)
    system, prior, centred = epoch.tables.system, epoch.tables.prior, centred_scratch(n)
    modes = np.empty(prior.size)
    for v in range(first, last):
        vehicle, w, los = state.vehicles[v], work.vehicles[v], measured.los[measured.sight[v]]
        epoch.out.levels[v, :, :] = math.inf
        begin_epoch(par.dt, vehicle.jump)
        w.suspect = suspects_signals(vehicle.jump)
        vehicle.since_rtk += par.dt
        vehicle.since_calibration += par.dt
        vehicle.backup.age += par.dt
        tracked, cn0, quality = measured.tracked[v], measured.cn0[v], work.quality[v]
        weigh(los, tracked, cn0, par.rtk.cn0_knee, quality)
        select(los, tracked, cn0, quality, par.doppler.sin_mask, par.doppler.cn0_min, variance, used)
        for s in range(n):
            variance[s] *= par.doppler.sigma**2
        rows = Rows(los, clock, variance, measured.range_rate[v], used)
        outcome, _, _, _, w.excluded_doppler = detect_and_exclude(
            rows, system, vehicle.heading.angle, thresholds, par.fde, w.velocity, w.q
        )
        w.satellites_doppler = 0
        for s in range(n):
            w.satellites_doppler += used[s]
        w.hdop_doppler = hdop_of(los, clock, used)
        w.solved = outcome <= EXCLUDED or outcome == NO_REDUNDANCY
        influences = influences_of(state.influences, v)
        if w.solved:
            centre_rows(rows, w.velocity, centred)
            find_satellite_influences(w.q, centred, influences)
            find_system_influences(w.q, system, prior, par.risk.spendable, centred, influences)
        else:
            clear_modes(influences)
        raise_states(influences, separations_of(state.latest, v), courses_of(state.courses, v), modes)
        _, _, lost = exposure(prior, modes)
        w.later = later_by(vehicle.since_rtk, vehicle.memory_s, par.risk.fault_duration)
        affordable = w.later * lost <= AFFORDABLE * (operative.budget[0] + operative.budget[1])
        w.checked = w.solved and not w.suspect and (par.risk.published or affordable)
