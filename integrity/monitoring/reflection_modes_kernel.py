"""Fault modes of measurements that are doubtful by their odds: which are left out, and the modes of sets of the rest.

The odds of a measurement are those of :mod:`~lanebound.integrity.positioning.reflection_odds_kernel`. Measurements are
independent given their C/N0. Sets of one, two and three of them are fault modes; measurements that would
need more sets than are monitored are not used.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.separation_kernel import Modes, Moments, add_subset
from lanebound.integrity.positioning.geometry_kernel import Geometry
from lanebound.integrity.positioning.reflection_odds_kernel import LARGEST_SET, find_sets, find_sets_of

__all__ = ["add_reflection_modes", "keep_likely"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@jit
def keep_likely(used: Bools, odds: Array, systems: float, reflections: Any, sets: Ints) -> int:
    """Take satellites out of use, the most doubtful first, until few enough sets remain to be monitored, and until
    such a fault together with that of a system, whose priors have the sum ``systems``, is less likely than the limit.

    Returns how many remain. used, odds (S,); reflections of REFLECTION_RULES; sets (D, LARGEST_SET) is scratch.
    """
    member, own, n, total = np.empty(used.shape[0], dtype=np.int64), np.empty(used.shape[0]), 0, 0.0
    for s in range(used.shape[0]):
        if used[s]:
            member[n], own[n] = s, odds[s]
            total += odds[s]
            n += 1
    while n > 0 and (systems * total > reflections.limit or find_sets(own, n, reflections, sets)[0] < 0):
        worst = 0
        for i in range(1, n):
            if own[i] > own[worst]:
                worst = i
        used[member[worst]] = False
        total -= own[worst]
        n -= 1
        member[worst], own[worst] = member[n], own[n]
    return n


@jit(borrows=True)
def add_reflection_modes(
    n: int, count: int, sin_h: float, cos_h: float, odds: Array, group: Ints, reflections: Any, sets: Ints,
    geo: Geometry, moments: Moments, modes: Modes,
) -> tuple[int, float, float]:  # fmt: skip
    """Give the modes of n satellites their odds, and add a mode for each set of doubtful ones.

    The mode of a set bounds the error by the separation that is observed, ``abs(x - x_A) + b_A + K sigma_A``: no test
    has a threshold for it. Returns the number of modes, the prior of single faults without a solution, and the
    probability of two or more faults that no mode covers; 1 when too many sets would be needed.
    """
    removed, total = modes.removed, 0.0
    lost, constellations = 0.0, 0.0
    for k in range(1, count):
        if k > n:
            constellations += modes.prior[k]
        else:
            solved = modes.sigma[0, k] < np.inf
            modes.prior[k], modes.weight[k] = odds[k - 1], odds[k - 1] if solved else 0.0
            modes.log_prior[k] = math.log(odds[k - 1]) if solved else -np.inf
        lost += modes.prior[k] if not modes.sigma[0, k] < np.inf else 0.0
    found, apart = find_sets_of(odds, n, reflections, modes.order, sets)
    if found < 0:
        return count, lost, 1.0
    for i in range(found):
        prior = 1.0
        for k in range(n):
            removed[k] = False
        for j in range(LARGEST_SET):
            k = sets[i, j]
            if k >= 0:
                removed[k] = True
                prior *= odds[k]
        column = count
        count, unsolved = add_subset(column, prior, removed, group, n, sin_h, cos_h, geo, moments, modes)
        apart += unsolved
        modes.k_fa[column] = 1.0
        modes.weight[column] *= 2.0  # both tails: no test bounds the sign of the error against the separation
        modes.log_prior[column] += math.log(2.0)
        for q in range(2):
            modes.delta[q, column] = abs(modes.separation[q, column])
    for k in range(n):
        total += odds[k]
    return count, lost, apart + constellations * total
