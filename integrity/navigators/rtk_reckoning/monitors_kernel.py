"""Stages of the monitors: Doppler separation, odometer watch, and the jump monitor with its backup solution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    Separations,
    advance_separations,
    clear_modes,
    copy_modes,
    fade_separations,
    influences_of,
    separations_of,
    trapezoid,
)
from lanebound.integrity.monitoring.heading_separation_kernel import (
    advance_courses,
    advance_spread,
    courses_of,
    move_by_courses,
)
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
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import (
    DeadReckoningState,
    later_by,
    levels_since_fix,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Array, Epoch, State, Tables
from lanebound.integrity.positioning.codes_kernel import FAULT
from lanebound.integrity.positioning.odometer_watch_kernel import watch_odometer

__all__ = ["judge_fix", "separate_doppler", "watch_speeds", "widen_levels"]

CONFLICT_LIMIT_S = 0.5  # of contradiction between Doppler and odometer


@jit(borrows=True)
def separate_doppler(first: int, last: int, epoch: Epoch) -> None:
    """Advance the separations of both dead reckonings and of the heading; this epoch's influences become the last."""
    par, state, vehicles = epoch.parameters[0], epoch.state, epoch.work.vehicles
    for v in range(first, last):
        vehicle, w, turn = state.vehicles[v], vehicles[v], vehicles[v].step.turn
        before, now = influences_of(state.last_influences, v), influences_of(state.influences, v)
        courses, growth = courses_of(state.courses, v), state.growth[v]
        across_e, across_n = w.run * math.cos(w.middle), -w.run * math.sin(w.middle)
        largest = advance_courses(turn, now, courses)
        advance_spread(turn, par.doppler.course * largest, across_e, across_n, vehicle.spread, growth)
        t = trapezoid(par.dt, vehicle.has_velocity, par.doppler.decay, par.doppler.white)
        for reckoning in range(growth.shape[0]):
            g, s = growth[reckoning], _separations_of(state, v, reckoning)
            if w.integrates:
                advance_separations(t, g.apart_s, before, now, s)
            else:
                fade_separations(t.phi, s)
            if w.run != 0.0:
                move_by_courses(across_e, across_n, courses, s)
            g.apart_s = t.now if w.integrates else 0.0
        if w.measured:
            copy_modes(now, before)
        else:
            clear_modes(before)
        vehicle.separated = vehicle.separated or w.integrates or w.run != 0.0


@jit(inline=True)
def _separations_of(state: State, v: int, reckoning: int) -> Separations:
    """The separations (W,) of the LATEST or BACKUP dead reckoning."""
    found: Separations = separations_of(state.latest if reckoning == LATEST else state.backup, v)
    return found


@jit(borrows=True)
def watch_speeds(first: int, last: int, epoch: Epoch) -> None:
    """Odometer watch: while the odometer is doubted, or Doppler has contradicted it, no level holds without RTK."""
    par, measured = epoch.parameters[0], epoch.measured
    limits = par.heading.calibration
    for v in range(first, last):
        vehicle, w, speed = epoch.state.vehicles[v], epoch.work.vehicles[v], measured.speed[v]
        gap, tested = abs(w.v_gnss - abs(speed)), w.solved and w.hdop_doppler < limits.max_hdop
        vehicle.conflict_s = vehicle.conflict_s + par.dt if tested and gap > limits.speed_agreement else 0.0
        conflict, agrees = vehicle.conflict_s > CONFLICT_LIMIT_S, tested and gap < par.modes.doppler_agreement
        forward, lateral = measured.delta_v[v, 0], measured.delta_v[v, 1]
        if watch_odometer(
            par.dt, speed, forward, lateral, w.turning, conflict, agrees, par.odometer.watch, vehicle.watch
        ):
            vehicle.unbounded = True
        if vehicle.unbounded:
            vehicle.backup.age = math.inf


@jit
def judge_fix(first: int, last: int, epoch: Epoch) -> None:
    """Jump monitor: accept a confirmed RTK position, refuse it, or wait."""
    par, state, out, tables = epoch.parameters[0], epoch.state, epoch.out, epoch.tables
    for v in range(first, last):
        vehicle, w, fixed_levels = state.vehicles[v], epoch.work.vehicles[v], epoch.work.fixed_levels[v]
        w.accepted = False
        if not w.fixed.usable:
            continue
        if w.fixed.lasting:
            _use_backup(v, state, tables, par, w, fixed_levels, out.levels[v])
        verdict = judge_position(vehicle, par, w, out.levels[v], fixed_levels)
        w.accepted = verdict == ACCEPTED
        if not w.accepted:
            w.fixed.status = FAULT
        if verdict == REFUSED:
            vehicle.fixed_s = 0.0
            ambiguities = state.ambiguities[v]
            for s in range(ambiguities.shape[0]):
                ambiguities[s].held = False


@jit(borrows=True)
def judge_position(vehicle: Any, par: Any, w: Any, expected: Array, found: Array) -> int:
    """ACCEPTED, REFUSED or QUARANTINED: a confirmed RTK position beside the one expected; levels of both (R, 2) [m].

    An RTK position without a level does not replace a position that has one.
    """
    if bounded(expected[0]) and not bounded(found[0]):
        return QUARANTINED
    if not vehicle.initialised:
        return ACCEPTED
    east, north = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
    conflict = vehicle.conflict_s > CONFLICT_LIMIT_S or vehicle.jump.drifts
    verdict = judge_jump(
        east - vehicle.position[0], north - vehicle.position[1], w.sin_h, w.cos_h, expected[0], found[0],
        w.fixed.lasting, conflict, par.jump.after_jump, par.jump.after_outage, vehicle.jump,
    )  # fmt: skip
    return int(verdict)


@jit(borrows=True)
def reference_point(fixed: Any, lever: Any, sin_h: float, cos_h: float) -> tuple[float, float]:
    """East and North of the vehicle's reference point from the fixed position of its antenna [m]."""
    east = fixed.position[0] - sin_h * lever.forward - cos_h * lever.right
    return east, fixed.position[1] - cos_h * lever.forward + sin_h * lever.right


@jit
def _use_backup(v: int, state: State, tables: Tables, par: Any, w: Any, found: Array, pl: Array) -> None:
    """Return to the backup solution where it or the drift watch contradicts an RTK position that lasts.

    ``found`` (R, 2) are the levels of RTK; ``pl`` (R, 2) become those of the backup solution, if it is used [m].
    """
    vehicle = state.vehicles[v]
    backup, sin_h, cos_h = vehicle.backup, w.sin_h, w.cos_h
    east, north = reference_point(w.fixed, par.lever, sin_h, cos_h)
    east, north = east - backup.position[0], north - backup.position[1]
    at, ct = along_across(east, north, sin_h, cos_h)
    known = backup.age < math.inf and vehicle.since_calibration < math.inf
    if not (known and (vehicle.jump.drifts or at > found[0, 0] or ct > found[0, 1])):
        return
    reckoning = DeadReckoningState(state.growth[v, BACKUP], state.starts[v, BACKUP], separations_of(state.backup, v))
    levels, later = np.empty_like(pl), later_by(backup.age, vehicle.memory_s, par.risk.fault_duration)
    levels_since_fix(reckoning, tables, par.risk, sin_h, cos_h, later, levels)
    if vehicle.jump.drifts or contradicts(east, north, sin_h, cos_h, levels[0], found[0]):
        vehicle.position[0], vehicle.position[1] = backup.position[0], backup.position[1]
        vehicle.since_rtk, vehicle.separated = backup.age, True
        pl[:] = levels
        copy_reckoning(v, state, BACKUP, LATEST)


@jit(borrows=True)
def copy_reckoning(v: int, state: State, source: int, to: int) -> None:
    """Copy one dead reckoning of vehicle v over the other."""
    state.growth[v, to] = state.growth[v, source]
    for r in range(state.starts.shape[2]):
        state.starts[v, to, r] = state.starts[v, source, r]
    copy_modes(_separations_of(state, v, source), _separations_of(state, v, to))


@jit(borrows=True)
def widen_levels(first: int, last: int, epoch: Epoch) -> None:
    """Jump monitor: while RTK contradicts the position, the levels cover RTK's history too."""
    for v in range(first, last):
        vehicle, w = epoch.state.vehicles[v], epoch.work.vehicles[v]
        if is_suspicious(vehicle.jump):
            widen(w.sin_h, w.cos_h, epoch.work.fixed_levels[v], vehicle.jump, epoch.out.levels[v])
