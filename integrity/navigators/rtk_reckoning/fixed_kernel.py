"""The position of the held phases, its fault test and its protection levels.

The fixed position takes the phases alone: the code's share of the weight is the inverse square of the code/phase ratio,
1/5000, and would only add its multipath.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, UNRESOLVED, detect_and_exclude
from lanebound.integrity.monitoring.heading_separation_kernel import largest_course
from lanebound.integrity.monitoring.protection_kernel import (
    closed_form,
    closed_form_published,
    multi_hypothesis_pl,
    pair_risk,
    split_budgets,
)
from lanebound.integrity.monitoring.reflection_modes_kernel import add_reflection_modes
from lanebound.integrity.monitoring.separation_kernel import (
    Modes,
    Moments,
    find_modes,
    mode_scratch,
    moment_scratch,
    set_factors,
    set_priors,
)
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import heading_bias
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import (
    MULTI_HYPOTHESIS,
    PUBLISHED,
    Array,
    Bools,
    Epoch,
    Ints,
    Tables,
)
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import fill_rows, find_members
from lanebound.integrity.positioning.codes_kernel import FAULT, FIXED, NO_CORRECTIONS, TOO_FEW
from lanebound.integrity.positioning.geometry_kernel import (
    SOLVED,
    Geometry,
    capacity,
    find_geometry,
    geometry_scratch,
    solve,
)
from lanebound.integrity.positioning.mode_kernel import rtk_usable
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import (
    Carriers,
    atmosphere_variance,
    collapse_phase,
    held_risk,
    range_of,
)

__all__ = ["find_fixed_position"]


class FixedScratch(NamedTuple):
    """Scratch of the fixed solution; W columns.

    geo, moments, modes of its levels; los (W, 3), group (W,); variance for integrity, bias bound, measurement,
    variance for accuracy and odds of a fault (W,) of the satellites in it; sets (D, LARGEST_SET) of them to monitor;
    tried, air (W,) of all satellites: in use before the test, variance of
    what the bands have in common [m^2]; position (3,) and covariance (3, 3) of the test; risk (1,), budget (1, 2) and
    level (1, 2) of a case.
    """

    geo: Geometry
    moments: Moments
    modes: Modes
    los: Array
    group: Ints
    variance: Array
    bias: Array
    y: Array
    accuracy: Array
    odds: Array
    sets: Ints
    tried: Bools
    air: Array
    position: Array
    covariance: Array
    risk: Array
    budget: Array
    level: Array


@jit
def fixed_scratch(n: int, sets: int) -> FixedScratch:
    """Allocate the scratch for up to n satellites and so many sets of them."""
    w = capacity(n)
    return FixedScratch(
        geometry_scratch(n), moment_scratch(n), mode_scratch(n, sets), np.zeros((w, 3)), np.zeros(w, dtype=np.int64),
        np.zeros(w), np.zeros(w), np.zeros(w), np.zeros(w), np.zeros(w), np.zeros((sets, LARGEST_SET), dtype=np.int64),
        np.zeros(w, dtype=np.bool_), np.zeros(w), np.zeros(3), np.zeros((3, 3)), np.zeros(1), np.zeros((1, 2)),
        np.zeros((1, 2)),
    )  # fmt: skip


@jit
def find_fixed_position(first: int, last: int, epoch: Epoch) -> None:
    """Solve with the held phases, test and exclude, and bound the position where it may be used."""
    par, tables, satellites = epoch.parameters[0], epoch.tables, epoch.tables.satellites
    rules, n = par.rtk, satellites.shape[0]
    scratch, rows, factor = fixed_scratch(n, rules.reflections.sets), np.zeros(n, ROW), np.empty(n)
    for v in range(first, last):
        vehicle, w, ambiguities = epoch.vehicles[v], epoch.work[v], epoch.ambiguities[v]
        fixed, signals, marks, levels = w.fixed, epoch.signals[v], epoch.marks[v], epoch.fixed_levels[v]
        levels[:, :] = 0.0
        fixed.satellites, fixed.excluded, fixed.hdop, fixed.usable = 0, 0, math.inf, False
        if fixed.status != NO_CORRECTIONS:
            for s in range(n):
                factor[s] = marks[s].factor
            carriers = Carriers(satellites, signals, factor)
            fill_rows(carriers, marks, rows)
            fixed.satellites, positioned = find_members(ambiguities, marks, satellites, rules, rows)
            if positioned:
                fixed.coded = False  # its position gives way to that of the phases
                _fill_phases(carriers, ambiguities, epoch.observed[v].age, rules, rows, scratch)
                outcome, _, _, _, fixed.excluded = detect_and_exclude(
                    rows, vehicle.heading.angle, tables.thresholds, par.fde, scratch.position, scratch.covariance
                )
                if _is_accepted(outcome, ambiguities, rules, vehicle.rtk, fixed) and _solve_fixed(
                    factor, rows, ambiguities, rules, w, scratch
                ):
                    fixed.status, fixed.hdop = FIXED, hdop_of(rows)
            elif fixed.status == FIXED:
                fixed.status = TOO_FEW
        fixed.wrong = held_risk(ambiguities)
        vehicle.fixed_s = vehicle.fixed_s + par.dt if fixed.status == FIXED else 0.0
        fixed.lasting = vehicle.since_rtk < 1.5 * par.dt
        confirmed = fixed.status == FIXED and (fixed.lasting or vehicle.fixed_s > par.confirm)
        fixed.usable = confirmed and rtk_usable(fixed.hdop, par.modes)
        if fixed.usable:
            levels_of_fix(fixed.satellites, fixed.wrong, w.sin_h, w.cos_h, tables, par, scratch, levels)
            lever_at, lever_ct = lever_bounds(vehicle, epoch.faults[v], par)
            for r in range(levels.shape[0]):
                levels[r, 0] += lever_at
                levels[r, 1] += lever_ct


@jit(borrows=True)
def _fill_phases(
    carriers: Carriers, ambiguities: Records, age: float, rules: Any, rows: Records, scratch: FixedScratch
) -> None:
    """The rows of the phases, their variances, and which are tried; ``carriers.variance`` holds variance factors."""
    factor, tried, air = carriers.variance, scratch.tried, scratch.air
    aged = (rules.age_sigma * age) ** 2  # of the whole range, common to the bands
    collapse_phase(carriers, ambiguities, rules.bands, rows)
    for s in range(rows.shape[0]):
        row = rows[s]
        tried[s] = row.used
        row.y -= range_of(carriers.signals[s].integer_error, carriers.satellites[s], rules.bands)
        air[s] = aged + atmosphere_variance(row.e[2], carriers.satellites[s], rules)
        row.variance = factor[s] * (rules.sigma_phase**2 / rules.bands) + air[s]


@jit(borrows=True)
def _is_accepted(outcome: int, ambiguities: Records, rules: Any, rtk: Any, fixed: Any) -> bool:
    """Whether the fault test leaves rows to solve with; after several failures in a row all integers are released."""
    if outcome == UNRESOLVED:
        rtk.rejected += 1
        if rtk.rejected >= rules.hold_failures:
            for s in range(ambiguities.shape[0]):
                ambiguities[s].held = False
            rtk.rejected = 0
        fixed.status = FAULT
        return False
    rtk.rejected = 0
    if outcome > EXCLUDED:
        fixed.status = TOO_FEW
        return False
    return True


@jit(borrows=True)
def _solve_fixed(
    factor: Array, rows: Records, ambiguities: Records, rules: Any, w: Any, scratch: FixedScratch
) -> bool:  # fmt: skip
    """Release the integers of what has been excluded and solve with the rest; factor (S,) of the variances."""
    fixed, tried, air = w.fixed, scratch.tried, scratch.air
    n, nominal, los, group = 0, rules.sigma_phase_integrity**2, scratch.los, scratch.group
    for s in range(rows.shape[0]):
        row = rows[s]
        if tried[s] and not row.used:
            ambiguities[s].held = False
        if row.used:
            los[n, 0], los[n, 1], los[n, 2], group[n] = row.e[0], row.e[1], row.e[2], row.group
            scratch.variance[n], scratch.bias[n] = factor[s] * nominal + air[s], rules.phase_bias
            scratch.y[n], scratch.accuracy[n], scratch.odds[n] = row.y, row.variance, ambiguities[s].odds
            n += 1
    fixed.satellites = n
    geo = scratch.geo
    if find_geometry(los, group, scratch.variance, scratch.bias, n, w.sin_h, w.cos_h, geo) != SOLVED:
        fixed.status = TOO_FEW
        return False
    solve(scratch.y, group, n, geo)
    fix = geo.fix[0]
    for k in range(3):
        fixed.position[k] = fix.position[k]
    fixed.p_ee, fixed.p_en, fixed.p_nn = fix.p_ee, fix.p_en, fix.p_nn
    fixed.sigma[0], fixed.sigma[1] = fix.sigma[0], fix.sigma[1]
    return True


@jit(borrows=True)
def levels_of_fix(
    n: int, wrong: float, sin_h: float, cos_h: float, tables: Tables, par: Any, scratch: FixedScratch, pl: Array
) -> None:
    """Protection levels pl (R, 2) of the fixed position of n satellites, for every case in its form.

    The reference bias bounds the common shift by a wrong reference, which every mode shares. Published:
    ``b_E = b_N`` of that length, so ``B = b / sqrt 2``. ``wrong`` is the risk of wrong integers, which is spent first.
    K_fa is the threshold of the fault test. Where only a failed global test leads to a local one, it is at least
    ``sqrt(chi2)`` of the global test, as ``w^2 <= e'We``.
    """
    risk, cases, geo, group = par.risk, tables.cases, scratch.geo, scratch.group
    moments, modes = scratch.moments, scratch.modes
    one, budget, found = scratch.risk, scratch.budget, scratch.level
    count, lost, apart = 0, 0.0, 0.0
    for form in range(3):
        filled = False
        for r in range(cases.shape[0]):
            case = cases[r]
            if case.form != form:
                continue
            if not filled:
                published = form == PUBLISHED
                count = find_modes(
                    group, scratch.accuracy, n, sin_h, cos_h, risk.constellations, published, geo, moments, modes
                )
                lost = set_priors(group, n, count, risk.satellite_prior, risk.constellation_prior, geo.clocks, modes)
                apart = pair_risk(count, modes.prior) if risk.multiple else 0.0
                if published:
                    set_factors(n, count, tables.thresholds.limits[count - 1].published, 0.0, geo.clocks, modes)
                else:
                    df = n - 3 - geo.fix[0].groups
                    least = math.sqrt(tables.thresholds.limits[df].counted) if par.fde.global_first else 0.0
                    factors = tables.counted[count - 1 if par.fde.by_tests else df]
                    set_factors(n, count, factors, least, geo.clocks, modes)
                    if par.rtk.reflections.sets > 0:
                        count, lost, apart = add_reflection_modes(
                            n, count, sin_h, cos_h, scratch.odds, group, par.rtk.reflections, scratch.sets, geo,
                            moments, modes,
                        )  # fmt: skip
                filled = True
            if form == PUBLISHED:
                one[0] = case.k_published
                closed_form_published(count, one, modes, found)
                shift = risk.reference_bias / math.sqrt(2.0)
            else:
                one[0] = case.risk
                spent = risk.spent + wrong
                split_budgets(one, risk.at_share, spent + apart, budget)
                if form == MULTI_HYPOTHESIS:
                    multi_hypothesis_pl(count, budget, lost, risk.tolerate, modes, found)
                else:
                    share0 = risk.fault_free_share
                    closed_form(count, budget, share0, lost, risk.tolerate, modes, found)
                shift = risk.reference_bias
            pl[r, 0], pl[r, 1] = found[0, 0] + shift, found[0, 1] + shift


@jit(borrows=True)
def lever_bounds(vehicle: Any, faults: Records, par: Any) -> tuple[float, float]:
    """Bounds on the shift of the reference point against the antenna by a wrong heading, along and across [m].

    A lever (f, r) turned by theta moves ``f (cos theta - 1) - r sin theta`` along, ``f sin theta + r (cos theta - 1)``
    across, and by twice its length at most. The fault of a satellite or system turns the heading by its separation;
    where gyro and Doppler contradict each other, either history may be right.
    """
    f, r = abs(par.lever.forward), abs(par.lever.right)
    if f == 0.0 and r == 0.0:
        return 0.0, 0.0
    heading, fault = vehicle.heading, largest_course(faults)
    theta = par.lever.k * math.sqrt(heading.p_hh + vehicle.spread.hh) + heading_bias(vehicle, par.odometer)
    theta += fault + par.lever.axle_bound * abs(heading.axle_h) + vehicle.doubt.difference
    theta = min(theta, math.pi)
    most, turned = 2.0 * math.hypot(f, r), 0.5 * theta * theta
    return min(r * theta + f * turned, most), min(f * theta + r * turned, most)
