"""The position of a service from its corrected ranges: fault test, protection levels, and whether it is offered.

Satellites are rows with a variance and the odds of a fault; fault modes are single satellites, sets of two and three of
them, and systems. :func:`takes` decides which position is offered, by levels and by the preference of services.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import hdop_of
from lanebound.integrity.monitoring.detection_kernel import EXCLUDED, detect_and_exclude
from lanebound.integrity.monitoring.jump_kernel import bounded, is_suspicious
from lanebound.integrity.monitoring.reflection_modes_kernel import keep_likely
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import (
    FixedScratch,
    fixed_scratch,
    levels_of_fix,
    lever_bounds,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.records_kernel import ServiceInputs, ServiceRows, ServiceTables
from lanebound.integrity.navigators.services.zenith_kernel import CarrierTables, update_zenith
from lanebound.integrity.positioning.codes_kernel import NO_CORRECTIONS, NONE
from lanebound.integrity.positioning.geometry_kernel import SOLVED, find_geometry, solve

__all__ = ["LEAST_ROWS", "check_ranges", "find_fix", "keep_likely", "offer", "pack", "position_of", "takes"]

Array = NDArray[np.float64]

LEAST_ROWS = 5


@jit
def check_ranges(
    first: int, last: int, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, carrier: CarrierTables
) -> None:
    """Exclude doubtful and faulty ranges of vehicles that are due; the zenith delay learns from what remains.

    Vehicles that have an RTK position are tested only where there is a zenith delay to learn.
    """
    par, tables, learns = service.parameters[0], service.tables, carrier.rules[0].zenith
    scratch = fixed_scratch(service.satellites.shape[0], par.rtk.reflections.sets)
    position, q = np.empty(3), np.empty((3, 3))
    for v in range(first, last):
        ranges.work[v].consistent, ranges.work[v].few = False, False
        fixed = epoch.work[v].fixed.usable and ranges.labels[v].offered == 0
        if not ranges.work[v].due or (fixed and not learns):
            continue
        here, odds = ranges.rows[v], ranges.parts[v].odds
        if keep_likely(here.used, odds, 0.0, par.rtk.reflections, scratch.sets) < LEAST_ROWS:
            ranges.work[v].few = True
            continue
        outcome, _, _, _, excluded = detect_and_exclude(
            here, epoch.vehicles[v].heading.angle, tables.thresholds, par.fde, position, q
        )
        ranges.work[v].consistent, ranges.work[v].excluded = outcome <= EXCLUDED, excluded
        if ranges.work[v].consistent and learns:
            update_zenith(v, epoch, service, ranges, carrier)


@jit
def find_fix(
    first: int, last: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, ranges: ServiceRows
) -> None:
    """Offer the position of tested ranges where :func:`takes` says so; without a level where nothing moves another."""
    par, rules = service.parameters[0], service.rules[0]
    scratch = fixed_scratch(service.satellites.shape[0], par.rtk.reflections.sets)
    levels = np.empty((epoch.levels.shape[1], 2))
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if not ranges.work[v].consistent or (w.fixed.usable and ranges.labels[v].offered == 0):
            continue
        used, hdop = position_of(v, epoch, service, inputs, ranges, scratch, levels)
        if used == 0:
            continue
        doubted, alone = is_suspicious(vehicle.jump) and not w.fixed.usable, w.mode == NONE and not w.fixed.usable
        unbounded = alone and not par.cold and not bounded(levels[0]) and not bounded(epoch.levels[v, 0])
        if takes(v, levels, epoch.levels[v], service, ranges) or doubted or unbounded:
            offer(w.fixed, scratch.geo.fix[0], used, ranges.work[v].excluded, hdop)
            epoch.fixed_levels[v, :, :] = levels
            ranges.labels[v].offered = rules.mode


@jit
def position_of(
    v: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, ranges: ServiceRows, scratch: FixedScratch,
    levels: Array,
) -> tuple[int, float]:  # fmt: skip
    """Solve the ranges of vehicle v and fill its levels (R, 2); number of ranges, 0 without a position, and HDOP."""
    par, rules, tables = service.parameters[0], service.rules[0], service.tables
    vehicle, w = epoch.vehicles[v], epoch.work[v]
    used = pack(ranges.rows[v], ranges.parts[v], rules.bias, scratch)
    hdop, geo = hdop_of(ranges.rows[v]), scratch.geo
    if not hdop <= rules.max_hdop:
        return 0, hdop
    geo.fix[0].height, geo.fix[0].height_weight = inputs.vehicles[v].height, 1.0 / inputs.vehicles[v].height_variance
    found = find_geometry(scratch.los, scratch.group, scratch.variance, scratch.bias, used, w.sin_h, w.cos_h, geo)
    if found != SOLVED:
        return 0, hdop
    solve(scratch.y, scratch.group, used, geo)
    levels_of_fix(used, 0.0, w.sin_h, w.cos_h, tables, par, scratch, levels)
    lever_at, lever_ct = lever_bounds(vehicle, epoch.faults[v], par)
    levels[:, 0] += lever_at
    levels[:, 1] += lever_ct
    return used, hdop


@jit
def pack(rows: Records, parts: Records, bias: float, scratch: FixedScratch) -> int:
    """Copy the rows in use into the scratch of the levels; how many."""
    n = 0
    for s in range(rows.shape[0]):
        row = rows[s]
        if row.used:
            for k in range(3):
                scratch.los[n, k] = row.e[k]
            scratch.group[n], scratch.variance[n], scratch.bias[n] = row.group, row.variance, bias
            scratch.y[n], scratch.accuracy[n], scratch.odds[n] = row.y, row.variance, parts[s].odds
            n += 1
    return n


@jit
def takes(v: int, found: Array, expected: Array, service: ServiceTables, ranges: ServiceRows) -> bool:
    """Whether a position of operative levels found (R, 2) replaces the one reckoned on, of the levels expected.

    Levels are compared by the sum of their squares. That of a position moved on from a less preferred service may be up
    to ``preference`` times smaller; that of a more preferred service which has found a position in this epoch, too.
    """
    if not bounded(found[0]):
        return False
    level, factor = found[0, 0] ** 2 + found[0, 1] ** 2, service.rules[0].preference ** 2
    preferred = ranges.work[v].least < factor * level
    ranges.work[v].least = min(ranges.work[v].least, level)
    if preferred:
        return False
    if not bounded(expected[0]):
        return True
    for mode in service.later:
        if mode == ranges.labels[v].latest:
            level /= factor
    return bool(level < expected[0, 0] ** 2 + expected[0, 1] ** 2)


@jit
def offer(fixed: Any, fix: Any, satellites: int, excluded: int, hdop: float) -> None:
    """Make a position the one that the jump monitor judges; nothing of a failed RTK attempt counts for it."""
    for k in range(3):
        fixed.position[k] = fix.position[k]
    fixed.p_ee, fixed.p_en, fixed.p_nn = fix.p_ee, fix.p_en, fix.p_nn
    fixed.sigma[0], fixed.sigma[1] = fix.sigma[0], fix.sigma[1]
    fixed.satellites, fixed.excluded, fixed.hdop, fixed.usable = satellites, excluded, hdop, True
    fixed.status, fixed.coded, fixed.lasting, fixed.wrong, fixed.turned = NO_CORRECTIONS, False, False, 0.0, True
