"""Stage 4: fix the integers of carriers that are not held, where the risk allows."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, Thresholds, detect_and_exclude
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Bools, Epoch
from lanebound.integrity.positioning.codes_kernel import FIXED, NO_CORRECTIONS, NOT_CONVERGED
from lanebound.integrity.positioning.resolve_kernel import resolve
from lanebound.integrity.positioning.rows_kernel import Rows
from lanebound.integrity.positioning.rtk_kernel import Carriers, collapse_code, drop_small_systems

__all__ = ["resolve_integers"]


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
        fixed.status, fixed.coded = FIXED, False
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
                    fixed.status = _resolve(carriers, rows, factor, age, candidate, ambiguities, par, vehicle, fixed, q)
            if searched:
                rtk.refused_s = rules.retry if fixed.status != FIXED else 0.0


@jit
def find_members(ambiguities: Records, used: Bools, satellites: Records, rules: Any, member: Bools) -> tuple[int, bool]:
    """The held carriers in use, without systems of too few: their number, and whether they make a position."""
    for s in range(used.shape[0]):
        member[s] = ambiguities[s].held and used[s]
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
    carriers: Carriers, rows: Rows, factor: Any, age: float, candidate: Bools, ambiguities: Records, par: Any,
    vehicle: Any, fixed: Any, q: Any,
) -> int:  # fmt: skip
    """Fix what the risk allows, from the position of the codes; returns a status."""
    rules, rtk = par.rtk, vehicle.rtk
    aged = (rules.age_sigma * age) ** 2  # of the whole range, common to the bands
    for s in range(factor.shape[0]):
        carriers.variance[s] = factor[s] * rules.sigma_phase**2 + aged
    rtk.fixes += 1
    return int(resolve(carriers, candidate, ambiguities, rules, fixed.position, q, rtk.fixes))
