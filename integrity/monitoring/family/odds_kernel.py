"""Codes that are weak for their elevation as fault modes with odds, by epoch: which are left out, and the levels.

The modes are those of :mod:`~lanebound.integrity.monitoring.reflection_modes_kernel`: single codes with the threshold
of their test, sets of two and three of them and whole systems with the separation that is observed,
``abs(x - x_A) + K sigma_A``, as no test of the family bounds it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.protection_kernel import multi_hypothesis_pl, split_budgets
from lanebound.integrity.monitoring.reflection_modes_kernel import add_reflection_modes, keep_likely
from lanebound.integrity.monitoring.separation_kernel import (
    Modes,
    find_modes,
    mode_scratch,
    moment_scratch,
    set_factors,
    set_priors,
)
from lanebound.integrity.positioning.geometry_kernel import SOLVED, capacity, find_geometry, geometry_scratch, solve
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, odds_of

__all__ = ["OddsTables", "WeighedCodes", "find_odds", "level_codes", "trust_codes"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class WeighedCodes(NamedTuple):
    """E epochs of N codes: los (E, N, 3), used (E, N) bool, group (N,), variance (E, N) [m^2], y (E, N) [m], odds
    (E, N) of an error that the variance does not bound [-]."""

    los: Array
    used: Bools
    group: Ints
    variance: Array
    y: Array
    odds: Array


class OddsTables(NamedTuple):
    """reflections (1,) of REFLECTION_RULES; constellation (MAX_GROUPS,) prior of each system [-]; k_fa (C, K) threshold
    by the number of modes and by rank, as set_factors takes it; risks (R,) of the plane [-]."""

    reflections: Records
    constellation: Array
    k_fa: Array
    risks: Array


@jit
def find_odds(first: int, last: int, sine: Array, cn0: Array, prior: float, reflections: Records, odds: Array) -> None:
    """Odds of codes (n,) by the sine of the elevation and C/N0 [dB-Hz], next to the prior of all other faults."""
    rules = reflections[0]
    for k in range(first, last):
        odds[k] = prior + odds_of(rules, sine[k], cn0[k])


@jit
def trust_codes(first: int, last: int, used: Bools, group: Ints, odds: Array, tables: OddsTables) -> None:
    """Take codes out of use, the most doubtful first, until the sets of the rest can be monitored.  (E, N)."""
    reflections = tables.reflections[0]
    sets = np.empty((reflections.sets, LARGEST_SET), dtype=np.int64)
    for i in range(first, last):
        present, systems = 0, 0.0
        for s in range(group.shape[0]):
            if used[i, s] and not present >> group[s] & 1:
                present |= 1 << group[s]
                systems += tables.constellation[group[s]]
        keep_likely(used[i], odds[i], systems, reflections, sets)


@jit
def level_codes(first: int, last: int, codes: WeighedCodes, tables: OddsTables, levels: Array) -> None:
    """Levels of East and North (E, R, 2) with half of the risk each; inf where there is none."""
    reflections, size = tables.reflections[0], codes.used.shape[1]
    w, subsets = capacity(size), reflections.sets
    geo, modes, moments = geometry_scratch(size), mode_scratch(size, subsets), moment_scratch(size)
    los, group, odds = np.zeros((w, 3)), np.zeros(w, dtype=np.int64), np.zeros(w)
    variance, bias, y = np.zeros(w), np.zeros(w), np.zeros(w)
    sets = np.empty((subsets, LARGEST_SET), dtype=np.int64)
    satellite, budgets = np.ones(tables.constellation.shape[0]), np.empty((tables.risks.shape[0], 2))
    for i in range(first, last):
        levels[i, :, :] = np.inf
        n = 0
        for s in range(size):
            if codes.used[i, s]:
                for k in range(3):
                    los[n, k] = codes.los[i, s, k]
                group[n], variance[n], y[n] = codes.group[s], codes.variance[i, s], codes.y[i, s]
                odds[n] = codes.odds[i, s]
                n += 1
        if find_geometry(los, group, variance, bias, n, 1.0, 0.0, geo) != SOLVED:
            continue
        solve(y, group, n, geo)
        count = find_modes(group, variance, n, 1.0, 0.0, True, False, geo, moments, modes)
        set_priors(group, n, count, satellite, tables.constellation, geo.clocks, modes)
        set_factors(n, count, tables.k_fa[count - 1], 0.0, geo.clocks, modes)
        observe(n + 1, count, modes)
        count, lost, apart = add_reflection_modes(
            n, count, 1.0, 0.0, odds, group, reflections, sets, geo, moments, modes
        )
        split_budgets(tables.risks, 0.5, apart, budgets)
        multi_hypothesis_pl(count, budgets, lost, True, modes, levels[i])


@jit(borrows=True)
def observe(first: int, last: int, modes: Modes) -> None:
    """Bound the modes first to last - 1 by the separation that is observed, and count both tails."""
    for k in range(first, last):
        modes.k_fa[k] = 1.0
        modes.weight[k] *= 2.0
        modes.log_prior[k] += math.log(2.0)
        for q in range(2):
            modes.delta[q, k] = abs(modes.separation[q, k])
