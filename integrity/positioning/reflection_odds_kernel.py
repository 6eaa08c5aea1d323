"""Carriers that may not be direct: their odds from C/N0, and the sets of them that a fix has to survive without.

A reflected or diffracted carrier is weak for its elevation. The odds that a carrier is off grow with its loss d [dB]
below the C/N0 of an open sky, ``o = most / (1 + exp((centre - d) / scale))``, to which the prior of other faults is
added. They stay at their largest value for as long as the integers are held: a carrier that was reflected in between
keeps a wrong integer. Carriers are independent given their C/N0. Then ``prod (1 + o_s)`` is the sum of the odds of all
sets, and what is left of it bounds the probability of the sets that are not monitored.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["LARGEST_SET", "REFLECTION_RULES", "find_sets", "keep_trusted", "odds_of", "update_odds"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST_SET = 3
HALVINGS = 24  # of the odds from which on sets are monitored, beginning with the limit

REFLECTION_RULES = record(
    sets=("i8", "sets of two and three satellites that are monitored at most, 0: no hypotheses"),
    zenith="C/N0 of an open sky at the zenith [dB-Hz]",
    horizon="the same at the horizon [dB-Hz]",
    most="odds of a weak carrier [-]",
    centre="loss at which the odds are half of that [dB]",
    scale="steepness [dB]",
    limit="largest probability of the sets that are not monitored [-]",
    single="odds from which on a fix is confirmed without the satellite [-]",
)
"""ReflectionHypothesesConfig as kernels take it."""


@jit
def odds_of(rules: Any, sine: float, cn0: float) -> float:
    """Odds that a signal is off [-], by the sine of its elevation and its C/N0 [dB-Hz]."""
    loss = rules.horizon + (rules.zenith - rules.horizon) * sine - cn0
    return float(rules.most / (1.0 + math.exp((rules.centre - loss) / rules.scale)))


@jit
def update_odds(signals: Records, satellites: Records, rules: Any, ambiguities: Records) -> None:
    """Set the odds of the satellites that are tracked; those of held integers only grow."""
    for s in range(signals.shape[0]):
        signal = signals[s]
        if signal.tracked:
            odds = odds_of(rules, signal.e[2], signal.cn0) + satellites[s].prior
            ambiguity = ambiguities[s]
            ambiguity.odds = max(ambiguity.odds, odds) if ambiguity.held else odds


@jit
def find_sets(odds: Array, n: int, rules: Any, sets: Ints) -> tuple[int, float]:
    """The sets of two and three of n satellites to monitor, most likely first by halves: their number, and the
    probability of all other sets of two and more.

    odds (>= n,) [-]; sets (>= rules.sets, LARGEST_SET) receives indices, -1 for none. The number is -1 when more than
    ``rules.sets`` would be needed.
    """
    found, left = find_sets_of(odds, n, rules, np.empty(n, dtype=np.int64), sets)
    return int(found), float(left)


@jit(borrows=True)
def find_sets_of(odds: Array, n: int, rules: Any, order: Ints, sets: Ints) -> tuple[int, float]:
    """:func:`find_sets`, for which order (>= n,) is scratch."""
    everything, single = 1.0, 0.0
    for i in range(n):
        k = i
        while k > 0 and odds[order[k - 1]] < odds[i]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        everything *= 1.0 + odds[i]
        single += odds[i]
    left, least = max(everything - 1.0 - single, 0.0), rules.limit
    if left <= rules.limit:
        return 0, left
    for _ in range(HALVINGS):
        count, seen = _sets_above(least, odds, n, order, rules.sets, sets)
        if count < 0:
            break
        if left - seen <= rules.limit:
            return count, max(left - seen, 0.0)
        least *= 0.5
    return -1, left


@jit(borrows=True)
def _sets_above(least: float, odds: Array, n: int, order: Ints, most: int, sets: Ints) -> tuple[int, float]:
    """Number and total odds of the sets of two and three with odds of ``least`` and more; -1: above ``most``."""
    count, seen = 0, 0.0
    for i in range(n):
        for j in range(i + 1, n):
            pair = odds[order[i]] * odds[order[j]]
            if pair < least:
                break
            for k in range(j, n):
                product = pair if k == j else pair * odds[order[k]]
                if product < least:
                    break
                if count == most:
                    return -1, seen
                sets[count, 0], sets[count, 1], sets[count, 2] = order[i], order[j], -1 if k == j else order[k]
                count, seen = count + 1, seen + product
    return count, seen


@jit
def keep_trusted(marks: Records, unused: float, rules: Any, ambiguities: Records) -> None:
    """Take satellites out of use, the most doubtful first, until the sets to monitor are few enough.

    Their integers are released, and with them the memory of their odds; their ``factor`` becomes ``unused``.
    """
    member, odds, n = np.empty(marks.shape[0], dtype=np.int64), np.empty(marks.shape[0]), 0
    sets = np.empty((rules.sets, LARGEST_SET), dtype=np.int64)
    for s in range(marks.shape[0]):
        if marks[s].used:
            member[n], odds[n] = s, ambiguities[s].odds
            n += 1
    while n > 0 and find_sets(odds, n, rules, sets)[0] < 0:
        worst = 0
        for i in range(1, n):
            if odds[i] > odds[worst]:
                worst = i
        s = member[worst]
        marks[s].used, marks[s].factor, ambiguities[s].held = False, unused, False
        n -= 1
        member[worst], odds[worst] = member[n], odds[n]
