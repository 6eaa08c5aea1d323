"""Protection levels of dead reckoning since an RTK position, by Doppler or by odometer and gyro.

Two dead reckonings run in parallel: LATEST since the last RTK position, and BACKUP of the backup solution.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import reset, shortened, sigma_and_bias
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    exposure,
    forget_separation,
    risk_factors,
    worst_separation,
)
from lanebound.integrity.monitoring.heading_doubt_kernel import NONE, aside, cover_axes
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import LATEST, Array, Epoch, Tables

__all__ = [
    "along_axes",
    "cover_histories",
    "find_reckoned_levels",
    "heading_bias",
    "later_by",
    "levels_since_fix",
    "restart",
]


@jit
def heading_bias(vehicle: Any, rules: Any) -> float:
    """Bound on the heading's error in addition to the filter's variance [rad]; pi before the first calibration."""
    if not vehicle.since_calibration < math.inf:
        return math.pi
    return float(min(rules.heading_bias + rules.heading_drift * vehicle.since_calibration, math.pi))


@jit
def later_by(since: float, memory: float, duration: float) -> float:
    """Factor by which a fault since some time [s] ago is likelier than at one moment, for a mean duration [s].

    ``memory`` is the mean age of the courses in the heading [s]. Three times as long ago, their weight is e^-3.
    """
    return 1.0 + (since + 3.0 * memory) / duration if since < math.inf else 1.0


@jit(borrows=True)
def find_reckoned_levels(first: int, last: int, epoch: Epoch) -> None:
    """Levels of the position as dead reckoning has moved it; inf where the odometer is doubted."""
    par, tables = epoch.parameters[0], epoch.tables
    for v in range(first, last):
        vehicle, w, levels = epoch.vehicles[v], epoch.work[v], epoch.levels[v]
        # Without a first position, a healthy odometer or a heading nothing bounds the error: the levels stay infinite.
        if vehicle.initialised and not vehicle.unbounded and vehicle.since_calibration < math.inf:
            growth, starts, separations = vehicle.growth[LATEST], epoch.starts[v, LATEST], epoch.faults[v].latest
            levels_since_fix(growth, starts, separations, tables, par.risk, w.sin_h, w.cos_h, w.later, levels)
            cover_histories(vehicle.doubt, tables, levels)


@jit(borrows=True)
def cover_histories(doubt: Any, tables: Tables, levels: Array) -> None:
    """Raise the exact levels (R, 2) to hold along and across both headings, by gyro and by Doppler."""
    if doubt.stage == NONE:
        return
    for r in range(levels.shape[0]):
        if not tables.cases[r].published:
            cover_axes(doubt.difference, levels[r])


@jit(borrows=True)
def levels_since_fix(
    growth: Any, starts: Records, separations: Records, tables: Tables, risk: Any, sin_h: float, cos_h: float,
    later: float, pl: Array,
) -> None:  # fmt: skip
    """``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19) of every case, into pl (R, 2) [m].

    growth of GROWTH; starts (R,) of START; separations (M,) of SEPARATION.

    Exact levels also bound a fault of any satellite or system in the Doppler velocities since the fix and in the
    heading that they calibrated, by the separation that it has caused
    (:mod:`~lanebound.integrity.monitoring.doppler_separation_kernel`). ``later`` >= 1 raises the priors by the faults
    that began since. They also bound how much wrong headings have shortened the path (:func:`shortened`). Of the error
    that the reference gave to the RTK position exact levels take the bound on each axis, published ones equal
    components on E and N.
    """
    cases = tables.cases
    total, squares, lost = exposure(tables.prior, separations)
    total, squares, lost = later * total, later * later * squares, later * lost
    pair = 0.5 * (total * total - squares) if risk.multiple else 0.0
    axis_sine, axis_cosine = (sin_h, cos_h), (cos_h, -sin_h)
    sigma_bias, published_bias = sigma_and_bias(sin_h, cos_h, False, growth), sigma_and_bias(sin_h, cos_h, True, growth)
    for r in range(cases.shape[0]):
        case, start = cases[r], starts[r]
        if not start.whole_first < math.inf:
            pl[r, 0], pl[r, 1] = math.inf, math.inf
            continue
        for q in range(2):
            if case.published:
                level = case.k_dead[q] * published_bias[q] + published_bias[2 + q]
                pl[r, q] = level + risk.reference_bias / math.sqrt(2.0)
                continue
            sine, cosine, share = axis_sine[q], axis_cosine[q], risk.at_share if q == 0 else 1.0 - risk.at_share
            k_0, k_f = case.k_dead[q], -math.inf
            if total > 0.0:
                k_0, k_f = risk_factors(case.budget[q], share, pair, total, lost)
            first, second = along_axes(sine, cosine, start)
            level = k_0 * sigma_bias[q] + abs(first) * start.bias_first + abs(second) * start.bias_second
            if -math.inf < k_f < math.inf:
                whole = abs(first) * start.whole_first + abs(second) * start.whole_second
                by_heading = (
                    sine * sine * growth.f_ee + 2.0 * sine * cosine * growth.f_en + cosine * cosine * growth.f_nn
                )
                by_heading = math.sqrt(max(by_heading, 0.0))
                worst = worst_separation(sine, cosine, sigma_bias[q], by_heading, k_f, separations)
                level = max(level, worst + whole)
            bow = shortened(sine, cosine, max(k_0, k_f) if k_f < math.inf else k_0, growth)
            pl[r, q] = level + sigma_bias[2 + q] + bow + risk.reference_bias + aside(sine, cosine, growth)


@jit(borrows=True)
def restart(vehicle: Any, starts: Records, faults: Records, tables: Tables, risk: Any, w: Any, level: Array) -> None:
    """Restart dead reckoning at the RTK position just found, for every case.

    Its initial error must keep what the protection level promised, biases and faults included: what the ``level``
    (R, 2) of a case holds beyond ``K sigma`` of the fault-free solution remains as a bound on E and N; along and across
    the track where ``fixed.turned``, so that a straight drive leaves it as it is. The published form
    starts from the fault-free covariance alone, as S1 does.
    """
    fixed, sin_h, cos_h = w.fixed, w.sin_h, w.cos_h
    reset(fixed.p_ee, fixed.p_en, fixed.p_nn, 0.0, 0.0, vehicle.growth[LATEST])
    if vehicle.separated:
        for k in range(faults.shape[0]):
            forget_separation(faults[k].latest)
        vehicle.separated = False
    for r in range(level.shape[0]):
        start, case = starts[r], tables.cases[r]
        start.bias_first, start.bias_second, start.whole_first, start.whole_second = 0.0, 0.0, 0.0, 0.0
        start.axis_e, start.axis_n = (sin_h, cos_h) if fixed.turned else (1.0, 0.0)
        if not (level[r, 0] < math.inf and level[r, 1] < math.inf):
            start.whole_first = math.inf
        elif not case.published:
            at, ct = max(level[r, 0] - risk.reference_bias, 0.0), max(level[r, 1] - risk.reference_bias, 0.0)
            start.whole_first, start.whole_second = (at, ct) if fixed.turned else _box(at, ct, sin_h, cos_h)
            at = max(at - case.k_dead[0] * fixed.sigma[0], 0.0)
            ct = max(ct - case.k_dead[1] * fixed.sigma[1], 0.0)
            start.bias_first, start.bias_second = (at, ct) if fixed.turned else _box(at, ct, sin_h, cos_h)


@jit
def along_axes(east: float, north: float, start: Any) -> tuple[float, float]:
    """Components of a vector along the two axes of a start."""
    return east * start.axis_e + north * start.axis_n, north * start.axis_e - east * start.axis_n


@jit
def _box(at: float, ct: float, sin_h: float, cos_h: float) -> tuple[float, float]:
    """Bounds on E and N of what is bounded along and across the track."""
    return abs(sin_h) * at + abs(cos_h) * ct, abs(cos_h) * at + abs(sin_h) * ct
