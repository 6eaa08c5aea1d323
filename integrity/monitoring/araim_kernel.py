"""ARAIM of many epochs of the same satellites: every fault mode by a downdate of a solution that is there already.

For errors of one variance and without biases ``Q_d = Q_A - Q``, as the fault-free solution is the best one. With the
covariance of residuals ``Q_r,ij = V_i delta_ij - g_i'P g_j - [same clock] / W`` and ``u = V S`` of the satellites A::

    sigma_d^2 = u'(Q_r,AA)^-1 u        x - x_A = u'(Q_r,AA)^-1 r_A        sigma_A^2 = sigma^2 + sigma_d^2

A pair is such a downdate of rank two. A system, with or without one more satellite, is a solution of its own and a
downdate of that of rank one. What these cannot solve is solved anew (:mod:`.separation_kernel`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.protection_kernel import multi_hypothesis_pl
from lanebound.integrity.monitoring.separation_kernel import (
    Modes,
    Moments,
    add_subset,
    find_modes,
    mode_scratch,
    moment_scratch,
    set_priors,
)
from lanebound.integrity.positioning.geometry_kernel import (
    SOLVED,
    Geometry,
    capacity,
    find_geometry,
    geometry_scratch,
    solve,
)

__all__ = ["AraimEpochs", "ModeTables", "level_modes"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WELL_SOLVED = 1e-6  # of the share of the variance that is free in the residuals of the satellites removed
AXES = 2


class AraimEpochs(NamedTuple):
    """E epochs of n satellites: los (E, n, 3), with the wanted axes as first columns; group (n,); variance (E, n)
    [m^2]; y (E, n) [m]."""

    los: Array
    group: Ints
    variance: Array
    y: Array


class ModeTables(NamedTuple):
    """Fault modes of several satellites and what the levels need.

    pair (P, 2) satellites; system (G, 2) group, and one more satellite or -1, ascending by group; other (M, n) bool;
    pair_prior, system_prior, other_prior of them [-]; single (MAX_GROUPS,) prior of one satellite [-]; k_fa threshold
    of every separation; budgets (R, 2) risk of each axis if all modes are monitored, whole (R,) the risk of which
    faults that are not monitored take their share, unmonitored the prior of those that are no modes [-].
    """

    pair: Ints
    system: Ints
    other: Bools
    pair_prior: Array
    system_prior: Array
    other_prior: Array
    single: Array
    k_fa: float
    budgets: Array
    whole: Array
    unmonitored: float


class AraimScratch(NamedTuple):
    """Geometry, moments and modes of an epoch; rest: geometry without one system, its los (W, 3), group, variance, y
    and number of each satellite (W,)."""

    geo: Geometry
    moments: Moments
    modes: Modes
    rest: Geometry
    los: Array
    group: Ints
    variance: Array
    y: Array
    number: Ints


@jit
def level_modes(first: int, last: int, epochs: AraimEpochs, tables: ModeTables, levels: Array, worst: Array) -> None:
    """Levels (E, R, 2) of both axes, inf where there is none, and the largest separation in its deviations (E, 2).

    A mode without a solution cannot be monitored: its prior is spent with those of the faults that are no modes (ADD
    v3.1, P_not_monitored).
    """
    n = epochs.group.shape[0]
    subsets = tables.pair.shape[0] + tables.system.shape[0] + tables.other.shape[0]
    w, bias, budgets = capacity(n), np.zeros(capacity(n)), np.empty(tables.budgets.shape)
    x = AraimScratch(
        geometry_scratch(n), moment_scratch(n), mode_scratch(n, subsets), geometry_scratch(n), np.zeros((w, 3)),
        np.zeros(w, dtype=np.int64), np.zeros(w), np.zeros(w), np.zeros(w, dtype=np.int64),
    )  # fmt: skip
    for i in range(first, last):
        levels[i, :, :], worst[i, :] = np.inf, 0.0
        los, variance = epochs.los[i], epochs.variance[i]
        if find_geometry(los, epochs.group, variance, bias, n, 1.0, 0.0, x.geo) != SOLVED:
            continue
        solve(epochs.y[i], epochs.group, n, x.geo)
        count = find_modes(epochs.group, variance, n, 1.0, 0.0, False, False, x.geo, x.moments, x.modes)
        lost = set_priors(epochs.group, n, count, tables.single, tables.single, x.geo.clocks, x.modes)
        count, lost = add_pairs(count, lost, epochs.group, n, tables, x)
        count, lost = add_systems(count, lost, los, variance, epochs, i, tables, x)
        for m in range(tables.other.shape[0]):
            count, unsolved = add_subset(
                count, tables.other_prior[m], tables.other[m], epochs.group, n, 1.0, 0.0, x.geo, x.moments, x.modes
            )
            lost += unsolved
        for k in range(count):
            x.modes.k_fa[k] = tables.k_fa if k else 0.0
            for q in range(AXES):
                if x.modes.delta[q, k] > 0.0:
                    worst[i, q] = max(worst[i, q], abs(x.modes.separation[q, k]) / x.modes.delta[q, k])
        spend(tables.unmonitored + lost, tables, budgets)
        multi_hypothesis_pl(count, budgets, 0.0, False, x.modes, levels[i])


@jit(borrows=True)
def spend(prior: float, tables: ModeTables, budgets: Array) -> None:
    """``budgets (1 - prior / whole)``, the risk left for the modes; 0 where faults not monitored take all of it."""
    for r in range(budgets.shape[0]):
        left = max(1.0 - prior / tables.whole[r], 0.0)
        for q in range(AXES):
            budgets[r, q] = left * tables.budgets[r, q]


@jit
def add_pairs(count: int, lost: float, group: Ints, n: int, tables: ModeTables, x: AraimScratch) -> tuple[int, float]:
    """Add the modes of two satellites; the number of modes, and the prior of those without a solution."""
    geo, modes, removed = x.geo, x.modes, np.zeros(n, np.bool_)
    fix, row, lever, gain, variance, residual = geo.fix[0], geo.row, geo.lever, geo.gain, geo.variance, geo.residual
    last, logarithm = 0.0, -np.inf
    for m in range(tables.pair.shape[0]):
        i, j, prior = tables.pair[m, 0], tables.pair[m, 1], tables.pair_prior[m]
        if prior != last:
            last, logarithm = prior, math.log(prior)
        shared = row[0, i] * lever[0, j] + row[1, i] * lever[1, j] + row[2, i] * lever[2, j]
        if group[i] == group[j]:
            shared += geo.clock[i]
        a, b = variance[i] * geo.free[i], variance[j] * geo.free[j]
        determinant = a * b - shared * shared
        if not determinant > WELL_SOLVED * variance[i] * variance[j]:
            removed[i], removed[j] = True, True
            count, unsolved = add_subset(count, prior, removed, group, n, 1.0, 0.0, geo, x.moments, modes)
            lost += unsolved
            removed[i], removed[j] = False, False
            continue
        inverse = 1.0 / determinant
        for q in range(AXES):
            u, v = gain[q, i] * variance[i], gain[q, j] * variance[j]
            p, o = (u * b + v * shared) * inverse, (v * a + u * shared) * inverse
            square = max(u * p + v * o, 0.0)
            modes.delta[q, count], modes.bias[q, count] = math.sqrt(square), 0.0
            modes.sigma[q, count] = math.sqrt(fix.sigma[q] * fix.sigma[q] + square)
            modes.separation[q, count] = p * residual[i] + o * residual[j]
        modes.prior[count], modes.weight[count], modes.log_prior[count] = prior, prior, logarithm
        count += 1
    return count, lost


@jit
def add_systems(
    count: int,
    lost: float,
    los: Array,
    variance: Array,
    epochs: AraimEpochs,
    i: int,
    tables: ModeTables,
    x: AraimScratch,
) -> tuple[int, float]:
    """Add the modes of a system, alone and with one more satellite, as downdates of the solution without it."""
    geo, rest, modes, n = x.geo, x.rest, x.modes, epochs.group.shape[0]
    at, place, solved, bias = -1, np.empty(n, dtype=np.int64), False, np.zeros(capacity(n))
    for m in range(tables.system.shape[0]):
        g, more, prior = tables.system[m, 0], tables.system[m, 1], tables.system_prior[m]
        if g != at:
            at, left = g, 0
            for s in range(n):
                if epochs.group[s] != g:
                    for k in range(3):
                        x.los[left, k] = los[s, k]
                    x.group[left], x.variance[left], x.y[left] = epochs.group[s], variance[s], epochs.y[i, s]
                    place[s] = left
                    left += 1
            solved = find_geometry(x.los, x.group, x.variance, bias, left, 1.0, 0.0, rest) == SOLVED
            if solved:
                solve(x.y, x.group, left, rest)
        k = place[more] if more >= 0 else 0
        lonely = more >= 0 and rest.clocks[epochs.group[more]].satellites == 1.0
        fails = not solved or (more >= 0 and not lonely and not rest.free[k] > WELL_SOLVED)
        modes.prior[count] = prior
        modes.weight[count], modes.log_prior[count] = (0.0, -np.inf) if fails else (prior, math.log(prior))
        lost += prior if fails else 0.0
        for q in range(AXES):
            modes.bias[q, count] = 0.0
            if fails:
                modes.sigma[q, count], modes.delta[q, count], modes.separation[q, count] = np.inf, 0.0, 0.0
                continue
            sigma, shift = rest.fix[0].sigma[q], _shift(q, geo, rest)
            if more >= 0 and not lonely:
                change = rest.gain[q, k] / rest.free[k]
                sigma = math.sqrt(sigma * sigma + change * change * rest.free[k] * rest.variance[k])
                shift += change * rest.residual[k]
            modes.sigma[q, count], modes.separation[q, count] = sigma, shift
            modes.delta[q, count] = math.sqrt(max(sigma * sigma - geo.fix[0].sigma[q] ** 2, 0.0))
        count += 1
    return count, lost


@jit(borrows=True)
def _shift(q: int, geo: Geometry, rest: Geometry) -> float:
    """``x - x_A`` on axis q: East, or minus North, as for a course to the East."""
    if q == 0:
        return float(geo.fix[0].position[0] - rest.fix[0].position[0])
    return float(rest.fix[0].position[1] - geo.fix[0].position[1])
