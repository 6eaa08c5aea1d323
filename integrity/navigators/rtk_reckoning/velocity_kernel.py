"""Velocity by the Doppler range rates, with fault detection and exclusion, and what each fault mode does to it."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, NO_REDUNDANCY, detect_and_exclude
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    AFFORDABLE,
    CENTRED,
    LOST,
    SUMS,
    centre_rows,
    find_satellite_influences,
    find_system_influences,
    forget_influence,
)
from lanebound.integrity.monitoring.heading_separation_kernel import state_of
from lanebound.integrity.monitoring.jump_kernel import suspects_signals
from lanebound.integrity.navigators.rtk_reckoning.carrier_velocity_kernel import bring_to_end, take_carriers
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import later_by
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Array, Epoch, Tables
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import UNUSED, is_strong, weigh

__all__ = ["find_velocity"]


@jit
def find_velocity(first: int, last: int, epoch: Epoch) -> None:
    """Velocity and clock drift by least squares of the range rates (df = m - 4), which may be used when ``checked``."""
    par, tables = epoch.parameters[0], epoch.tables
    satellites, n = tables.satellites, tables.satellites.shape[0]
    rows, centred, sums = np.zeros(n, ROW), np.zeros(n, CENTRED), np.zeros(MAX_GROUPS + 1, SUMS)
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        _fill_rows(epoch.signals[v], satellites, par, epoch.marks[v], rows)
        w.by_carriers = par.doppler.carriers and take_carriers(v, epoch, rows)
        if par.doppler.carriers and not w.by_carriers:  # their tests have filled the rows
            _fill_rows(epoch.signals[v], satellites, par, epoch.marks[v], rows)
        outcome, _, _, _, w.excluded_doppler = detect_and_exclude(
            rows, vehicle.heading.angle, tables.thresholds, par.fde, w.velocity, w.q
        )
        w.hdop_doppler = hdop_of(rows)
        if w.by_carriers:
            bring_to_end(epoch.observed[v], w)
        # Without redundancy there is no test: the level of the velocity then rests on the priors alone.
        w.solved = outcome <= EXCLUDED or outcome == NO_REDUNDANCY
        _judge(rows, tables, par, vehicle, w, epoch.faults[v], centred, sums)


@jit(borrows=True)
def _fill_rows(signals: Records, satellites: Records, par: Any, marks: Records, rows: Records) -> None:
    """A row of each satellite, in use where its signal is strong; all have one clock."""
    weigh(signals, par.rtk.cn0_knee, marks)
    for s in range(rows.shape[0]):
        row, signal = rows[s], signals[s]
        row.group, row.system, row.y = 0, satellites[s].system, signal.range_rate
        row.used = is_strong(signal, par.doppler.sin_mask, par.doppler.cn0_min)
        row.variance = (marks[s].quality if row.used else UNUSED) * par.doppler.sigma**2
        for k in range(3):
            row.e[k] = signal.e[k]


@jit(borrows=True)
def _judge(
    rows: Records, tables: Tables, par: Any, vehicle: Any, w: Any, faults: Records, centred: Records, sums: Records
) -> None:
    """What each fault mode does to the velocity, and whether it may be used."""
    w.satellites_doppler = 0
    for s in range(rows.shape[0]):
        w.satellites_doppler += rows[s].used
    if w.solved:
        centre_rows(rows, w.velocity, centred, sums)
        find_satellite_influences(w.q, centred, sums, faults)
        find_system_influences(w.q, tables.satellites, tables.prior, par.risk.spendable, centred, sums, faults)
    else:
        for k in range(faults.shape[0]):
            forget_influence(faults[k].now)
    w.suspect = suspects_signals(vehicle.jump)
    w.later = later_by(vehicle.since_rtk, vehicle.memory_s, par.risk.fault_duration)
    # The priors of modes that no velocity can do without must leave enough of the risk for a level.
    spendable = AFFORDABLE * (tables.cases[0].budget[0] + tables.cases[0].budget[1])
    affordable = w.later * lost_prior(tables.prior, faults) <= spendable
    w.checked = w.solved and not w.suspect and (par.risk.published or affordable)


@jit(borrows=True)
def lost_prior(prior: Array, faults: Records) -> float:
    """Sum of the priors (M,) of modes that are LOST in velocity, position since the fix or heading."""
    total = 0.0
    for k in range(faults.shape[0]):
        fault = faults[k]
        if max(fault.now.state, fault.latest.state, state_of(fault.course)) == LOST:
            total += prior[k]
    return total
