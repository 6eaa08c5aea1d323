"""Integer resolution of one vehicle's carriers: float solution, choice of what the risk allows, acceptance.

A carrier that is off by half a cycle spoils every set it is in. When the test refuses a set, :func:`resolve` therefore
asks which carrier is off and tries again without it, a few times in the same epoch. Its own choice must not cost more
risk than is allowed, and the choice looks at the data, so that the failure rate of the set tried last says little: what
counts is that *any* set that might have been chosen comes out wrong. There is the whole set, which gets the share
FIRST_SHARE of the limit ``L``, and ``m`` sets that lack one of its m satellites. One of these is only accepted when its
own failure rate is within ``(1 - FIRST_SHARE) L / m``. Rates follow from the geometry and not from the data, so by the
union bound, however the order of the attempts comes about and however many there are,

``P(wrong and accepted) <= P_IF + sum_j P_IF,j [P_IF,j <= (1 - FIRST_SHARE) L / m] <= L``.

A fix found by leaving one out is held with the risk ``P_IF + (1 - FIRST_SHARE) L``. The bound holds for right models: a
set that still contains the faulty carrier has no right integers, and must be refused by its fit and its ratio.

Letters: ``x`` (3,) position and ``q`` (3, 3) its covariance from the code, both completed by the held phases; ``a`` the
float ambiguities and ``Q_a`` their covariance; ``P_IF`` the bootstrapped failure rate of a set.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_3x3, multiply_3
from lanebound.integrity.positioning.lambda_kernel import OK, integer_least_squares, largest_prefix
from lanebound.integrity.positioning.ratio_kernel import minimum_ratio
from lanebound.integrity.positioning.rtk_kernel import (
    add_layer,
    collapse_phase,
    drop_small_systems,
    float_ambiguities,
    held_base,
    held_risk,
    order_by_variance,
)

__all__ = ["Carriers", "Fixes", "Rules", "resolve"]

NODE_LIMIT = 20_000
FIRST_SHARE = 0.5  # of the risk, for the set of all candidates; the rest is for the sets that lack one of them
FIXED, TOO_FEW, NOT_CONVERGED, RATIO_FAILED, SEARCH_FAILED = 0, 2, 3, 4, 6  # codes of RtkStatus


class Carriers(NamedTuple):
    """Phases of one epoch: e (S, 3), system (S,), phase (S, 2) [m], variance (S,) of one band [m^2]."""

    e: Any
    system: Any
    phase: Any
    variance: Any


class Fixes(NamedTuple):
    """What is held: held (S,) bool, integers (S, 2) [cycles], fix_id (S,) of the fix and fix_risk (S,) of all of it."""

    held: Any
    integers: Any
    fix_id: Any
    fix_risk: Any


class Rules(NamedTuple):
    """What may be fixed: figures of RtkConfig by their names.

    bands, wavelength (systems, 2) [m], limit of the risk [-], fit (c,) largest best norm by number of ambiguities,
    ``attempts`` without one satellite each.
    """

    bands: Any
    wavelength: Any
    limit: Any
    ratio_min: Any
    fit: Any
    attempts: Any
    max_candidates: Any
    min_satellites: Any
    min_further: Any


class Floats(NamedTuple):
    """``count`` satellites in ``order``, their ``n`` ambiguities with owners, and covariance."""

    count: Any
    order: Any
    n: Any
    owner: Any
    ambiguity: Any
    covariance: Any


class Scratch(NamedTuple):
    """Of the integer search: transform (2, c, c), D (c,), work (5, c, c), candidates (2, c), norms (2,)."""

    transform: Any
    D: Any
    work: Any
    candidates: Any
    norms: Any


class Base(NamedTuple):
    """Clock of each system from its held satellites: e (8, 3), weight (8,) of one band, phase (8, 2)."""

    e: Any
    weight: Any
    phase: Any


@jit
def any_of(mask):  # type: ignore[no-untyped-def]
    """Whether any entry is set."""
    for s in range(mask.shape[0]):
        if mask[s]:
            return True
    return False


@jit
def add_held(carriers, fixes, rules, x, q):  # type: ignore[no-untyped-def]
    """Complete the position of the code with the held phases in place, by adding normal matrices; False: singular."""
    if not any_of(fixes.held):
        return True
    normal, rhs, y = np.empty((3, 3)), np.empty(3), np.empty(carriers.system.shape[0])
    if not invert_3x3(q, normal):
        return False
    multiply_3(normal, x, rhs)
    collapse_phase(carriers.phase, fixes.integers, rules.wavelength, carriers.system, rules.bands, y)
    add_layer(
        carriers.e, carriers.system, fixes.held, carriers.variance / rules.bands, y, normal, rhs,
        np.empty((MAX_GROUPS, 3)), np.empty(MAX_GROUPS), np.empty(MAX_GROUPS),
    )  # fmt: skip
    if not invert_3x3(normal, q):
        return False
    multiply_3(q, rhs, x)
    return True


@jit
def base_of(carriers, fixes, rules):  # type: ignore[no-untyped-def]
    """The clocks that the held satellites give."""
    base = Base(np.empty((MAX_GROUPS, 3)), np.empty(MAX_GROUPS), np.empty((MAX_GROUPS, 2)))
    held_base(
        carriers.phase, fixes.integers, fixes.held, carriers.system, carriers.variance, rules.bands, rules.wavelength,
        carriers.e, base.e, base.weight, base.phase,
    )  # fmt: skip
    return base


@jit
def float_solution(carriers, candidate, base, rules, x, q):  # type: ignore[no-untyped-def]
    """Float ambiguities of the most precise candidates, given the position from everything else."""
    order = np.empty(rules.max_candidates, dtype=np.int64)
    count = order_by_variance(candidate, carriers.variance, rules.max_candidates, order)
    c = max(rules.bands * count, 8)
    owner, a_hat, q_a = np.empty(c, dtype=np.int64), np.empty(c), np.empty((c, c))
    n = float_ambiguities(
        carriers.e, carriers.system, order, count, carriers.phase, carriers.variance, rules.bands, rules.wavelength,
        x, q, base.e.copy(), base.weight.copy(), base.phase.copy(), a_hat, q_a, owner,
    )  # fmt: skip
    return Floats(count, order, n, owner, a_hat, q_a)


@jit
def is_reference(s, floats):  # type: ignore[no-untyped-def]
    """Whether candidate s has no ambiguity of its own: its system's clock is counted from it."""
    for i in range(floats.n):
        if floats.owner[i] == s:
            return False
    return True


@jit
def choose(carriers, floats, fixes, rules, limit, scratch, chosen):  # type: ignore[no-untyped-def]
    """The most precise candidates whose bootstrapped failure rate stays within ``limit``.

    Sets ``chosen`` (S,) to what would then be held; a system's reference is fixed with the first of its satellites.
    Returns (status, satellites with ambiguities, P_IF): FIXED when the set is large enough for a position.
    """
    bands, owner, system = rules.bands, floats.owner, carriers.system
    order = np.arange(floats.ambiguity.shape[0])
    groups, rate = largest_prefix(
        floats.n // bands, bands, order, floats.covariance, limit, scratch.transform, scratch.D, scratch.work
    )
    if groups <= 0:
        return NOT_CONVERGED, 0, 0.0
    chosen[:] = fixes.held
    for j in range(groups):
        chosen[owner[bands * j]] = True
    for i in range(floats.count):
        s = floats.order[i]
        if not chosen[s] and is_reference(s, floats):
            for j in range(groups):
                if system[owner[bands * j]] == system[s]:
                    chosen[s] = True
    satellites, systems = drop_small_systems(chosen, system, rules.min_further)
    if satellites < rules.min_satellites + rules.min_further * (systems - 1) or systems == 0:
        return TOO_FEW, 0, 0.0
    return FIXED, groups, rate


@jit
def accept(floats, groups, rate, limit, rules, scratch):  # type: ignore[no-untyped-def]
    """Integer least squares of the first ``groups`` satellites and the tests of its best candidate; returns a status.

    The ratio is that of a fixed failure rate, at least ``ratio_min``. The best norm is chi-square when the integers are
    right, so that one above ``fit`` says that a carrier is off.
    """
    n, norms = rules.bands * groups, scratch.norms
    status = integer_least_squares(
        n, floats.ambiguity, floats.covariance, 2, NODE_LIMIT, False,
        scratch.transform, scratch.candidates, norms, scratch.D, scratch.work,
    )  # fmt: skip
    if status != OK:
        return SEARCH_FAILED
    if norms[0] > rules.fit[n] or norms[1] < minimum_ratio(n, rate, limit, rules.ratio_min) * norms[0]:
        return RATIO_FAILED
    return FIXED


@jit
def relief(pull, weight, own, bands):  # type: ignore[no-untyped-def]
    """How much of the norm goes when one satellite's ambiguities are left free: ``g' H^-1 g``.

    ``own`` (n,) says with which sign the satellite enters each ambiguity; ``g = C'Wv`` and ``H = C'WC``, where C has a
    column for each band.
    """
    g, h = np.zeros(2), np.zeros((2, 2))
    for i in range(own.shape[0]):
        if own[i] != 0.0:
            g[i % bands] += own[i] * pull[i]
            for k in range(own.shape[0]):
                h[i % bands, k % bands] += own[i] * own[k] * weight[i, k]
    if bands == 1:
        return g[0] * g[0] / h[0, 0]
    return (h[1, 1] * g[0] * g[0] - 2.0 * h[0, 1] * g[0] * g[1] + h[0, 0] * g[1] * g[1]) / (
        h[0, 0] * h[1, 1] - h[0, 1] * h[1, 0]
    )


@jit
def suspect(floats, groups, fixes, chosen, system, rules, best, relieved):  # type: ignore[no-untyped-def]
    """How far each satellite of a refused set explains the misfit of its ``best`` integers (n,); returns their number.

    ``relieved`` (S,) is the part of the norm ``v' Q_a^-1 v`` that would go without the satellite (:func:`relief`), and
    -1 for those outside the set. A reference enters all ambiguities of its system, with the opposite sign.
    """
    bands = rules.bands
    n = bands * groups
    weight = np.linalg.inv(floats.covariance[:n, :n])
    pull, own, count = weight @ (floats.ambiguity[:n] - best[:n]), np.empty(n), 0
    relieved[:] = -1.0
    for j in range(floats.count):
        s = floats.order[j]
        if not chosen[s] or fixes.held[s]:
            continue
        reference, any_own = is_reference(s, floats), False
        for i in range(n):
            own[i] = 0.0
            if floats.owner[i] == s:
                own[i] = 1.0
            elif reference and system[floats.owner[i]] == system[s]:
                own[i] = -1.0
            any_own = any_own or own[i] != 0.0
        if any_own:
            relieved[s] = relief(pull, weight, own, bands)
            count += 1
    return count


@jit
def hold(floats, groups, rules, scratch, chosen, fixes, next_id, risk):  # type: ignore[no-untyped-def]
    """Hold what was chosen with the integers of the best candidate; references count from zero."""
    for s in range(chosen.shape[0]):
        if chosen[s] and not fixes.held[s]:
            fixes.held[s] = True
            fixes.fix_id[s] = next_id
            fixes.fix_risk[s] = risk
            fixes.integers[s, 0] = 0.0
            fixes.integers[s, 1] = 0.0
    for i in range(rules.bands * groups):
        if chosen[floats.owner[i]]:
            fixes.integers[floats.owner[i], i % rules.bands] = scratch.candidates[0, i]


@jit
def attempt(carriers, candidate, fixes, base, rules, x, q, limit, next_id, further, chosen, relieved):  # type: ignore[no-untyped-def]
    """Fix one set of candidates within ``limit``, held with ``further`` risk beside its own.

    Returns (status, P_IF, satellites under suspicion); ``chosen`` is set, and ``relieved`` when the set is refused.
    """
    floats = float_solution(carriers, candidate, base, rules, x, q)
    c = floats.ambiguity.shape[0]
    scratch = Scratch(np.empty((2, c, c)), np.empty(c), np.empty((5, c, c)), np.empty((2, c)), np.empty(2))
    status, groups, rate = choose(carriers, floats, fixes, rules, limit, scratch, chosen)
    if status != FIXED:
        return status, rate, 0
    status, count = accept(floats, groups, rate, limit, rules, scratch), 0
    if status == FIXED:
        hold(floats, groups, rules, scratch, chosen, fixes, next_id, rate + further)
    elif status == RATIO_FAILED:
        count = suspect(floats, groups, fixes, chosen, carriers.system, rules, scratch.candidates[0], relieved)
    return status, rate, count


@jit
def resolve(carriers, candidate, fixes, rules, x, q, next_id):  # type: ignore[no-untyped-def]
    """Fix the ambiguities of as many candidate satellites as the risk allows, and hold them.

    The float solution takes the position ``x``, ``q`` of the code (completed in place) and the phases already held; the
    most precise candidates whose bootstrapped failure rate stays within what is left of the limit are fixed together
    by integer least squares and accepted by fit and ratio. Where these refuse, those that leave one satellite out are
    tried, the one that explains most of the misfit first. A fix that would leave fewer than ``min_satellites``
    (systems with fewer than ``min_further`` not counted) is not held.

    Returns a status of :class:`~lanebound.integrity.positioning.rtk_status.RtkStatus` (FIXED: something new is held).
    """
    if not add_held(carriers, fixes, rules, x, q):
        return TOO_FEW
    base, n_sat = base_of(carriers, fixes, rules), candidate.shape[0]
    chosen, relieved, unread = np.empty(n_sat, dtype=np.bool_), np.empty(n_sat), np.empty(n_sat)
    left = rules.limit - held_risk(fixes.held, fixes.fix_id, fixes.fix_risk)
    first, rest = FIRST_SHARE * left, (1.0 - FIRST_SHARE) * left
    status, rate, sets = attempt(
        carriers, candidate, fixes, base, rules, x, q, first, next_id, 0.0, chosen, relieved
    )  # fmt: skip
    for _ in range(min(rules.attempts, sets)):
        s = np.argmax(relieved)
        relieved[s], candidate[s] = -1.0, False
        again, _, _ = attempt(
            carriers, candidate, fixes, base, rules, x, q, rest / sets, next_id, rate + rest, chosen, unread
        )
        candidate[s] = True
        if again == FIXED:
            return FIXED
    return status
