"""Stages of the monitors: Doppler separation, odometer watch, and the jump monitor with its backup solution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    IDLE,
    advance_separation,
    fade_separation,
    forget_influence,
    trapezoid,
)
from lanebound.integrity.monitoring.heading_separation_kernel import advance_course, advance_spread, move_by_course
from lanebound.integrity.monitoring.jump_kernel import (
    ACCEPTED,
    QUARANTINED,
    REFUSED,
    along_across,
    bounded,
    contradicts,
    is_suspicious,
    judge_jump,
    widen,
)
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import later_by, levels_since_fix
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Array, Epoch, Tables
from lanebound.integrity.positioning.codes_kernel import FAULT
from lanebound.integrity.positioning.odometer_watch_kernel import watch_odometer

__all__ = ["judge_fix", "separate_doppler", "watch_speeds", "widen_levels"]

CONFLICT_LIMIT_S = 0.5  # of contradiction between Doppler and odometer


@jit(borrows=True)
def separate_doppler(first: int, last: int, epoch: Epoch) -> None:
    """Advance the separations of both dead reckonings and of the heading; this epoch's influences become the last."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w, turn, faults = epoch.vehicles[v], epoch.work[v], epoch.work[v].step.turn, epoch.faults[v]
        across_e, across_n, runs = math.cos(w.middle), -math.sin(w.middle), (w.run, w.run + w.backup_run)
        had = vehicle.has_velocity and not w.by_carriers
        decay, white = (0.0, 0.0) if w.by_carriers else (par.doppler.decay, par.doppler.white)
        t = trapezoid(par.dt, had, decay, white)
        largest = 0.0
        for k in range(faults.shape[0]):
            if is_idle(faults[k]):
                continue
            largest = max(largest, advance_course(turn, faults[k].now, faults[k].course))
            separate(t, across_e, across_n, runs, vehicle, w, faults[k])
        course = 1.0 if w.by_carriers else par.doppler.course
        advance_spread(turn, course * largest, across_e, across_n, runs, vehicle.spread, vehicle.growth)
        vehicle.growth[LATEST].apart_s = t.now if w.integrates else 0.0
        vehicle.growth[BACKUP].apart_s = t.now if w.integrates and not w.by_carriers else 0.0
        vehicle.separated = vehicle.separated or w.integrates or w.run != 0.0


@jit(borrows=True)
def is_idle(fault: Any) -> bool:
    """Whether nothing that a fault mode could have done is left in velocity, heading or position."""
    if fault.now.state != IDLE or fault.last.state != IDLE or fault.course.used != 0.0:
        return False
    return bool(fault.latest.state == IDLE and fault.backup.state == IDLE)


@jit(borrows=True)
def separate(
    t: Any, across_e: float, across_n: float, runs: tuple[float, float], vehicle: Any, w: Any, fault: Any
) -> None:  # fmt: skip
    """Advance the separations of one fault mode; ``t`` integrates velocities.

    Doppler's separations grow where its velocity moved the position; the others fade. Those of the heading grow where
    the position moved along it: ``runs`` of LATEST and BACKUP [m], ``across`` the direction to the right of them.
    """
    if w.integrates:
        advance_separation(t, vehicle.growth[LATEST].apart_s, fault.last, fault.now, fault.latest)
    else:
        fade_separation(t.phi, fault.latest)
    if w.integrates and not w.by_carriers:
        advance_separation(t, vehicle.growth[BACKUP].apart_s, fault.last, fault.now, fault.backup)
    else:
        fade_separation(t.phi, fault.backup)
    if runs[LATEST] != 0.0:
        move_by_course(runs[LATEST] * across_e, runs[LATEST] * across_n, fault.course, fault.latest)
    if runs[BACKUP] != 0.0:
        move_by_course(runs[BACKUP] * across_e, runs[BACKUP] * across_n, fault.course, fault.backup)
    if w.doppler_moves:
        fault.last = fault.now
    else:
        forget_influence(fault.last)


@jit(borrows=True)
def watch_speeds(first: int, last: int, epoch: Epoch) -> None:
    """Odometer watch: while the odometer is doubted, or Doppler has contradicted it, no level holds without RTK."""
    par = epoch.parameters[0]
    limits = par.heading.calibration
    for v in range(first, last):
        vehicle, w, observed = epoch.vehicles[v], epoch.work[v], epoch.observed[v]
        speed = observed.speed
        gap, tested = abs(w.v_gnss - abs(speed)), w.solved and w.hdop_doppler < limits.max_hdop
        vehicle.conflict_s = vehicle.conflict_s + par.dt if tested and gap > limits.speed_agreement else 0.0
        conflict, agrees = vehicle.conflict_s > CONFLICT_LIMIT_S, tested and gap < par.modes.doppler_agreement
        forward, lateral = observed.delta_v[0], observed.delta_v[1]
        if watch_odometer(
            par.dt, speed, forward, lateral, w.turning, conflict, agrees, par.odometer.watch, vehicle.watch
        ):
            vehicle.unbounded = True
        if vehicle.unbounded:
            vehicle.backup.age = math.inf


@jit
def judge_fix(first: int, last: int, epoch: Epoch) -> None:
    """Jump monitor: accept a confirmed RTK position, refuse it, or wait."""
    of_backup = np.empty(epoch.levels.shape[1:])
    for v in range(first, last):
        _judge(v, epoch, of_backup)


@jit(borrows=True)
def _judge(v: int, epoch: Epoch, of_backup: Array) -> None:
    """:func:`judge_fix` for vehicle v; of_backup (R, 2) is scratch."""
    par, vehicle, w, levels = epoch.parameters[0], epoch.vehicles[v], epoch.work[v], epoch.levels[v]
    w.accepted = False
    if not w.fixed.usable:  # not confirmed, or of poor geometry: dead reckoning goes on with its own level
        return
    found, faults = epoch.fixed_levels[v], epoch.faults[v]
    # RTK has set the position since its first fix, or carriers of the same signals have moved it: if that was wrong, so
    # is the position.
    if w.fixed.lasting or par.doppler.carriers:
        _use_backup(vehicle, epoch.starts[v], faults, epoch.tables, par, w, found, levels, of_backup)
    verdict = judge_position(vehicle, par, w, levels, found)
    w.accepted = verdict == ACCEPTED
    if not w.accepted:
        w.fixed.status = FAULT
    if verdict == REFUSED:  # its integers are not believed any more: they are sought anew
        vehicle.fixed_s = 0.0
        ambiguities = epoch.ambiguities[v]
        for s in range(ambiguities.shape[0]):
            ambiguities[s].held = False


@jit(borrows=True)
def judge_position(vehicle: Any, par: Any, w: Any, expected: Array, found: Array) -> int:
    """ACCEPTED, REFUSED or QUARANTINED: a confirmed RTK position and the one expected; levels of both (R, 2) [m].

    An RTK position without a level does not replace a position that has one.
    """
    if bounded(expected[0]) and not bounded(found[0]):
        return QUARANTINED
    if not vehicle.initialised:  # there is nothing to compare the first position with
        return ACCEPTED
    east, north = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
    conflict = vehicle.conflict_s > CONFLICT_LIMIT_S or vehicle.jump.drifts
    verdict = judge_jump(
        east - vehicle.position[0], north - vehicle.position[1], w.sin_h, w.cos_h, expected[0], found[0],
        w.fixed.lasting, conflict, par.jump.after_jump, par.jump.after_outage, vehicle.jump,
    )  # fmt: skip
    return int(verdict)


@jit
def reference_point(fixed: Any, lever: Any, sin_h: float, cos_h: float) -> tuple[float, float]:
    """East and North of the vehicle's reference point from the fixed position of its antenna [m]."""
    east = fixed.position[0] - sin_h * lever.forward - cos_h * lever.right
    return east, fixed.position[1] - cos_h * lever.forward + sin_h * lever.right


@jit(inline=True)
def _use_backup(
    vehicle: Any, starts: Records, faults: Any, tables: Tables, par: Any, w: Any, found: Array, pl: Array,
    levels: Array,
) -> None:  # fmt: skip
    """Return to the backup solution where it or the drift watch contradicts an RTK position that lasts.

    ``found`` (R, 2) are the levels of RTK; ``pl`` (R, 2) become those of the backup solution, if it is used [m], which
    ``levels`` (R, 2) are for.
    """
    backup, sin_h, cos_h = vehicle.backup, w.sin_h, w.cos_h
    east, north = reference_point(w.fixed, par.lever, sin_h, cos_h)
    east, north = east - backup.position[0], north - backup.position[1]
    at, ct = along_across(east, north, sin_h, cos_h)
    known = backup.age < math.inf and vehicle.since_calibration < math.inf
    # Within the levels of RTK the backup says nothing new, and without a level of its own it refutes nothing.
    if not (known and (vehicle.jump.drifts or at > found[0, 0] or ct > found[0, 1])):
        return
    later = later_by(backup.age, vehicle.memory_s, par.risk.fault_duration)
    growth, separations = vehicle.growth[BACKUP], faults.backup
    levels_since_fix(growth, starts[BACKUP], separations, tables, par.risk, sin_h, cos_h, later, levels)
    if vehicle.jump.drifts or contradicts(east, north, sin_h, cos_h, levels[0], found[0]):
        vehicle.position[0], vehicle.position[1] = backup.position[0], backup.position[1]
        vehicle.since_rtk, vehicle.separated = backup.age, True
        for r in range(pl.shape[0]):
            pl[r, 0], pl[r, 1] = levels[r, 0], levels[r, 1]
        copy_reckoning(BACKUP, LATEST, vehicle, starts, faults)


@jit
def copy_reckoning(source: int, to: int, vehicle: Any, starts: Records, faults: Records) -> None:
    """Copy one dead reckoning of a vehicle over the other; starts (2, R)."""
    vehicle.growth[to] = vehicle.growth[source]
    for r in range(starts.shape[1]):
        starts[to, r] = starts[source, r]
    for k in range(faults.shape[0]):
        if source == LATEST:
            faults[k].backup = faults[k].latest
        else:
            faults[k].latest = faults[k].backup


@jit(borrows=True)
def widen_levels(first: int, last: int, epoch: Epoch) -> None:
    """Jump monitor: while RTK contradicts the position, the levels cover RTK's history too."""
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if is_suspicious(vehicle.jump):
            widen(w.sin_h, w.cos_h, epoch.fixed_levels[v], vehicle.jump, epoch.levels[v])
