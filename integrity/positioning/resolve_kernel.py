"""Integer resolution of one vehicle's carriers: float solution, choice of what the risk allows, acceptance.

Letters: ``x`` (3,) position and ``q`` (3, 3) its covariance from the code, both completed by the held phases; ``a`` the
float ambiguities and ``Q_a`` their covariance; ``P_IF`` the bootstrapped failure rate of a set.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lanebound.integrity.accel import jit
from lanebound.integrity.positioning.lambda_kernel import OK, integer_least_squares, largest_prefix
from lanebound.integrity.positioning.rtk_kernel import (
    add_layer,
    collapse_phase,
    drop_small_systems,
    float_ambiguities,
    held_base,
    held_risk,
    order_by_variance,
)
from lanebound.integrity.small_matrix_kernel import MAX_GROUPS, invert_3x3, multiply_3

__all__ = ["Carriers", "Fixes", "Rules", "resolve"]

NODE_LIMIT = 20_000
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
    """bands, wavelength (systems, 2) [m], limit of the risk [-], and the figures of RtkConfig by their names."""

    bands: Any
    wavelength: Any
    limit: Any
    ratio_min: Any
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
def accept(floats, groups, rules, scratch):  # type: ignore[no-untyped-def]
    """Integer least squares of the first ``groups`` satellites and the test of its best candidate; returns a status."""
    status = integer_least_squares(
        rules.bands * groups, floats.ambiguity, floats.covariance, 2, NODE_LIMIT, False,
        scratch.transform, scratch.candidates, scratch.norms, scratch.D, scratch.work,
    )  # fmt: skip
    if status != OK:
        return SEARCH_FAILED
    if scratch.norms[1] < rules.ratio_min * scratch.norms[0]:
        return RATIO_FAILED
    return FIXED


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
def resolve(carriers, candidate, fixes, rules, x, q, next_id):  # type: ignore[no-untyped-def]
    """Fix the ambiguities of as many candidate satellites as the risk allows, and hold them.

    The float solution takes the position ``x``, ``q`` of the code (completed in place) and the phases already held; the
    most precise candidates whose bootstrapped failure rate stays within what is left of the limit are fixed together
    by integer least squares and accepted by the ratio test. A fix that would leave fewer than ``min_satellites``
    (systems with fewer than ``min_further`` not counted) is not held.

    Returns a status of :class:`~lanebound.integrity.positioning.rtk_status.RtkStatus` (FIXED: something new is held).
    """
    if not add_held(carriers, fixes, rules, x, q):
        return TOO_FEW
    base = base_of(carriers, fixes, rules)
    floats = float_solution(carriers, candidate, base, rules, x, q)
    c = floats.ambiguity.shape[0]
    scratch = Scratch(np.empty((2, c, c)), np.empty(c), np.empty((5, c, c)), np.empty((2, c)), np.empty(2))
    chosen = np.empty(candidate.shape[0], dtype=np.bool_)
    left = rules.limit - held_risk(fixes.held, fixes.fix_id, fixes.fix_risk)
    status, groups, rate = choose(carriers, floats, fixes, rules, left, scratch, chosen)
    if status == FIXED:
        status = accept(floats, groups, rules, scratch)
    if status == FIXED:
        hold(floats, groups, rules, scratch, chosen, fixes, next_id, rate)
    return status
