"""Loose coupling: the position of a service and the position reckoned on, ``(1 - a) x + a x_s``.

The weight a is that of the smallest bound by declared figures, with fast errors as a white one. A position whose own
level is below ``restart`` times that of the coupled position is taken whole, as without coupling. A position that
contradicts the one reckoned on is offered whole too: the jump monitor judges it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.jump_kernel import bounded, contradicts, is_suspicious
from lanebound.integrity.monitoring.protection_kernel import pair_risk
from lanebound.integrity.monitoring.reflection_modes_kernel import add_reflection_modes
from lanebound.integrity.monitoring.separation_kernel import find_modes, set_priors
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import (
    FixedScratch,
    fixed_scratch,
    lever_bounds,
)
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.coupling_kernel import (
    begin_from,
    cost_of,
    fault_bound,
    propose,
    propose_whole,
)
from lanebound.integrity.navigators.services.coupling_records_kernel import Coupling, Part
from lanebound.integrity.navigators.services.fix_kernel import offer, position_of, takes
from lanebound.integrity.navigators.services.records_kernel import (
    LEAST_WEIGHT,
    ServiceInputs,
    ServiceRows,
    ServiceTables,
)
from lanebound.integrity.navigators.services.tight_kernel import couple_ranges, offer_coupled

__all__ = ["couple_fix"]

Array = NDArray[np.float64]

LARGEST_WEIGHT, WEIGHTS = 0.7, 10


@jit
def couple_fix(
    first: int, last: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, ranges: ServiceRows,
    coupling: Coupling,
) -> None:  # fmt: skip
    """Offer the position of tested ranges whole or coupled, or couple the ranges, where no service before has."""
    par, rules, how = service.parameters[0], service.rules[0], coupling.rules[0]
    scratch = fixed_scratch(service.satellites.shape[0], coupling.parameters[0].rtk.reflections.sets)
    levels, cases = np.empty((epoch.levels.shape[1], 2)), epoch.levels.shape[1]
    part = Part(np.empty(3), np.empty(3), np.empty((cases, 2)))
    for v in range(first, last):
        vehicle, w, expected = epoch.vehicles[v], epoch.work[v], epoch.levels[v]
        if (
            w.fixed.usable
            or not ranges.work[v].due
            or not (ranges.work[v].consistent or (how.tight and ranges.work[v].few))
        ):
            continue
        used, hdop = (
            position_of(v, epoch, service, inputs, ranges, scratch, levels) if ranges.work[v].consistent else (0, 0.0)
        )
        if used > 0:
            describe(v, used, epoch, service, ranges, scratch, coupling, part)
            if is_whole(v, epoch, how.restart, scratch, levels, part.extra[0], coupling):
                if takes(v, levels, expected, service, ranges) or is_suspicious(vehicle.jump):
                    offer(w.fixed, scratch.geo.fix[0], used, ranges.work[v].excluded, hdop)
                    epoch.fixed_levels[v, :, :] = levels
                    ranges.labels[v].offered = rules.mode
                    propose_whole(v, how, part, w, coupling)
                continue
        waits = coupling.coupled[v].active and coupling.coupled[v].since < how.interval - 0.5 * par.dt
        if waits or not bounded(expected[0]) or is_suspicious(vehicle.jump) or not vehicle.initialised:
            continue
        if not coupling.coupled[v].active:
            begin_from(v, epoch, coupling)
        if how.tight:
            couple_ranges(v, epoch, service, inputs, ranges, coupling, hdop)
        elif used > 0:
            couple_position(v, used, hdop, epoch, service, ranges, scratch, part, coupling)


@jit
def is_whole(
    v: int, epoch: Epoch, restart: float, scratch: FixedScratch, levels: Array, extra: Array,
    coupling: Coupling,
) -> bool:  # fmt: skip
    """Whether a position is not coupled: nothing is reckoned on, its faults have no bound that lasts, it contradicts
    what is reckoned on, or its level is much lower."""
    vehicle, w, expected = epoch.vehicles[v], epoch.work[v], epoch.levels[v, 0]
    if not vehicle.initialised or not bounded(expected) or not bounded(extra) or is_suspicious(vehicle.jump):
        return True
    if coupling.coupled[v].active and not coupling.extra[v, 0].first < math.inf:
        return True
    if not bounded(levels[0]):
        return False
    found, square = levels[0], restart * restart
    if found[0] ** 2 + found[1] ** 2 < square * (expected[0] ** 2 + expected[1] ** 2):
        return True
    east, north = reference_point(scratch.geo.fix[0], epoch.parameters[0].lever, w.sin_h, w.cos_h)
    off_e, off_n = east - vehicle.position[0], north - vehicle.position[1]
    return bool(contradicts(off_e, off_n, w.sin_h, w.cos_h, expected, found))


@jit
def describe(
    v: int, used: int, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, scratch: FixedScratch,
    coupling: Coupling, part: Part,
) -> None:  # fmt: skip
    """Fast and slow covariance of the solved position of vehicle v, and bounds of its faults for each case."""
    par, tables, w, geo = coupling.parameters[0], service.tables, epoch.work[v], scratch.geo
    fix, risk, modes, i = geo.fix[0], par.risk, scratch.modes, 0
    part.fast[:] = 0.0
    for s in range(service.satellites.shape[0]):
        if ranges.rows[v, s].used:
            east, north = geo.weight[i] * geo.lever[0, i], geo.weight[i] * geo.lever[1, i]
            part.fast[0] += east * east * ranges.parts[v, s].fast
            part.fast[1] += east * north * ranges.parts[v, s].fast
            part.fast[2] += north * north * ranges.parts[v, s].fast
            i += 1
    part.slow[0], part.slow[1] = fix.p_ee - part.fast[0], fix.p_en - part.fast[1]
    part.slow[2] = fix.p_nn - part.fast[2]
    count = find_modes(
        scratch.group, scratch.accuracy, used, w.sin_h, w.cos_h, risk.constellations, False, geo, scratch.moments, modes
    )
    gone = set_priors(scratch.group, used, count, risk.satellite_prior, risk.constellation_prior, geo.clocks, modes)
    apart = pair_risk(count, modes.prior) if risk.multiple else 0.0
    if par.rtk.reflections.sets > 0:
        count, gone, apart = add_reflection_modes(
            used, count, w.sin_h, w.cos_h, scratch.odds, scratch.group, par.rtk.reflections, scratch.sets, geo,
            scratch.moments, modes,
        )  # fmt: skip
    prior, sigma = np.empty(count), np.empty(count)
    lever_at, lever_ct = lever_bounds(epoch.vehicles[v], epoch.faults[v], par)
    for q in range(2):
        for k in range(count):
            solved = k > 0 and modes.weight[k] > 0.0
            prior[k] = modes.prior[k] if solved else 0.0
            sigma[k] = math.sqrt(max(modes.sigma[q, k] ** 2 - modes.sigma[q, 0] ** 2, 0.0)) if solved else 0.0
        constant = fix.bias[q] + (lever_at if q == 0 else lever_ct)
        for r in range(part.extra.shape[0]):
            budget = tables.cases[r].budget[q]
            share = budget / (tables.cases[r].budget[0] + tables.cases[r].budget[1])
            part.extra[r, q] = constant + fault_bound(
                count, prior, modes.separation[q], sigma, budget, share * (gone + apart), coupling.rules[0].memory
            )


@jit
def couple_position(
    v: int, used: int, hdop: float, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, scratch: FixedScratch,
    part: Part, coupling: Coupling,
) -> None:  # fmt: skip
    """Offer ``(1 - a) x + a x_s`` with the weight of the smallest bound, if there is one below that of x."""
    w, vehicle, fix = epoch.work[v], epoch.vehicles[v], scratch.geo.fix[0]
    a, own = np.zeros((2, 2)), Part(np.empty(3), np.empty(3), np.empty_like(part.extra))
    chosen, least = 0.0, cost_of(v, epoch, coupling, a, part.fast, part.slow, part.extra[0], False)
    step = (LARGEST_WEIGHT / LEAST_WEIGHT) ** (1.0 / (WEIGHTS - 1))
    weight = LEAST_WEIGHT
    for _ in range(WEIGHTS):
        weigh(weight, part, own, a)
        cost = cost_of(v, epoch, coupling, a, own.fast, own.slow, own.extra[0], True)
        if cost < least:
            chosen, least = weight, cost
        weight *= step
    if chosen == 0.0:
        return
    weigh(chosen, part, own, a)
    levels = epoch.fixed_levels[v]
    propose(v, epoch, service.tables.cases, coupling, a, own, levels)
    east, north = reference_point(fix, epoch.parameters[0].lever, w.sin_h, w.cos_h)
    w.fixed.position[0] = fix.position[0] + (chosen - 1.0) * (east - vehicle.position[0])
    w.fixed.position[1] = fix.position[1] + (chosen - 1.0) * (north - vehicle.position[1])
    w.fixed.position[2] = fix.position[2]
    offer_coupled(v, used, hdop, epoch, service, ranges, coupling)


@jit
def weigh(weight: float, part: Part, own: Part, a: Array) -> None:
    """The share of a position of this weight, and what remains of the other one."""
    a[0, 0], a[1, 1] = 1.0 - weight, 1.0 - weight
    for k in range(3):
        own.fast[k], own.slow[k] = weight * weight * part.fast[k], weight * weight * part.slow[k]
    for r in range(part.extra.shape[0]):
        own.extra[r, 0], own.extra[r, 1] = weight * part.extra[r, 0], weight * part.extra[r, 1]
