"""Fix the integers of carriers that are not held, where the risk allows."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, Thresholds, detect_and_exclude
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Bools, Epoch
from lanebound.integrity.positioning.codes_kernel import FIXED, NO_CORRECTIONS, NOT_CONVERGED, RATIO_FAILED
from lanebound.integrity.positioning.float_filter_kernel import FloatFilters, filter_of
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, find_sets
from lanebound.integrity.positioning.resolve_kernel import add_held, attempt, resolve, source_of
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import Carriers, collapse_code, drop_small_systems, has_atmosphere

__all__ = ["fill_rows", "find_code_position", "find_members", "resolve_integers"]


CONFIRM_SHARE = 0.1  # of the risk of wrong integers, for the fixes that confirm another one
MOST_FAILURES = 0.01  # failure rate of such a fix


@jit
def resolve_integers(first: int, last: int, epoch: Epoch) -> None:
    """Try new fixes: in every epoch without a position, otherwise when ``retry`` has passed since a refusal."""
    par, satellites, thresholds = epoch.parameters[0], epoch.tables.satellites, epoch.tables.thresholds
    rules, n = par.rtk, satellites.shape[0]
    candidate, rows, variance = np.empty(n, dtype=np.bool_), np.zeros(n, ROW), np.empty(n)
    for v in range(first, last):
        vehicle, fixed, ambiguities = epoch.vehicles[v], epoch.work[v].fixed, epoch.ambiguities[v]
        rtk, age, marks = vehicle.rtk, epoch.observed[v].age, epoch.marks[v]
        own, filtered = filter_of(epoch.filters, v), vehicle.filter.added
        fixed.status, fixed.coded, fixed.searched, fixed.failure = FIXED, False, 0, 0.0
        if not age <= rules.max_age:
            rtk.rejected, fixed.status = 0, NO_CORRECTIONS
            continue
        new = False
        for s in range(n):
            mark = marks[s]
            candidate[s] = mark.used and mark.phase_ok and satellites[s].fixable and not ambiguities[s].held
            new = new or candidate[s]
        _, positioned = find_members(ambiguities, marks, satellites, rules, rows)
        rtk.refused_s = max(rtk.refused_s - par.dt, 0.0)
        due = not positioned or not rtk.refused_s > 0.5 * par.dt
        searched = due and new and age <= rules.fix_max_age
        if searched and rules.filter.sequential and not filtered and has_atmosphere(rules):
            searched, fixed.status = False, NOT_CONVERGED  # one epoch alone would ignore the atmosphere
        if searched or (par.cold and not vehicle.initialised):
            carriers, q, tests = (
                Carriers(satellites, epoch.signals[v], variance),
                np.empty((3, 3)),
                (thresholds, par, vehicle),
            )
            fill_rows(carriers, marks, rows)
            if not find_code_position(rows, carriers.signals, marks, tests, fixed.position, q):
                fixed.status = NOT_CONVERGED if searched else fixed.status
            else:
                fixed.coded, fixed.p_ee, fixed.p_en, fixed.p_nn = True, q[0, 0], q[0, 1], q[1, 1]
                if searched:
                    fixed.status = _resolve(
                        carriers, rows, marks, tests, age, candidate, ambiguities, fixed, q, own, filtered
                    )
            if searched:
                rtk.refused_s = rules.retry if fixed.status != FIXED else 0.0


@jit(borrows=True)
def fill_rows(carriers: Carriers, marks: Records, rows: Records) -> None:
    """Satellites and lines of sight of the rows (S,), and those in use."""
    for s in range(rows.shape[0]):
        row = rows[s]
        row.group, row.system = carriers.satellites[s].system, carriers.satellites[s].system
        row.used = marks[s].used
        for k in range(3):
            row.e[k] = carriers.signals[s].e[k]


@jit
def find_members(
    ambiguities: Records, marks: Records, satellites: Records, rules: Any, rows: Records
) -> tuple[int, bool]:
    """Use the rows of held carriers, without systems of too few: their number, and whether they make a position."""
    member = np.empty(rows.shape[0], dtype=np.bool_)
    for s in range(rows.shape[0]):
        member[s] = ambiguities[s].held and marks[s].used and not satellites[s].further
    count, systems = drop_small_systems(member, satellites, rules.min_further)
    for s in range(rows.shape[0]):
        rows[s].used = member[s]
    return count, systems > 0 and count >= rules.min_satellites + rules.min_further * (systems - 1)


@jit
def find_code_position(
    rows: Records, signals: Records, marks: Records, tests: tuple[Thresholds, Any, Any], position: Any, q: Any
) -> bool:
    """Solve the codes for position (3,) with covariance q (3, 3), checked by their own residuals; True when usable.

    tests : thresholds, parameters and vehicle
    """
    thresholds, par, vehicle = tests
    rules = par.rtk
    collapse_code(signals, rules.bands, rows)
    for s in range(rows.shape[0]):
        rows[s].variance = marks[s].factor * (rules.sigma_code**2 / rules.bands)
    outcome, _, _, _, _ = detect_and_exclude(rows, vehicle.heading.angle, thresholds, par.fde, position, q)
    return bool(outcome <= EXCLUDED)


@jit(inline=True)
def _resolve(
    carriers: Carriers, rows: Records, marks: Records, tests: tuple[Thresholds, Any, Any], age: float,
    candidate: Bools, ambiguities: Records, fixed: Any, q: Any, own: FloatFilters | None, filtered: bool,
) -> int:  # fmt: skip
    """Fix what the risk allows, from the codes of this epoch or, if ``filtered``, from the filter; returns a status.

    Where carriers may be off, a fix has to be found again without each of them (:func:`_confirm`).
    """
    _, par, vehicle = tests
    rules, rtk = par.rtk, vehicle.rtk
    aged = (rules.age_sigma * age) ** 2  # of the whole range, common to the bands
    for s in range(marks.shape[0]):
        carriers.variance[s] = marks[s].factor * rules.sigma_phase**2 + aged
    rtk.fixes += 1
    fixed.searched = np.count_nonzero(candidate)
    before = ambiguities.copy()
    status, rate = resolve(carriers, candidate, ambiguities, rules, fixed.position, q, own, filtered, rtk.fixes)
    fixed.failure = rate
    monitored = rules.reflections.sets > 0
    if (
        monitored
        and status == FIXED
        and not _confirm(carriers, rows, marks, tests, candidate, before, ambiguities, own)
    ):
        ambiguities[:] = before
        return RATIO_FAILED
    return int(status)


@jit(inline=True)
def _confirm(
    carriers: Carriers, rows: Records, marks: Records, tests: tuple[Thresholds, Any, Any], candidate: Bools,
    before: Records, ambiguities: Records, own: FloatFilters | None,
) -> bool:  # fmt: skip
    """Whether no doubtful carrier, and no set of them, is needed for the integers that are new since ``before``.

    Each hypothesis takes its satellites out of codes, held and new carriers and resolves the rest from this epoch alone
    (the filter ``own`` contains them). Other integers, or
    a hypothesis without a fix, refute the new fix; a new satellite that a hypothesis cannot fix is released. The
    hypotheses fail, each weighed by its odds, with CONFIRM_SHARE of the risk of wrong integers at most, which is added
    to that of the fix.
    """
    _, par, vehicle = tests
    rules, n = par.rtk, candidate.shape[0]
    member, odds, count = np.empty(n, dtype=np.int64), np.empty(n), 0
    for s in range(n):
        if ambiguities[s].held and marks[s].used:
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
    for h in range(number):
        trial[:], rest[:], prior = before, candidate, 1.0
        for s in range(n):
            rows[s].used = marks[s].used
        for i in sets[h]:
            if i >= 0:
                rows[member[i]].used, rest[member[i]], trial[member[i]].held = False, False, False
                prior *= odds[i]
        if not _any_new(before, ambiguities, rest):
            continue
        if not find_code_position(rows, carriers.signals, marks, tests, position, q):
            return False
        if not add_held(carriers, trial, rules, position, q):
            return False
        limit = min(CONFIRM_SHARE * rules.fix_limit / (prior * number), MOST_FAILURES)
        source = source_of(carriers, trial, rules.bands, position, q, own, False)
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
