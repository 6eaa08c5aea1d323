"""Stage 4: fix the integers of carriers that are not held, where the risk allows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, Thresholds, detect_and_exclude
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Bools, Epoch
from lanebound.integrity.positioning.codes_kernel import FIXED, NO_CORRECTIONS, NOT_CONVERGED, RATIO_FAILED
from lanebound.integrity.positioning.float_filter_kernel import FilterRow, filter_of
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, find_sets
from lanebound.integrity.positioning.resolve_kernel import FloatSource, add_held, attempt, base_of, resolve
from lanebound.integrity.positioning.rows_kernel import Rows
from lanebound.integrity.positioning.rtk_kernel import Carriers, collapse_code, drop_small_systems, has_atmosphere

__all__ = ["resolve_integers"]


CONFIRM_SHARE = 0.1  # of the risk of wrong integers, for the fixes that confirm another one
MOST_FAILURES = 0.01  # failure rate of such a fix


class Codes(NamedTuple):
    """Codes of a vehicle: code (S, 2) [m], used (S,), variance factors (S,); thresholds, parameters and vehicle."""

    code: Any
    used: Bools
    factor: Any
    tests: tuple[Thresholds, Any, Any]


@jit
def resolve_integers(first: int, last: int, epoch: Epoch) -> None:
    """Try new fixes: in every epoch without a position, otherwise when ``retry`` has passed since a refusal."""
    par, state, measured, work = epoch.parameters[0], epoch.state, epoch.measured, epoch.work
    satellites, rules, thresholds = epoch.tables.satellites, par.rtk, epoch.tables.thresholds
    n = satellites.shape[0]
    candidate, member = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.bool_)
    system = np.empty(n, dtype=np.int64)
    for s in range(n):
        system[s] = satellites[s].system
    for v in range(first, last):
        vehicle, fixed, ambiguities = state.vehicles[v], work.vehicles[v].fixed, state.ambiguities[v]
        rtk, age = vehicle.rtk, measured.age[v]
        used, phase_ok = work.used[v], work.phase_ok[v]
        own, filtered = filter_of(state.filtered, v), state.filtered.rows[v].added
        fixed.status, fixed.coded, fixed.searched, fixed.failure = FIXED, False, 0, 0.0
        if not age <= rules.max_age:
            rtk.rejected, fixed.status = 0, NO_CORRECTIONS
            continue
        new = False
        for s in range(n):
            candidate[s] = used[s] and phase_ok[s] and satellites[s].fixable and not ambiguities[s].held
            new = new or candidate[s]
        _, positioned = find_members(ambiguities, used, satellites, rules, member)
        rtk.refused_s = max(rtk.refused_s - par.dt, 0.0)
        due = not positioned or not rtk.refused_s > 0.5 * par.dt
        searched = due and new and age <= rules.fix_max_age
        if searched and rules.filter.sequential and not filtered and has_atmosphere(rules):
            searched, fixed.status = False, NOT_CONVERGED  # one epoch alone would ignore the atmosphere
        if searched or (par.cold and not vehicle.initialised):
            code, los, factor = measured.code[v], measured.los[measured.sight[v]], work.factor[v]
            carriers = Carriers(los, satellites, measured.phase[v], np.empty(n))
            rows = Rows(los, system, np.empty(n), np.empty(n), used.copy())
            q, tests = np.empty((3, 3)), (thresholds, par, vehicle)
            if not find_code_position(rows, code, factor, tests, fixed.position, q):
                fixed.status = NOT_CONVERGED if searched else fixed.status
            else:
                fixed.coded, fixed.p_ee, fixed.p_en, fixed.p_nn = True, q[0, 0], q[0, 1], q[1, 1]
                if searched:
                    tests_of_codes = Codes(code, used, factor, tests)
                    fixed.status = _resolve(
                        carriers, rows, tests_of_codes, age, candidate, ambiguities, fixed, q, own, filtered
                    )
            if searched:
                rtk.refused_s = rules.retry if fixed.status != FIXED else 0.0


@jit
def find_members(ambiguities: Records, used: Bools, satellites: Records, rules: Any, member: Bools) -> tuple[int, bool]:
    """The held carriers in use, without systems of too few: their number, and whether they make a position."""
    for s in range(used.shape[0]):
        member[s] = ambiguities[s].held and used[s] and not satellites[s].further
    count, systems = drop_small_systems(member, satellites, rules.min_further)
    return count, systems > 0 and count >= rules.min_satellites + rules.min_further * (systems - 1)


@jit
def find_code_position(
    rows: Rows, code: Any, factor: Any, tests: tuple[Thresholds, Any, Any], position: Any, q: Any
) -> bool:
    """Solve the codes for position (3,) with covariance q (3, 3), checked by their own residuals; True when usable.

    tests : thresholds, parameters and vehicle
    """
    thresholds, par, vehicle = tests
    rules = par.rtk
    collapse_code(code, rules.bands, rows.y)
    for s in range(factor.shape[0]):
        rows.variance[s] = factor[s] * (rules.sigma_code**2 / rules.bands)
    heading = vehicle.heading.angle
    outcome, _, _, _, _ = detect_and_exclude(rows, rows.group, heading, thresholds, par.fde, position, q)
    return bool(outcome <= EXCLUDED)


@jit
def _resolve(
    carriers: Carriers, rows: Rows, codes: Codes, age: float, candidate: Bools, ambiguities: Records, fixed: Any,
    q: Any, own: FilterRow, filtered: bool,
) -> int:  # fmt: skip
    """Fix what the risk allows, from the codes of this epoch or, if ``filtered``, from the filter; returns a status.

    Where carriers may be off, a fix has to be found again without each of them (:func:`_confirm`).
    """
    _, par, vehicle = codes.tests
    rules, rtk = par.rtk, vehicle.rtk
    aged = (rules.age_sigma * age) ** 2  # of the whole range, common to the bands
    for s in range(codes.factor.shape[0]):
        carriers.variance[s] = codes.factor[s] * rules.sigma_phase**2 + aged
    rtk.fixes += 1
    fixed.searched = np.count_nonzero(candidate)
    if rules.reflections.sets == 0:
        status, rate = resolve(carriers, candidate, ambiguities, rules, fixed.position, q, own, filtered, rtk.fixes)
        fixed.failure = rate
        return int(status)
    before = ambiguities.copy()
    status, rate = resolve(carriers, candidate, ambiguities, rules, fixed.position, q, own, filtered, rtk.fixes)
    fixed.failure = rate
    if status == FIXED and not _confirm(carriers, rows, codes, candidate, before, ambiguities, own):
        ambiguities[:] = before
        return RATIO_FAILED
    return int(status)


@jit
def _confirm(
    carriers: Carriers, rows: Rows, codes: Codes, candidate: Bools, before: Records, ambiguities: Records,
    own: FilterRow,
) -> bool:  # fmt: skip
    """Whether no doubtful carrier, and no set of them, is needed for the integers that are new since ``before``.

    Each hypothesis takes its satellites out of codes, held and new carriers and resolves the rest from this epoch alone
    (the filter ``own`` contains them). Other integers, or
    a hypothesis without a fix, refute the new fix; a new satellite that a hypothesis cannot fix is released. The
    hypotheses fail, each weighed by its odds, with CONFIRM_SHARE of the risk of wrong integers at most, which is added
    to that of the fix.
    """
    _, par, vehicle = codes.tests
    rules, n = par.rtk, candidate.shape[0]
    member, odds, used, count = np.empty(n, dtype=np.int64), np.empty(n), np.empty(n, dtype=np.bool_), 0
    for s in range(n):
        if ambiguities[s].held and codes.used[s]:
            member[count], odds[count] = s, ambiguities[s].odds
            count += 1
    sets = np.full((rules.reflections.sets + count, LARGEST_SET), -1, dtype=np.int64)
    number, _ = find_sets(odds, count, rules.reflections, sets)
    if number < 0:
        return False
    for i in range(count):
        if odds[i] > rules.reflections.single:
            sets[number, 0], sets[number, 1], sets[number, 2] = i, -1, -1
            number += 1
    position, q, trial = np.empty(3), np.empty((3, 3)), before.copy()
    chosen, relieved, rest = np.empty(n, dtype=np.bool_), np.empty(n), np.empty(n, dtype=np.bool_)
    rows = Rows(rows.los, rows.group, rows.variance, rows.y, used)
    for h in range(number):
        trial[:], used[:], rest[:], prior = before, codes.used, candidate, 1.0
        for i in sets[h]:
            if i >= 0:
                used[member[i]], rest[member[i]], trial[member[i]].held = False, False, False
                prior *= odds[i]
        if not _any_new(before, ambiguities, rest):
            continue
        if not find_code_position(rows, codes.code, codes.factor, codes.tests, position, q):
            return False
        if not add_held(carriers, trial, rules, position, q):
            return False
        limit = min(CONFIRM_SHARE * rules.fix_limit / (prior * number), MOST_FAILURES)
        source = FloatSource(position, q, base_of(carriers, trial, rules.bands), own, False)
        status, _, _ = attempt(carriers, rest, trial, source, rules, limit, vehicle.rtk.fixes, 0.0, chosen, relieved)
        if status != FIXED or not _agree(carriers.satellites, rest, trial, before, ambiguities, rules.bands):
            return False
    for s in range(n):
        rest[s] = ambiguities[s].held
        if rest[s] and not before[s].held:
            ambiguities[s].fix_risk += CONFIRM_SHARE * rules.fix_limit
    members, systems = drop_small_systems(rest, carriers.satellites, rules.min_further)
    return bool(systems > 0 and members >= rules.min_satellites + rules.min_further * (systems - 1))


@jit
def _any_new(before: Records, ambiguities: Records, rest: Bools) -> bool:
    """Whether any satellite of ``rest`` has integers that are new since ``before``."""
    for s in range(rest.shape[0]):
        if rest[s] and ambiguities[s].held and not before[s].held:
            return True
    return False


@jit
def _agree(satellites: Records, rest: Bools, trial: Records, before: Records, ambiguities: Records, bands: int) -> bool:
    """Whether integers of ``trial`` equal those of ``ambiguities`` up to a number common to a system and band.

    New satellites of ``rest`` that the trial has not fixed are released.
    """
    common, known = np.zeros((MAX_GROUPS, 2)), np.zeros(MAX_GROUPS, dtype=np.bool_)
    for s in range(rest.shape[0]):
        ours, theirs, c = ambiguities[s], trial[s], satellites[s].system
        if ours.held and rest[s] and not before[s].held and not theirs.held:
            ours.held = False
        if not (ours.held and theirs.held):
            continue
        for b in range(bands):
            difference = ours.integers[b] - theirs.integers[b]
            if known[c] and difference != common[c, b]:
                return False
            common[c, b] = difference
        known[c] = True
    return True
