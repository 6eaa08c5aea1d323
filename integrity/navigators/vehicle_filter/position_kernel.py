"""Correction by the GNSS position: its slow error, the gate, and what follows when positions fail it for long."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.vehicle_filter.records_kernel import (
    BIASES,
    COMMON,
    GNSS,
    GNSS_EAST_BIAS,
    GNSS_NORTH_BIAS,
    FilterState,
    PositionFix,
)
from lanebound.integrity.positioning.filters.correction_kernel import Models, Vector, best_nis, cleared, observe
from lanebound.integrity.positioning.filters.vehicle_states_kernel import (
    EAST,
    GNSS_EAST,
    GNSS_NORTH,
    HEADING,
    NORTH,
    STATES,
)

__all__ = ["USED", "correct_by_position", "fill_slow_columns", "take_slow_error"]

Array = NDArray[np.float64]
EPS_S = 1e-9
NUMERIC_M2 = 1e-4  # keeps the innovation of a position regular
NONE, USED, REJECTED, LOST = range(4)
"""Outcomes: no position was due, it was used, it was rejected, or the filter has begun to doubt itself."""


@jit
def correct_by_position(
    par: Any,
    state: FilterState,
    v: int,
    distance: float,
    fix: PositionFix,
    models: Models,
    w: Vector,
    nis: Array,
) -> int:
    """The GNSS position, when it is due, after a distance driven in this epoch; returns the outcome."""
    vehicle = state.vehicles[v]
    vehicle.fix_age += par.dt
    vehicle.used_age += par.dt
    vehicle.moved += abs(distance)
    if not (fix.vehicles[v].valid and vehicle.known):
        return NONE
    resting = vehicle.moved < par.least_move
    if vehicle.fix_age < (max(par.interval, par.rest_interval) if resting else par.interval) - EPS_S:
        return NONE
    if par.sensor_errors:
        take_slow_error(par, state, v, fix)
    _position_vector(par, state, v, fix, w, par.rest_factor if resting else par.fast_factor)
    outcome = NONE
    if vehicle.rejected[GNSS] >= par.lost:
        _doubt(par, vehicle, models, w)
        outcome = LOST
    else:
        _grow_noise(par, vehicle, models, w)
        nis[GNSS], used = observe(models, w, 2, par.gate_gnss, False)
        outcome = USED if used else REJECTED
    since = vehicle.fix_age if vehicle.fix_age < math.inf else par.interval
    if outcome == REJECTED:
        vehicle.rejected[GNSS] += min(since, 2.0 * par.interval)
    else:
        vehicle.rejected[GNSS] = 0.0
    vehicle.fix_age = vehicle.moved = 0.0
    if outcome == USED:
        vehicle.used_age = 0.0
    return outcome


@jit
def _position_vector(par: Any, state: FilterState, v: int, fix: PositionFix, w: Vector, lasting: float) -> None:
    """The position of the antenna, brought to the reference point; its slow error is a state.

    lasting : variance factor of its fast errors
    """
    heading, found = 0.0, fix.vehicles[v]
    for j in range(state.models.shape[1]):
        heading += state.probability[v, j] * state.models[v, j].x[HEADING]
    s, c = math.sin(heading), math.cos(heading)
    row, errors = cleared(w), w.errors
    row.z[0] = found.position[0] - (s * par.forward + c * par.right)
    row.z[1] = found.position[1] - (c * par.forward - s * par.right)
    row.h[0, EAST] = row.h[1, NORTH] = errors[0, GNSS_EAST_BIAS] = errors[1, GNSS_NORTH_BIAS] = 1.0
    for i in range(2):
        for j in range(2):
            row.single[i, j] = found.fast[i, j] + (NUMERIC_M2 if i == j else 0.0)
            if par.sensor_errors:
                row.r[i, j] = row.single[i, j] * lasting
            else:
                row.single[i, j] += found.slow[i, j]
                row.r[i, j] = row.single[i, j]
    if par.sensor_errors:
        row.h[0, GNSS_EAST] = row.h[1, GNSS_NORTH] = 1.0
        fill_slow_columns(fix, v, errors)


@jit
def fill_slow_columns(fix: PositionFix, v: int, errors: Array) -> None:
    """Change of the position E, N per sigma of each slow error into the columns after those of biases [m]."""
    for i in range(2):
        for k in range(COMMON):
            errors[i, BIASES + k] = fix.vehicles[v].common[i, k]
    for k in range(fix.satellites.shape[1]):
        satellite = fix.satellites[v, k]
        sigma = math.sqrt(satellite.own)
        for i in range(2):
            errors[i, BIASES + COMMON + k] = satellite.gain[i] * sigma


@jit
def _grow_noise(par: Any, vehicle: Any, models: Models, w: Vector) -> None:
    """``R <- R max(1, m)``, with m the fading mean of NIS / 2 of all positions, whose expectation is 1.

    In a street the reflections that the residuals of codes do not show last. The gate rejects those positions that
    differ most, and those that agree with an error of the filter pass. Rejected positions therefore count in the noise
    of the next ones.
    """
    if par.excess_tau <= 0.0:
        return
    since = vehicle.fix_age if vehicle.fix_age < math.inf else par.interval
    kept = math.exp(-since / par.excess_tau)
    row = w.row[0]
    nis = best_nis(models.filters, row, 2, False)
    if not math.isfinite(nis):
        return
    vehicle.excess = kept * vehicle.excess + (1.0 - kept) * 0.5 * nis
    if vehicle.excess > 1.0:
        row.r[:] *= vehicle.excess


@jit
def _doubt(par: Any, vehicle: Any, models: Models, w: Vector) -> None:
    """The levels hold the distance to the rejected position for some time: either it or the filter is wrong by that."""
    row = w.row[0]
    for j in range(models.filters.shape[0]):
        total = 0.0
        for i in range(2):
            expected = 0.0
            for k in range(STATES):
                expected += row.h[i, k] * models.filters[j].x[k]
            total += (row.z[i] - expected) ** 2
        vehicle.doubt = max(vehicle.doubt, math.sqrt(total))
    vehicle.doubt_left = par.doubt


@jit
def take_slow_error(par: Any, state: FilterState, v: int, fix: PositionFix) -> None:
    """Bring the slow error of GNSS positions to the satellites of this fix.

    The error is ``K e`` of the satellites' own and common slow errors e with the gains K of the position. From one fix
    to the next it is ``A`` times the old one plus an independent part: ``A = K' C K_0' (K_0 V K_0')^-1`` with ``C = a
    V`` the covariance of e then and now. The first fix gives the prior.
    """
    vehicle = state.vehicles[v]
    if vehicle.biased:
        decay = math.exp(-vehicle.fix_age / par.slow_tau)
        _turn_error(state, v, fix, decay)
    else:
        for j in range(state.models.shape[1]):
            for i in range(2):
                for k in range(2):
                    state.models[v, j].p[GNSS_EAST + i, GNSS_EAST + k] = fix.vehicles[v].slow[i, k]
    vehicle.biased = True
    vehicle.common[:] = fix.vehicles[v].common
    state.satellites[v] = fix.satellites[v]


@jit
def _turn_error(state: FilterState, v: int, fix: PositionFix, decay: float) -> None:
    """``g <- A g + w`` of the slow error g, with the variance of w that keeps it stationary."""
    c00, c01, c10, c11 = 0.0, 0.0, 0.0, 0.0  # of the errors now and then
    o00, o01, o11 = 0.0, 0.0, 0.0  # of the errors then
    for k in range(fix.satellites.shape[1]):
        before, now = state.satellites[v, k], fix.satellites[v, k]
        was = before.own
        if was == 0.0:
            continue  # a new satellite
        e, n = before.gain[0], before.gain[1]
        o00 += was * e * e
        o01 += was * e * n
        o11 += was * n * n
        both = math.sqrt(now.own * was)  # 0 where a satellite is gone
        c00 += now.gain[0] * both * e
        c01 += now.gain[0] * both * n
        c10 += now.gain[1] * both * e
        c11 += now.gain[1] * both * n
    old, new, slow = state.vehicles[v].common, fix.vehicles[v].common, fix.vehicles[v].slow
    for k in range(COMMON):
        e, n, e_now, n_now = old[0, k], old[1, k], new[0, k], new[1, k]
        o00 += e * e
        o01 += e * n
        o11 += n * n
        c00 += e_now * e
        c01 += e_now * n
        c10 += n_now * e
        c11 += n_now * n
    d00, d11 = o00 + EPS_S, o11 + EPS_S
    det = d00 * d11 - o01 * o01
    a00, a01 = decay * (c00 * d11 - c01 * o01) / det, decay * (c01 * d00 - c00 * o01) / det
    a10, a11 = decay * (c10 * d11 - c11 * o01) / det, decay * (c11 * d00 - c10 * o01) / det
    g00 = slow[0, 0] - (a00 * (a00 * o00 + a01 * o01) + a01 * (a00 * o01 + a01 * o11))
    g01 = slow[0, 1] - (a00 * (a10 * o00 + a11 * o01) + a01 * (a10 * o01 + a11 * o11))
    g11 = slow[1, 1] - (a10 * (a10 * o00 + a11 * o01) + a11 * (a10 * o01 + a11 * o11))
    for j in range(state.models.shape[1]):
        x, p, influence = state.models[v, j].x, state.models[v, j].p, state.influence[v, j]
        x[GNSS_EAST], x[GNSS_NORTH] = (
            a00 * x[GNSS_EAST] + a01 * x[GNSS_NORTH], a10 * x[GNSS_EAST] + a11 * x[GNSS_NORTH],
        )  # fmt: skip
        for k in range(STATES):
            e, n = p[GNSS_EAST, k], p[GNSS_NORTH, k]
            p[GNSS_EAST, k], p[GNSS_NORTH, k] = a00 * e + a01 * n, a10 * e + a11 * n
        for k in range(STATES):
            e, n = p[k, GNSS_EAST], p[k, GNSS_NORTH]
            p[k, GNSS_EAST], p[k, GNSS_NORTH] = a00 * e + a01 * n, a10 * e + a11 * n
        p[GNSS_EAST, GNSS_EAST] += g00
        p[GNSS_NORTH, GNSS_NORTH] += g11
        p[GNSS_EAST, GNSS_NORTH] += g01
        p[GNSS_NORTH, GNSS_EAST] += g01
        for k in range(influence.shape[1]):
            e, n = influence[GNSS_EAST, k], influence[GNSS_NORTH, k]
            influence[GNSS_EAST, k], influence[GNSS_NORTH, k] = a00 * e + a01 * n, a10 * e + a11 * n
