"""Integer resolution of one vehicle's carriers: float solution, choice of what the risk allows, acceptance.

A carrier that is off by half a cycle spoils every set that it belongs to. When the test refuses a set, :func:`resolve`
therefore finds which carrier is most likely off and tries again without it, a few times in the same epoch. The choice
must not cost more risk than is allowed, and it depends on the data, so that the failure rate of the set tried last is
not enough: the bound must cover *any* set that might have been chosen and comes out wrong. There is the whole set,
which gets the share FIRST_SHARE of the limit ``L``, and ``m`` sets that lack one of its m satellites. One of these is
accepted only when its own failure rate is within ``(1 - FIRST_SHARE) L / m``. Rates follow from the geometry and not
from the data, so by the union bound, whatever the order and the number of the attempts,

``P(wrong and accepted) <= P_IF + sum_j P_IF,j [P_IF,j <= (1 - FIRST_SHARE) L / m] <= L``.

A fix found by leaving one out is held with the risk ``P_IF + (1 - FIRST_SHARE) L``. The bound holds for right models: a
set that still contains the faulty carrier has no right integers, and its fit and ratio must refuse it.

With ``posterior``, a set whose failure rate is above its limit may still be fixed: where, given the measurements, the
probability that another vector is right is within the same limit (below). The bound above holds with
that limit in the place of ``P_IF``, because which of the two rules a set is judged by follows from the geometry alone.

Letters: ``x`` (3,) position and ``q`` (3, 3) its covariance from the code, both completed by the held phases; ``a`` the
float ambiguities and ``Q_a`` their covariance; ``P_IF`` the bootstrapped failure rate of a set.

Probability that the best integers are wrong, given the float ambiguities: with normal errors of the declared covariance
and no preference for any integers beforehand, the float solution ``a`` gives a vector ``z`` the probability ``exp(-q_z
/ 2) / sum_u exp(-q_u / 2)``, ``q_z = (a - z)' Q^-1 (a - z)``. Accepting the best vector only where that of all others
together is at most ``L`` is wrong with a probability of at most ``L``: ``P(wrong and accepted) = E[P(wrong | a);
accepted] <= L``. Float solutions differ from the true integers by an error whose law does not depend on them, so that
the mean over integers is also the probability for the true ones. Of all rules with that failure rate this one accepts
most (Teunissen 2005, Artificial Satellites 40, 219-227).

The bootstrapped failure rate is known before the measurements; this probability belongs to them. Errors that are
smaller than their usual size show themselves by the distance between the best vector and the others. The largest
distance is that of float ambiguities that are integers: where half of ``min z' Q^-1 z`` is below ``-ln L``, nothing is
accepted.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_3x3, multiply_3
from lanebound.integrity.positioning.codes_kernel import FIXED, NOT_CONVERGED, RATIO_FAILED, SEARCH_FAILED, TOO_FEW
from lanebound.integrity.positioning.float_filter_kernel import (
    FloatFilters,
    filtered_ambiguities,
    find_searchable,
    invert_positive,
)
from lanebound.integrity.positioning.lambda_kernel import (
    OK,
    SearchScratch,
    bootstrap_failure_rate,
    integer_least_squares,
    largest_prefix,
    search_scratch,
)
from lanebound.integrity.positioning.ratio_kernel import minimum_ratio
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import (
    BASE,
    Carriers,
    add_layer,
    collapse_phase,
    drop_small_systems,
    float_ambiguities,
    held_base,
    held_risk,
    order_by_variance,
    owner_of,
)

__all__ = ["FloatSource", "add_held", "attempt", "others_probability", "resolve", "source_of"]

Array = NDArray[np.float64]


SKIPPED = 1e-4  # of the limit: branches of less are bounded, not searched
SAME = 1e-9  # a weight within it of the best one is the best vector itself


@jit
def row_sum(variance: float) -> float:
    """``sum_k exp(-k^2 / (2 variance))`` over all integers: the largest sum over a row of them.

    Poisson's formula gives ``sqrt(2 pi variance) (1 + 2 sum_m exp(-2 pi^2 variance m^2))`` for large variances.
    """
    if variance > 1.0:
        return math.sqrt(2.0 * math.pi * variance) * (1.0 + 2.0 * math.exp(-2.0 * math.pi**2 * variance))
    total = 1.0
    for k in range(1, 9):
        total += 2.0 * math.exp(-0.5 * k * k / variance)
    return total


@jit
def others_probability(n: int, limit: float, scale: float, node_limit: int, scratch: SearchScratch) -> float:
    """Bound of the probability that not the best vector but another is right; inf where it is above ``limit``.

    The covariance is that of the last :func:`~.lambda_kernel.integer_least_squares`, multiplied by ``scale``;
    ``scratch`` still holds its decorrelated ambiguities, of which all vectors are summed depth first. Of a branch whose
    first j ambiguities are open, with norm q so far, the sum is at most ``exp(-q / 2) prod_i<j row_sum(D_i)``: branches
    below SKIPPED of the limit enter by that bound. ``node_limit`` nodes at most, otherwise inf.
    """
    U, D, S, z_float = scratch.U, scratch.D, scratch.S, scratch.z_float
    distance, mean, z, step, best = scratch.distance, scratch.mean, scratch.z, scratch.step, scratch.norms[0]
    open_sum, along = np.ones(n + 1), np.empty(n)
    for i in range(n):
        along[i] = row_sum(scale * D[i])
        open_sum[i + 1] = open_sum[i] * along[i]
        S[n - 1, i] = z_float[i]
    k, total, met = n - 1, 0.0, False
    distance[k], mean[k] = 0.0, z_float[k]
    z[k] = np.floor(mean[k] + 0.5)
    step[k] = 1.0 if mean[k] > z[k] else -1.0
    for _ in range(node_limit):
        y = mean[k] - z[k]
        norm = distance[k] + y * y / D[k]
        weight = math.exp(-0.5 * (norm - best) / scale)
        rest = weight * open_sum[k] * (1.0 + along[k])  # of this branch and of those further off on either side
        if rest < SKIPPED * limit:
            total += rest
            if k == n - 1:
                return total if total <= limit else math.inf
            k += 1
        elif k > 0:
            k -= 1
            distance[k] = norm
            for q in range(k + 1):
                S[k, q] = S[k + 1, q] - y * U[q, k + 1]
            mean[k] = S[k, k]
            z[k] = np.floor(mean[k] + 0.5)
            step[k] = 1.0 if mean[k] > z[k] else -1.0
            continue
        elif not met and weight > 1.0 - SAME:
            met = True
        else:
            total += weight
        if total > limit:
            return math.inf
        z[k] += step[k]
        step[k] = -step[k] - (1.0 if step[k] > 0.0 else -1.0)
    return math.inf


Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NODE_LIMIT = 20_000
FIRST_SHARE = 0.5  # of the risk, for the set of all candidates; the rest is for the sets that lack one of them


class FloatSource(NamedTuple):
    """Where float ambiguities come from.

    ``filtered``: from the filter ``own`` over epochs, None without one; otherwise from one epoch: its position ``x``
    (3,) with covariance ``q`` (3, 3), and the clocks ``base`` (MAX_GROUPS,) of BASE that the held satellites give.
    """

    x: Array
    q: Array
    base: Records
    own: FloatFilters | None
    filtered: bool


class Floats(NamedTuple):
    """``satellites`` of them in ``order``, their ``n`` ambiguities with owners, and covariance."""

    satellites: int
    order: Ints
    n: int
    owner: Ints
    ambiguity: Array
    covariance: Array


@jit(borrows=True)
def any_held(ambiguities: Records) -> bool:
    """Whether any ambiguity is held."""
    for s in range(ambiguities.shape[0]):
        if ambiguities[s].held:
            return True
    return False


@jit
def add_held(carriers: Carriers, ambiguities: Records, rules: Any, x: Array, q: Array) -> bool:
    """Complete the position of the code with the held phases in place, by adding normal matrices; False: singular."""
    if not any_held(ambiguities):
        return True
    normal, rhs, rows = np.empty((3, 3)), np.empty(3), np.empty(ambiguities.shape[0], ROW)
    if not invert_3x3(q, normal):
        return False
    multiply_3(normal, x, rhs)
    collapse_phase(carriers, ambiguities, rules.bands, rows)
    for s in range(rows.shape[0]):
        row = rows[s]
        row.group, row.used = carriers.satellites[s].system, ambiguities[s].held
        row.variance = carriers.variance[s] / rules.bands
        for k in range(3):
            row.e[k] = carriers.signals[s].e[k]
    add_layer(rows, normal, rhs)
    if not invert_3x3(normal, q):
        return False
    multiply_3(q, rhs, x)
    return True


@jit
def source_of(
    carriers: Carriers, ambiguities: Records, bands: int, x: Array, q: Array, own: FloatFilters | None, filtered: bool
) -> FloatSource:
    """The source with the clocks that the held satellites give.

    A function of its own, as ``x`` may be the field of a record: :func:`attempt` would be compiled for it once more.
    """
    base = np.zeros(MAX_GROUPS, BASE)
    held_base(carriers, ambiguities, bands, base)
    return FloatSource(x, q, base, own, filtered)


@jit
def float_solution(
    carriers: Carriers,
    candidate: Bools,
    ambiguities: Records,
    source: FloatSource,
    own: FloatFilters | None,
    rules: Any,
) -> Floats:
    """Float ambiguities of the most precise candidates, from the filter or from the position of everything else."""
    bands, most = rules.bands, rules.max_candidates
    order = np.empty(most, dtype=np.int64)
    if own is not None:  # known when it is compiled: without a filter the rest of this branch is not compiled
        if source.filtered:
            searchable = np.empty(candidate.shape[0], dtype=np.bool_)
            find_searchable(candidate, carriers.satellites, ambiguities, own.slots, searchable)
            candidate = searchable
    count = order_by_variance(candidate, carriers.variance, most, order)
    c = bands * count
    owner, a_hat, q_a = np.empty(c, dtype=np.int64), np.empty(c), np.empty((c, c))
    if own is not None:
        if source.filtered:
            n = filtered_ambiguities(carriers, order, count, ambiguities, own, rules, a_hat, q_a, owner)
            return Floats(count, order, n, owner, a_hat, q_a)
    n = float_ambiguities(carriers, order, count, bands, source.x, source.q, source.base.copy(), a_hat, q_a, owner)
    return Floats(count, order, n, owner, a_hat, q_a)


@jit(borrows=True)
def is_reference(s: int, floats: Floats) -> bool:
    """Whether candidate s has no ambiguity of its own: its system's clock is counted from it."""
    for i in range(floats.n):
        if floats.owner[i] == s:
            return False
    return True


@jit(borrows=True)
def choose(
    carriers: Carriers, floats: Floats, ambiguities: Records, rules: Any, limit: float, scratch: SearchScratch,
    chosen: Bools,
) -> tuple[int, int, float]:  # fmt: skip
    """The most precise candidates whose bootstrapped failure rate stays within ``limit``.

    Sets ``chosen`` (S,) to what would then be held; a system's reference is fixed with the first of its satellites.
    Returns (status, satellites with ambiguities, P_IF): FIXED when the set is large enough for a position. Where no set
    is precise enough, P_IF is that of all candidates.
    """
    bands, owner, satellites = rules.bands, floats.owner, carriers.satellites
    groups, rate = largest_prefix(floats.n // bands, bands, floats.covariance, limit, scratch)
    if groups <= 0:
        return NOT_CONVERGED, 0, bootstrap_failure_rate(0, floats.n, scratch.D) if groups == 0 and floats.n else 1.0
    for s in range(chosen.shape[0]):
        chosen[s] = ambiguities[s].held
    for j in range(groups):
        chosen[owner[bands * j]] = True
    for i in range(floats.satellites):
        s = floats.order[i]
        if not chosen[s] and is_reference(s, floats):
            for j in range(groups):
                if satellites[owner[bands * j]].system == satellites[s].system:
                    chosen[s] = True
    members, systems = drop_small_systems(chosen, satellites, rules.min_further)
    if members < rules.min_satellites + rules.min_further * (systems - 1) or systems == 0:
        return TOO_FEW, 0, 0.0
    return FIXED, groups, rate


@jit(inline=True)
def accept(
    floats: Floats, groups: int, rate: float, limit: float, rules: Any, scratch: SearchScratch
) -> tuple[int, float]:  # fmt: skip
    """Integer least squares of the first ``groups`` satellites and the tests of its best candidate.

    The best norm is chi-square when the integers are right, so that one above ``misfit`` shows that a carrier is off.
    Where the failure ``rate`` is within the limit, the ratio is that of a fixed failure rate, at least ``ratio_min``.
    Where it is not, the probability that another vector is right, given the measurements, must be, and the ratio above
    ``ratio_min``. The covariance is multiplied for it by ``posterior``, or by what the residuals show if that is more.

    Returns a status and the probability of failure.
    """
    n, norms = rules.bands * groups, scratch.norms
    if integer_least_squares(n, floats.ambiguity, floats.covariance, NODE_LIMIT, False, scratch) != OK:
        return SEARCH_FAILED, rate
    if norms[0] > rules.misfit[n]:
        return RATIO_FAILED, rate
    if rate <= limit or not rules.posterior > 0.0:
        ratio = minimum_ratio(n, rate, limit, rules.ratio_min)
        return (RATIO_FAILED if norms[1] < ratio * norms[0] else FIXED), rate
    scale = max(rules.posterior, norms[0] / n)
    if norms[1] - norms[0] < -2.0 * scale * math.log(limit):
        return NOT_CONVERGED, rate
    failure = others_probability(n, limit, scale, NODE_LIMIT, scratch)
    if not failure <= limit:
        return NOT_CONVERGED, rate
    return (RATIO_FAILED if norms[1] < rules.ratio_min * norms[0] else FIXED), failure


@jit
def largest_rate(limit: float) -> float:
    """Largest failure rate with which the probability of other vectors is searched: ``erfc(sqrt(-ln(limit)) / 2)``.

    That of one ambiguity whose neighbours are just improbable enough where it happens to be an integer,
    ``1 / variance = -2 ln(limit)``. Sets of many ambiguities may be acceptable above it; it bounds the work.
    """
    return math.erfc(0.5 * math.sqrt(max(-math.log(max(limit, 1e-300)), 0.0)))


@jit
def relief(pull: Array, weight: Array, own: Array, column: Ints, columns: int) -> float:
    """By how much the norm falls when one satellite's ambiguities are left free: ``g' H^-1 g``.

    ``own`` (n,) is the sign with which the satellite enters each ambiguity; ``g = C'Wv`` and ``H = C'WC``, where C has
    a column for each band and signal, of which ``column`` (n,) is that of each ambiguity.
    """
    g, h = np.zeros(columns), np.zeros((columns, columns))
    for i in range(own.shape[0]):
        if own[i] != 0.0:
            g[column[i]] += own[i] * pull[i]
            for k in range(own.shape[0]):
                h[column[i], column[k]] += own[i] * own[k] * weight[i, k]
    if columns == 1:
        return float(g[0] * g[0] / h[0, 0])
    inverse, norm = np.empty((columns, columns)), 0.0
    if not invert_positive(h, columns, inverse):
        return 0.0  # nothing tells the signals of this satellite apart
    for i in range(columns):
        for k in range(columns):
            norm += g[i] * inverse[i, k] * g[k]
    return norm


@jit(inline=True)
def suspect(
    floats: Floats, groups: int, ambiguities: Records, chosen: Bools, carriers: Carriers, bands: int, best: Array,
    relieved: Array,
) -> int:  # fmt: skip
    """How far each satellite of a refused set explains the misfit of its ``best`` integers (n,); returns their number.

    ``relieved`` (S,) is the part of the norm ``v' Q_a^-1 v`` that would vanish without the satellite (:func:`relief`),
    and -1 for those outside the set. A reference enters all ambiguities of its system, with the opposite sign. A
    satellite and its further signals are one.
    """
    satellites, n = carriers.satellites, bands * groups
    weight, pull, own, count = np.empty((n, n)), np.zeros(n), np.empty(n), 0
    column = np.empty(n, dtype=np.int64)
    relieved[:] = -1.0
    if not invert_positive(floats.covariance, n, weight):
        return 0
    for i in range(n):
        for k in range(n):
            pull[i] += weight[i, k] * (floats.ambiguity[k] - best[k])
    for j in range(floats.satellites):
        s = owner_of(satellites, floats.order[j])
        if relieved[s] >= 0.0:
            continue
        own[:], column[:], columns = 0.0, 0, 0
        for j2 in range(j, floats.satellites):
            s2 = floats.order[j2]
            if owner_of(satellites, s2) != s or not chosen[s2] or ambiguities[s2].held:
                continue
            reference, any_own = is_reference(s2, floats), False
            for i in range(n):
                sign = 0.0
                if floats.owner[i] == s2:
                    sign = 1.0
                elif reference and satellites[floats.owner[i]].system == satellites[s2].system:
                    sign = -1.0
                if sign != 0.0:
                    own[i], column[i], any_own = sign, columns + i % bands, True
            columns += bands if any_own else 0
        if columns > 0:
            relieved[s] = relief(pull, weight, own, column, columns)
            count += 1
    return count


@jit(borrows=True)
def hold(
    floats: Floats, groups: int, bands: int, best: Array, chosen: Bools, ambiguities: Records, next_id: int, risk: float
) -> None:
    """Hold what was chosen with the ``best`` integers (n,); references count from zero."""
    for s in range(chosen.shape[0]):
        held = ambiguities[s]
        if chosen[s] and not held.held:
            held.held = True
            held.fix_id = next_id
            held.fix_risk = risk
            held.integers[0] = 0.0
            held.integers[1] = 0.0
    for i in range(bands * groups):
        if chosen[floats.owner[i]]:
            ambiguities[floats.owner[i]].integers[i % bands] = best[i]


@jit
def attempt(
    carriers: Carriers, candidate: Bools, ambiguities: Records, source: FloatSource, rules: Any, limit: float,
    next_id: int, further: float, chosen: Bools, relieved: Array,
) -> tuple[int, float, int]:  # fmt: skip
    """Fix one set of candidates within ``limit``, held with ``further`` risk in addition to its own.

    Returns (status, P_IF, satellites under suspicion); ``chosen`` is set, and ``relieved`` when the set is refused.
    """
    floats = float_solution(carriers, candidate, ambiguities, source, source.own, rules)
    scratch = search_scratch(floats.ambiguity.shape[0], 2)
    status, groups, rate = choose(carriers, floats, ambiguities, rules, limit, scratch, chosen)
    if status != FIXED and rules.posterior > 0.0:
        largest = largest_rate(limit)
        again, groups, higher = choose(carriers, floats, ambiguities, rules, largest, scratch, chosen)
        if again == FIXED:
            status, rate = FIXED, higher
    if status != FIXED:
        return status, rate, 0
    (status, failure), count, best = accept(floats, groups, rate, limit, rules, scratch), 0, scratch.candidates[0]
    if status == FIXED:
        hold(floats, groups, rules.bands, best, chosen, ambiguities, next_id, failure + further)
    elif status == RATIO_FAILED:
        count = suspect(floats, groups, ambiguities, chosen, carriers, rules.bands, best, relieved)
    return status, rate, count


@jit(inline=True)
def resolve(
    carriers: Carriers, candidate: Bools, ambiguities: Records, rules: Any, x: Array, q: Array,
    own: FloatFilters | None, filtered: bool, next_id: int,
) -> tuple[int, float]:  # fmt: skip
    """Fix the ambiguities of as many candidate satellites as the risk allows, and hold them.

    The float solution is that of the filter ``own`` if ``filtered``; otherwise it takes the position ``x``,
    ``q`` of the code (completed in place) and the phases already held. The most precise candidates whose bootstrapped
    failure rate stays within what is left of the limit are fixed together
    by integer least squares and accepted by fit and ratio. Where these refuse, the sets that leave one satellite out
    are tried, beginning with the satellite that explains most of the misfit. A fix that would leave fewer than
    ``min_satellites`` (systems with fewer than ``min_further`` not counted) is not held.

    ambiguities (S,) of AMBIGUITY, advanced in place; rules of RTK_RULES. Returns a status of
    :class:`~lanebound.integrity.positioning.modes.RtkStatus` (FIXED: something new is held) and the P_IF of the
    first set.
    """
    if not add_held(carriers, ambiguities, rules, x, q):
        return TOO_FEW, 1.0
    n_sat, source = candidate.shape[0], source_of(carriers, ambiguities, rules.bands, x, q, own, filtered)
    chosen, relieved, unread = np.empty(n_sat, dtype=np.bool_), np.empty(n_sat), np.empty(n_sat)
    left = rules.fix_limit - held_risk(ambiguities)
    first, rest = FIRST_SHARE * left, (1.0 - FIRST_SHARE) * left
    status, rate, sets = attempt(carriers, candidate, ambiguities, source, rules, first, next_id, 0.0, chosen, relieved)
    others = candidate.copy()
    further = rate + rest if rate <= first else first + rest - rest / max(sets, 1)  # with its own within the limit
    for _ in range(min(rules.attempts, sets)):
        worst = np.argmax(relieved)
        relieved[worst] = -1.0
        for s in range(n_sat):
            others[s] = candidate[s] and owner_of(carriers.satellites, s) != worst
        again, _, _ = attempt(
            carriers, others, ambiguities, source, rules, rest / sets, next_id, further, chosen, unread
        )
        if again == FIXED:
            return FIXED, rate
    return int(status), rate
