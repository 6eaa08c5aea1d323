"""Velocity by the Doppler range rates, with fault detection and exclusion, and what each fault mode does to it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, NO_REDUNDANCY, UNRESOLVED, detect_and_exclude
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
from lanebound.integrity.navigators.rtk_reckoning.attitude_kernel import side_slip
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import later_by
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Array, Epoch, Tables
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import BASES, UNUSED, is_strong, weigh

__all__ = ["find_velocity"]

CARRIERS = 6  # of a velocity: two more than unknowns, so that one can be found to be wrong and excluded
LEAST_SPEED_MPS = 0.5  # at which the velocity has a course; heading.min_speed_mps


@jit
def find_velocity(first: int, last: int, epoch: Epoch) -> None:
    """Velocity and clock drift by least squares of the range rates (df = m - 4), which may be used when ``checked``."""
    par, tables = epoch.parameters[0], epoch.tables
    satellites, n = tables.satellites, tables.satellites.shape[0]
    rows, centred, sums = np.zeros(n, ROW), np.zeros(n, CENTRED), np.zeros(MAX_GROUPS + 1, SUMS)
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        _fill_rows(epoch.signals[v], satellites, par, epoch.marks[v], rows)
        w.by_carriers = par.doppler.carriers and _take_carriers(v, epoch, rows)
        outcome, _, _, _, w.excluded_doppler = detect_and_exclude(
            rows, vehicle.heading.angle, tables.thresholds, par.fde, w.velocity, w.q
        )
        w.hdop_doppler = hdop_of(rows)
        if w.by_carriers:
            _end_of_epoch(epoch.observed[v], w)
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


@jit
def _take_carriers(v: int, epoch: Epoch, rows: Records) -> bool:
    """Replace the range rates by changes of carriers since the last epoch, if enough pass their tests; else nothing.

    The last phases are relative to the anchor of SLIP_WATCH. Errors of a carrier telescope: over any time they add up
    to those of two phases, of which independent errors in every epoch are a bound.
    """
    par, vehicle, w = epoch.parameters[0], epoch.vehicles[v], epoch.work[v]
    signals, ambiguities, marks, age = epoch.signals[v], epoch.ambiguities[v], epoch.marks[v], epoch.observed[v].age
    last = vehicle.rtk.slips
    for s in range(rows.shape[0]):
        if not (age < math.inf and last.age < math.inf and _is_followed(signals[s], ambiguities[s])):
            _begin_again(ambiguities[s])
    _advance_paths(vehicle, epoch.observed[v], par)
    consistent = True
    for b in range(BASES - 1, 0, -1):
        _fill_window(b, vehicle.bases[b], age, par, signals, marks, ambiguities, rows)
        outcome, _, _, _, _ = detect_and_exclude(
            rows, vehicle.heading.angle, epoch.tables.thresholds, par.doppler.fde, w.velocity, w.q
        )
        # Carriers that contradict each other without showing which ones are wrong give no velocity in this epoch.
        consistent = consistent and outcome != UNRESOLVED
        if outcome <= EXCLUDED:
            consistent = consistent and _agrees(vehicle, b, epoch.tables.thresholds.limits[1].local, w)
        for s in range(rows.shape[0]):
            # It has drifted against the others: a facade mirrors it, or a ray bends round an edge.
            if not rows[s].used and _is_tested(b, signals[s], ambiguities[s], par.doppler):
                _begin_again(ambiguities[s])
    count = 0
    for s in range(rows.shape[0]):
        count += _is_tested(1, signals[s], ambiguities[s], par.doppler)
    enough = consistent and count >= CARRIERS
    if enough:
        _fill_changes(last, age, par, signals, marks, ambiguities, rows)
    else:
        _fill_rows(signals, epoch.tables.satellites, par, marks, rows)
    _renew_bases(vehicle, age, par, signals, ambiguities)
    return enough


@jit
def _begin_again(ambiguity: Any) -> None:
    """A carrier has not been followed, or has drifted: a new window begins for it."""
    for b in range(BASES):
        ambiguity.bases[b] = 0.0


@jit
def _is_tested(b: int, signal: Any, ambiguity: Any, rules: Any) -> bool:
    """Whether a carrier takes part in the test over window b."""
    return bool(ambiguity.bases[b] != 0.0 and is_strong(signal, rules.sin_mask, rules.cn0_min))


@jit(borrows=True)
def _fill_window(
    b: int, base: Any, age: float, par: Any, signals: Records, marks: Records, ambiguities: Records, rows: Records
) -> None:  # fmt: skip
    """Rows of the displacement since a base: noise of two phases, however long ago it is."""
    drift = par.rtk.age_sigma * (age - base.age)
    for s in range(rows.shape[0]):
        row, signal = rows[s], signals[s]
        row.used, row.variance = _is_tested(b, signal, ambiguities[s], par.doppler), UNUSED
        if row.used:
            row.y = _relative_to(base.anchor, signal) - ambiguities[s].bases[b]
            row.variance = marks[s].quality * (par.doppler.carrier_sigma * par.dt) ** 2 + drift * drift


@jit(borrows=True)
def _fill_changes(
    last: Any, age: float, par: Any, signals: Records, marks: Records, ambiguities: Records, rows: Records
) -> None:
    """Rows of the mean velocity since the last epoch."""
    drift = par.rtk.age_sigma * (age - last.age) / par.dt
    for s in range(rows.shape[0]):
        row, signal = rows[s], signals[s]
        row.used, row.variance = _is_tested(1, signal, ambiguities[s], par.doppler), UNUSED
        if row.used:
            row.y = (_relative_to(last.anchor, signal) - ambiguities[s].last_phase[0]) / par.dt
            row.variance = marks[s].quality * par.doppler.carrier_sigma**2 + drift * drift


@jit(borrows=True)
def _advance_paths(vehicle: Any, observed: Any, par: Any) -> None:
    """Advance the displacements of the antenna by gyro and odometer since each base."""
    heading, lever = vehicle.heading, par.lever
    turning = observed.turn[2] * (1.0 - heading.gyro_scale) / par.dt - heading.gyro_bias
    before, after = heading.angle, heading.angle + turning * par.dt
    course, run = 0.5 * (before + after) + side_slip(lever.axle, turning, observed.speed), observed.speed * par.dt
    sine, cosine = math.sin(after) - math.sin(before), math.cos(after) - math.cos(before)
    for b in range(BASES):
        base = vehicle.bases[b]
        base.path_e += run * math.sin(course) + lever.forward * sine + lever.right * cosine
        base.path_n += run * math.cos(course) + lever.forward * cosine - lever.right * sine


@jit(borrows=True)
def _agrees(vehicle: Any, b: int, k: float, w: Any) -> bool:
    """Whether the displacement by carriers since a base goes where gyro and odometer do, within k sigma across.

    A facade may mirror all carriers of low satellites, on which the velocity across the street rests: they then agree
    with each other.
    """
    e, n = vehicle.bases[b].path_e, vehicle.bases[b].path_n
    across = n * w.velocity[0] - e * w.velocity[1]
    variance = n * n * w.q[0, 0] - 2.0 * n * e * w.q[0, 1] + e * e * w.q[1, 1]
    return bool(across * across <= k * k * (variance + (e * e + n * n) ** 2 * vehicle.heading.p_hh))


@jit(borrows=True)
def _renew_bases(vehicle: Any, age: float, par: Any, signals: Records, ambiguities: Records) -> None:
    """Once in a window the oldest base ends and this epoch becomes the newest."""
    vehicle.since_base += par.dt
    if vehicle.since_base < par.doppler.window - 0.5 * par.dt:
        return
    vehicle.since_base = 0.0
    for b in range(BASES - 1, 0, -1):
        vehicle.bases[b] = vehicle.bases[b - 1]
        for s in range(signals.shape[0]):
            ambiguities[s].bases[b] = ambiguities[s].bases[b - 1]
    newest = vehicle.bases[0]
    newest.age, newest.path_e, newest.path_n = age, 0.0, 0.0
    for k in range(3):
        newest.anchor[k] = vehicle.position[k]
    for s in range(signals.shape[0]):
        locked = age < math.inf and signals[s].tracked and signals[s].phase[0] != 0.0
        ambiguities[s].bases[0] = _relative_to(newest.anchor, signals[s]) if locked else 0.0


@jit(borrows=True)
def _relative_to(anchor: Array, signal: Any) -> float:
    """The first phase relative to a point near the vehicle, so that turning lines of sight leave little [m]."""
    return float(signal.phase[0] + signal.e[0] * anchor[0] + signal.e[1] * anchor[1] + signal.e[2] * anchor[2])


@jit
def _is_followed(signal: Any, ambiguity: Any) -> bool:
    """Whether a carrier has been locked since the last epoch."""
    return bool(signal.phase[0] != 0.0 and ambiguity.last_phase[0] != 0.0 and not signal.lock_lost)


@jit
def _end_of_epoch(observed: Any, w: Any) -> None:
    """Keep the mean velocity of the epoch, and turn and stretch it by gyro and accelerometer to that at its end."""
    w.mean_e, w.mean_n = w.velocity[0], w.velocity[1]
    speed, half = math.hypot(w.mean_e, w.mean_n), 0.5 * observed.turn[2]
    if speed > LEAST_SPEED_MPS:
        forward = math.copysign(
            1.0, observed.speed
        )  # the force is along the body, the velocity of a reversing car is not
        stretch = max(1.0 + 0.5 * forward * observed.delta_v[0] / speed, 0.0)
        w.velocity[0] = stretch * (math.cos(half) * w.mean_e + math.sin(half) * w.mean_n)
        w.velocity[1] = stretch * (math.cos(half) * w.mean_n - math.sin(half) * w.mean_e)


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
