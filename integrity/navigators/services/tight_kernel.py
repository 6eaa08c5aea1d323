"""Tight coupling: corrected ranges of any number correct the position reckoned on, one system's two at least.

With the centred design rows g (the clock of each system eliminated), their weights w and the information of the
position reckoned on, ``N = P^-1 + sum w g g'``, gains ``K_i = N^-1 w_i g_i`` and ``A = N^-1 P^-1``. P holds dead
reckoning, fast errors as a white one, and slow errors twice, as ``Var(x + y) <= 2 Var(x) + 2 Var(y)``; 1 / w the same
of a range. So N^-1 is above the variance of the solution whatever the correlation, and ``N_i^-1 - N^-1`` above that of
its separation from the solution without mode i. There is a solution without any satellite: the position reckoned on.

The height is that of the barometer, or free.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_upper
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import lever_bounds
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import LATEST, Epoch
from lanebound.integrity.navigators.services.coupling_kernel import cost_of, fault_bound, on_axis, propose
from lanebound.integrity.navigators.services.coupling_records_kernel import Coupling, Part
from lanebound.integrity.navigators.services.records_kernel import ServiceInputs, ServiceRows, ServiceTables
from lanebound.integrity.positioning.codes_kernel import NO_CORRECTIONS
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, find_sets

__all__ = ["couple_ranges", "offer_coupled"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

FREE_HEIGHT_M2 = 1e8  # variance of a height without an observation


AIDED_RANGE = record(
    e=("f8", (3,), "unit vector to the satellite"),
    group=("i8", "its clock"),
    y="range less that of the predicted position [m]",
    weight="[1/m^2]",
    fast="variance of fast errors [m^2]",
    slow="variance of slow errors [m^2]",
    odds="that the range is off [-]",
    row=("f8", (3,), "centred design row in the last solution, 0 of a range that it leaves out"),
)
"""A range that corrects the position reckoned on."""


class Aided(NamedTuple):
    """Ranges (n,) of AIDED_RANGE and the position that they correct.

    prior (3, 3) information of the position reckoned on; inverse (3, 3) N^-1 and shift (3,) of the last solution.
    """

    ranges: Any
    prior: Array
    inverse: Array
    shift: Array


@jit
def couple_ranges(
    v: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, ranges: ServiceRows, coupling: Coupling,
    hdop: float,
) -> None:  # fmt: skip
    """Offer the position that the ranges of vehicle v correct, if its bound by declared figures is smaller."""
    cases, w, vehicle = epoch.levels.shape[1], epoch.work[v], epoch.vehicles[v]
    part, a = Part(np.zeros(3), np.zeros(3), np.empty((cases, 2))), np.zeros((2, 2))
    aided = gather(v, epoch, service, inputs, ranges, coupling)
    n = aided.ranges.shape[0]
    removed = np.zeros(n, np.bool_)
    if n < 2 or not solve_aided(removed, aided):
        return
    east, north = aided.shift[0], aided.shift[1]
    share_of_ranges(aided, inputs.vehicles[v].height_variance, part, a)
    bound_faults(v, epoch, service, coupling, aided, part)
    before = cost_of(v, epoch, coupling, a, part.fast, part.slow, part.extra[0], False)
    if not cost_of(v, epoch, coupling, a, part.fast, part.slow, part.extra[0], True) < before:
        return
    propose(v, epoch, service.tables.cases, coupling, a, part, epoch.fixed_levels[v])
    fixed, lever = w.fixed, epoch.parameters[0].lever
    fixed.position[0] = vehicle.position[0] + w.sin_h * lever.forward + w.cos_h * lever.right + east
    fixed.position[1] = vehicle.position[1] + w.cos_h * lever.forward - w.sin_h * lever.right + north
    fixed.position[2] = vehicle.position[2]
    offer_coupled(v, n, hdop, epoch, service, ranges, coupling)


@jit
def offer_coupled(
    v: int, satellites: int, hdop: float, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, coupling: Coupling
) -> None:
    """Make the coupled position, which ``fixed.position`` holds, the one that the jump monitor judges."""
    fixed, g, w = epoch.work[v].fixed, coupling.proposals[v].growth, epoch.work[v]
    fixed.p_ee, fixed.p_en, fixed.p_nn = g.p_ee, g.p_en, g.p_nn
    s, c = w.sin_h, w.cos_h
    fixed.sigma[0] = math.sqrt(on_axis(g.p_ee, g.p_en, g.p_nn, s, c))
    fixed.sigma[1] = math.sqrt(on_axis(g.p_ee, g.p_en, g.p_nn, c, -s))
    fixed.satellites, fixed.excluded, fixed.hdop, fixed.usable = satellites, ranges.work[v].excluded, hdop, True
    fixed.status, fixed.coded, fixed.lasting, fixed.wrong, fixed.turned = NO_CORRECTIONS, False, False, 0.0, True
    ranges.labels[v].offered = service.rules[0].mode


@jit
def gather(
    v: int, epoch: Epoch, service: ServiceTables, inputs: ServiceInputs, ranges: ServiceRows, coupling: Coupling
) -> Aided:
    """The ranges in use of vehicle v, and the information of the position reckoned on."""
    n = 0
    for s in range(service.satellites.shape[0]):
        n += ranges.rows[v, s].used
    white = coupling.rules[0].white
    aided = Aided(np.zeros(n, AIDED_RANGE), np.zeros((3, 3)), np.empty((3, 3)), np.empty(3))
    w, vehicle, lever = epoch.work[v], epoch.vehicles[v], epoch.parameters[0].lever
    east = vehicle.position[0] + w.sin_h * lever.forward + w.cos_h * lever.right
    north = vehicle.position[1] + w.cos_h * lever.forward - w.sin_h * lever.right
    known = inputs.vehicles[v].height_variance < math.inf
    up, variance = (
        (inputs.vehicles[v].height, inputs.vehicles[v].height_variance)
        if known
        else (vehicle.position[2], FREE_HEIGHT_M2)
    )
    i = 0
    for s in range(service.satellites.shape[0]):
        if ranges.rows[v, s].used:
            x, row, part = aided.ranges[i], ranges.rows[v, s], ranges.parts[v, s]
            for k in range(3):
                x.e[k] = row.e[k]
            x.group, x.odds = row.system, part.odds
            x.y = row.y + row.e[0] * east + row.e[1] * north + row.e[2] * up
            x.fast, x.slow = part.fast, max(row.variance - part.fast, 0.0)
            x.weight = 1.0 / (white * x.fast + 2.0 * x.slow)
            i += 1
    g, c = vehicle.growth[LATEST], coupling.coupled[v]
    ee = g.p_ee - c.held_ee + c.white_ee + 2.0 * c.slow_ee
    en = g.p_en - c.held_en + c.white_en + 2.0 * c.slow_en
    nn = g.p_nn - c.held_nn + c.white_nn + 2.0 * c.slow_nn
    det = ee * nn - en * en
    if det > 0.0:
        aided.prior[0, 0], aided.prior[0, 1], aided.prior[1, 1] = nn / det, -en / det, ee / det
        aided.prior[1, 0] = aided.prior[0, 1]
    aided.prior[2, 2] = 0.5 / variance
    return aided


@jit
def solve_aided(removed: Bools, aided: Aided) -> bool:
    """Solve without some of the ranges: ``inverse``, ``shift`` and ``rows``, 0 for what is removed."""
    n = aided.ranges.shape[0]
    total, mean, value = np.zeros(MAX_GROUPS), np.zeros((MAX_GROUPS, 3)), np.zeros(MAX_GROUPS)
    for i in range(n):
        if not removed[i]:
            x = aided.ranges[i]
            g = x.group
            total[g] += x.weight
            value[g] += x.weight * x.y
            for k in range(3):
                mean[g, k] -= x.weight * x.e[k]
    m, b = aided.prior.copy(), np.zeros(3)
    for i in range(n):
        x = aided.ranges[i]
        x.row[0], x.row[1], x.row[2] = 0.0, 0.0, 0.0
        if removed[i]:
            continue
        g = x.group
        off = x.y - value[g] / total[g]
        for k in range(3):
            x.row[k] = -x.e[k] - mean[g, k] / total[g]
        for k in range(3):
            b[k] += x.weight * x.row[k] * off
            for j in range(3):
                m[k, j] += x.weight * x.row[k] * x.row[j]
    ok, ee, en, eu, nn, nu, uu = invert_upper(m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2])
    if not ok:
        return False
    inverse = aided.inverse
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = ee, nn, uu
    inverse[0, 1], inverse[0, 2], inverse[1, 2] = en, eu, nu
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = en, eu, nu
    for k in range(3):
        aided.shift[k] = inverse[k, 0] * b[0] + inverse[k, 1] * b[1] + inverse[k, 2] * b[2]
    return True


@jit
def share_of_ranges(aided: Aided, height_variance: float, part: Part, a: Array) -> None:
    """Covariances of what ranges and height add, and A of what remains of the position reckoned on."""
    inverse, prior = aided.inverse, aided.prior
    for i in range(2):
        for j in range(2):
            a[i, j] = inverse[i, 0] * prior[0, j] + inverse[i, 1] * prior[1, j]
    part.fast[:], part.slow[:] = 0.0, 0.0
    for i in range(aided.ranges.shape[0]):
        east, north = gain_of(i, aided)
        for variance, out in ((aided.ranges[i].fast, part.fast), (aided.ranges[i].slow, part.slow)):
            out[0] += variance * east * east
            out[1] += variance * east * north
            out[2] += variance * north * north
    variance = height_variance if height_variance < math.inf else FREE_HEIGHT_M2
    east, north = inverse[0, 2] * prior[2, 2], inverse[1, 2] * prior[2, 2]
    part.slow[0] += variance * east * east
    part.slow[1] += variance * east * north
    part.slow[2] += variance * north * north


@jit
def gain_of(i: int, aided: Aided) -> tuple[float, float]:
    """What a metre of range i does to East and North of the last solution."""
    inverse, found = aided.inverse, aided.ranges[i]
    x, y, z = found.row[0], found.row[1], found.row[2]
    east = inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * z
    north = inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * z
    return found.weight * east, found.weight * north


@jit
def bound_faults(v: int, epoch: Epoch, service: ServiceTables, coupling: Coupling, aided: Aided, part: Part) -> None:
    """Bounds of faults, lasting errors of codes, and the lever arm of the solution with all ranges, for each case."""
    par, w, n, memory = coupling.parameters[0], epoch.work[v], aided.ranges.shape[0], coupling.rules[0].memory
    sets = np.zeros((par.rtk.reflections.sets, LARGEST_SET), np.int64)
    several, gone = find_sets(aided.ranges.odds, n, par.rtk.reflections, sets)
    if several < 0:
        part.extra[:, :] = math.inf
        return
    count = n + several + MAX_GROUPS
    prior, separation, sigma = np.zeros(count), np.zeros((2, count)), np.zeros((2, count))
    constant, whole, shift = np.zeros(2), aided.inverse.copy(), aided.shift.copy()
    constant[0], constant[1] = lever_bounds(epoch.vehicles[v], epoch.faults[v], par)
    for i in range(n):
        east, north = gain_of(i, aided)
        constant[0] += service.rules[0].bias * abs(w.sin_h * east + w.cos_h * north)
        constant[1] += service.rules[0].bias * abs(w.cos_h * east - w.sin_h * north)
    removed = np.zeros(n, np.bool_)
    for k in range(count):
        removed[:] = False
        prior[k] = mark(k, n, several, sets, par, aided, removed)
        if not prior[k] > 0.0:
            continue
        if not solve_aided(removed, aided):
            gone, prior[k] = gone + prior[k], 0.0
            continue
        for q in range(2):
            s, c = (w.sin_h, w.cos_h) if q == 0 else (w.cos_h, -w.sin_h)
            d = aided.inverse - whole
            separation[q, k] = s * (shift[0] - aided.shift[0]) + c * (shift[1] - aided.shift[1])
            sigma[q, k] = math.sqrt(max(s * s * d[0, 0] + 2.0 * s * c * d[0, 1] + c * c * d[1, 1], 0.0))
    if par.risk.constellations:
        gone += prior[n + several :].sum() * aided.ranges.odds.sum()
    for r in range(part.extra.shape[0]):
        budget = service.tables.cases[r].budget
        for q in range(2):
            own = budget[q] / (budget[0] + budget[1])
            found = fault_bound(count, prior, separation[q], sigma[q], budget[q], own * gone, memory)
            part.extra[r, q] = constant[q] + found


@jit
def mark(k: int, n: int, several: int, sets: Ints, par: Any, aided: Aided, removed: Bools) -> float:
    """Mark the ranges that fault mode k removes: its probability, 0 where there is none."""
    if k < n:
        removed[k] = True
        return float(aided.ranges[k].odds)
    if k < n + several:
        odds = 1.0
        for s in sets[k - n]:
            if s >= 0:
                removed[s] = True
                odds *= aided.ranges[s].odds
        return odds
    g = k - n - several
    if not par.risk.constellations:
        return 0.0
    for i in range(n):
        removed[i] = aided.ranges[i].group == g
    return float(par.risk.constellation_prior[g]) if removed.any() else 0.0
