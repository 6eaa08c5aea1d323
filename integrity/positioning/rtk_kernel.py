"""RTK with one vehicle's single differences, epoch by epoch (S1 section 3: no dynamic model), fast form.

Receiver clocks are eliminated by centring: within one system and observable type, weights ``w_s`` and lines of sight
``e_s`` give the mean ``e- = sum w e / sum w``, and the clock-free normal matrix is ``sum w (e - e-)(e - e-)'``. Code
and
phase of both bands share one variance factor ``f_s`` (as RTKLIB's constant code/phase ratio), so the observables of one
satellite collapse into one row of weight ``sum of weights`` without loss. :mod:`.rtk` holds the dense reference.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.accel import jit
from lanebound.integrity.positioning.lambda_kernel import OK, integer_least_squares, largest_prefix

MAX_SYSTEMS = 8
NODE_LIMIT = 20_000
FIXED, NO_CORRECTIONS, TOO_FEW, NOT_CONVERGED, RATIO_FAILED, FAULT, SEARCH_FAILED = 0, 1, 2, 3, 4, 5, 6  # rtk_status


@jit
def add_layer(e, system, member, variance, y, normal, rhs, e_mean, y_mean, w_sum):  # type: ignore[no-untyped-def]
    """Add one observable type to the clock-free normal equations ``normal x = rhs`` of ``y = -e x + clock``.

    e (S,3), system (S,), member (S,) bool, variance (S,) [m^2], y (S,) [m]; e_mean (8,3), y_mean (8,), w_sum (8,) are
    filled per system (zero weight: no member).
    """
    e_mean[:] = 0.0
    y_mean[:] = 0.0
    w_sum[:] = 0.0
    for s in range(e.shape[0]):
        if member[s]:
            w, c = 1.0 / variance[s], system[s]
            w_sum[c] += w
            y_mean[c] += w * y[s]
            for k in range(3):
                e_mean[c, k] += w * e[s, k]
    for c in range(w_sum.shape[0]):
        if w_sum[c] > 0.0:
            y_mean[c] /= w_sum[c]
            for k in range(3):
                e_mean[c, k] /= w_sum[c]
    for s in range(e.shape[0]):
        if member[s]:
            w, c = 1.0 / variance[s], system[s]
            dy = y[s] - y_mean[c]
            for j in range(3):
                gj = e[s, j] - e_mean[c, j]
                rhs[j] -= w * gj * dy
                for k in range(3):
                    normal[j, k] += w * gj * (e[s, k] - e_mean[c, k])


@jit
def invert_3x3(a, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive definite 3x3 matrix; False (and ``out`` undefined) when it is not one."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    least, most = min(a[0, 0], a[1, 1], a[2, 2]), max(a[0, 0], a[1, 1], a[2, 2])
    if not (det > 1e-12 * a[0, 0] * a[1, 1] * a[2, 2] and least > 1e-12 * most):  # also False for NaN
        return False
    out[0, 0] = c00 / det
    out[0, 1] = out[1, 0] = c01 / det
    out[0, 2] = out[2, 0] = c02 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = out[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det
    return out[0, 0] > 0.0 and out[1, 1] > 0.0 and out[2, 2] > 0.0


@jit
def multiply_3(a, b, out):  # type: ignore[no-untyped-def]
    """``out = a b`` for a 3x3 matrix and a vector."""
    for j in range(3):
        out[j] = a[j, 0] * b[0] + a[j, 1] * b[1] + a[j, 2] * b[2]


@jit
def collapse_code(code, bands, out):  # type: ignore[no-untyped-def]
    """Mean of the code over the bands: code (S,2) -> out (S,) [m]; its variance is that of one band over ``bands``."""
    for s in range(code.shape[0]):
        out[s] = code[s, 0] if bands == 1 else 0.5 * (code[s, 0] + code[s, 1])


@jit
def collapse_phase(phase, integers, wavelength, system, bands, out):  # type: ignore[no-untyped-def]
    """Mean over the bands of ``phase - lambda N``: phase, integers (S,2), wavelength (systems, 2) -> out (S,) [m]."""
    for s in range(phase.shape[0]):
        total = 0.0
        for b in range(bands):
            total += phase[s, b] - wavelength[system[s], b] * integers[s, b]
        out[s] = total / bands


@jit
def order_by_variance(candidate, variance, limit, order):  # type: ignore[no-untyped-def]
    """Indices of the candidates, most precise first, at most ``limit`` of them: fills ``order``, returns the count."""
    n = 0
    for s in range(candidate.shape[0]):
        if not candidate[s]:
            continue
        k = n
        while k > 0 and variance[order[k - 1]] > variance[s]:
            if k < limit:
                order[k] = order[k - 1]
            k -= 1
        if k < limit:
            order[k] = s
            n = min(n + 1, limit)
    return n


@jit
def float_ambiguities(  # type: ignore[no-untyped-def]
    e,
    system,
    order,
    count,
    phase,
    variance,
    bands,
    wavelength,
    x,
    q_x,
    e_base,
    w_base,
    phase_base,
    ambiguity,
    q_a,
    owner,
):
    """Float ambiguities of ``count`` satellites and their covariance, given the position from all other rows.

    ``N = (phase - clock + (e - e_base) x) / lambda`` where the clock of a system and band comes from the mean of its
    held satellites (``w_base`` > 0, mean line of sight ``e_base`` (8,3), mean held phase ``phase_base`` (8,2)) or,
    where
    none is held, from the first of its satellites in ``order``: that one is the reference and has no unknown of its
    own.
    Covariance: ``((e_u - e-) Q_x (e_v - e-) + [same system and band] (1 / w_base + delta_uv var)) / (lambda lambda')``.
    Order of the unknowns: satellite by satellite, band by band.

    variance (S,) of one band's phase [m^2]; w_base (8,) is the weight of one band. Fills ``ambiguity`` (n,), ``q_a``
    (n,n) [cycles^2] and ``owner`` (n,) with satellite indices; returns n. The base arrays are completed in place.
    """
    n = 0
    for i in range(count):
        s = order[i]
        c = system[s]
        if w_base[c] <= 0.0:
            w_base[c] = 1.0 / variance[s]
            for k in range(3):
                e_base[c, k] = e[s, k]
            for b in range(bands):
                phase_base[c, b] = phase[s, b]
            continue
        for b in range(bands):
            geometric = 0.0
            for k in range(3):
                geometric += (e[s, k] - e_base[c, k]) * x[k]
            ambiguity[n] = (phase[s, b] - phase_base[c, b] + geometric) / wavelength[c, b]
            owner[n] = s
            n += 1
    h = np.empty(3)
    for i in range(n):
        u = owner[i]
        cu, bu = system[u], i % bands
        for k in range(3):
            h[k] = 0.0
            for j in range(3):
                h[k] += q_x[k, j] * (e[u, j] - e_base[cu, j])
        for i2 in range(i + 1):
            v = owner[i2]
            cv, bv = system[v], i2 % bands
            q = 0.0
            for k in range(3):
                q += h[k] * (e[v, k] - e_base[cv, k])
            if cu == cv and bu == bv:
                q += 1.0 / w_base[cu]
                if u == v:
                    q += variance[u]
            q /= wavelength[cu, bu] * wavelength[cv, bv]
            q_a[i, i2] = q
            q_a[i2, i] = q
    return n


@jit
def held_base(phase, integers, held, system, variance, bands, wavelength, e, e_base, w_base, phase_base):  # type: ignore[no-untyped-def]
    """Clock of each system and band from its held satellites: weighted means of ``phase - lambda N`` and of ``e``."""
    e_base[:] = 0.0
    w_base[:] = 0.0
    phase_base[:] = 0.0
    for s in range(phase.shape[0]):
        if held[s]:
            c, w = system[s], 1.0 / variance[s]
            w_base[c] += w
            for k in range(3):
                e_base[c, k] += w * e[s, k]
            for b in range(bands):
                phase_base[c, b] += w * (phase[s, b] - wavelength[c, b] * integers[s, b])
    for c in range(w_base.shape[0]):
        if w_base[c] > 0.0:
            for k in range(3):
                e_base[c, k] /= w_base[c]
            for b in range(bands):
                phase_base[c, b] /= w_base[c]


@jit
def held_risk(held, fix_id, fix_risk):  # type: ignore[no-untyped-def]
    """Probability that any held ambiguity is wrong: the union bound over the fixes they came from.

    fix_id (S,) numbers the fix of each satellite, fix_risk (S,) is the failure rate of that whole fix.
    """
    total = 0.0
    for s in range(held.shape[0]):
        if not held[s]:
            continue
        first = True
        for r in range(s):
            if held[r] and fix_id[r] == fix_id[s]:
                first = False
                break
        if first:
            total += fix_risk[s]
    return total


@jit
def drop_small_systems(member, system, minimum):  # type: ignore[no-untyped-def]
    """Leave out systems with fewer than ``minimum`` members; returns the number of satellites and of systems left."""
    count = np.zeros(MAX_SYSTEMS, dtype=np.int64)
    for s in range(member.shape[0]):
        if member[s]:
            count[system[s]] += 1
    satellites, systems = 0, 0
    for c in range(MAX_SYSTEMS):
        if count[c] >= minimum:
            satellites += count[c]
            systems += 1
    for s in range(member.shape[0]):
        if member[s] and count[system[s]] < minimum:
            member[s] = False
    return satellites, systems


@jit
def resolve(  # type: ignore[no-untyped-def]
    e,
    system,
    code_used,
    candidate,
    held,
    code,
    phase,
    variance_code,
    variance_phase,
    bands,
    wavelength,
    integers,
    fix_id,
    fix_risk,
    next_id,
    limit,
    ratio_min,
    max_candidates,
    min_satellites,
    min_further,
):
    """Fix the ambiguities of as many candidate satellites as the risk allows, and hold them.

    The float solution takes the code of ``code_used`` and the phases already held; the most precise candidates whose
    bootstrapped failure rate stays within what is left of ``limit`` are fixed together by integer least squares and
    accepted
    by the ratio test. A fix that would leave fewer than ``min_satellites`` (systems with fewer than ``min_further``
    not counted) is not held. variance_code, variance_phase (S,) are those of one band [m^2].

    Returns a status of :class:`~lanebound.integrity.positioning.rtk_status.RtkStatus` (FIXED: something new is held).
    """
    n_sat = e.shape[0]
    normal, q_x, rhs, x = np.zeros((3, 3)), np.empty((3, 3)), np.zeros(3), np.empty(3)
    e_base, w_base, phase_base = np.empty((MAX_SYSTEMS, 3)), np.empty(MAX_SYSTEMS), np.empty((MAX_SYSTEMS, 2))
    y = np.empty(n_sat)
    collapse_code(code, bands, y)
    add_layer(e, system, code_used, variance_code / bands, y, normal, rhs, e_base, np.empty(MAX_SYSTEMS), w_base)
    collapse_phase(phase, integers, wavelength, system, bands, y)
    add_layer(e, system, held, variance_phase / bands, y, normal, rhs, e_base, np.empty(MAX_SYSTEMS), w_base)
    if not invert_3x3(normal, q_x):
        return TOO_FEW
    multiply_3(q_x, rhs, x)
    held_base(phase, integers, held, system, variance_phase, bands, wavelength, e, e_base, w_base, phase_base)
    order = np.empty(max_candidates, dtype=np.int64)
    count = order_by_variance(candidate, variance_phase, max_candidates, order)
    c_max = max(bands * count, 8)
    a_hat, q_a, owner = np.empty(c_max), np.empty((c_max, c_max)), np.empty(c_max, dtype=np.int64)
    n = float_ambiguities(
        e,
        system,
        order,
        count,
        phase,
        variance_phase,
        bands,
        wavelength,
        x,
        q_x,
        e_base,
        w_base,
        phase_base,
        a_hat,
        q_a,
        owner,
    )
    transform, work, d = np.empty((2, c_max, c_max)), np.empty((5, c_max, c_max)), np.empty(c_max)
    left = limit - held_risk(held, fix_id, fix_risk)
    groups, rate = largest_prefix(n // bands, bands, np.arange(c_max), q_a, left, transform, d, work)
    if groups <= 0:
        return NOT_CONVERGED
    chosen = held.copy()
    for i in range(groups):
        chosen[owner[bands * i]] = True
    for i in range(count):  # the reference of a system is fixed with the first of its satellites
        if not chosen[order[i]] and _is_reference(order[i], owner, n):
            for j in range(groups):
                if system[owner[bands * j]] == system[order[i]]:
                    chosen[order[i]] = True
    satellites, systems = drop_small_systems(chosen, system, min_further)
    if satellites < min_satellites + min_further * (systems - 1) or systems == 0:
        return TOO_FEW
    candidates, norms = np.empty((2, c_max)), np.empty(2)
    status = integer_least_squares(
        bands * groups, a_hat, q_a, 2, NODE_LIMIT, False, transform, candidates, norms, d, work
    )
    if status != OK:
        return SEARCH_FAILED
    if norms[1] < ratio_min * norms[0]:
        return RATIO_FAILED
    for s in range(n_sat):
        if chosen[s] and not held[s]:
            held[s] = True
            fix_id[s] = next_id
            fix_risk[s] = rate
            integers[s, 0] = 0.0
            integers[s, 1] = 0.0
    for i in range(bands * groups):
        if chosen[owner[i]]:
            integers[owner[i], i % bands] = candidates[0, i]
    return FIXED


@jit
def _is_reference(s, owner, n):  # type: ignore[no-untyped-def]
    """Whether candidate s has no ambiguity of its own."""
    for i in range(n):
        if owner[i] == s:
            return False
    return True


@jit
def hdop_of(e, group, member):  # type: ignore[no-untyped-def]
    """Unweighted HDOP of the members with one clock for each group; inf when the geometry is singular."""
    n = e.shape[0]
    normal, inverse = np.zeros((3, 3)), np.empty((3, 3))
    e_mean, y_mean, w_sum = np.empty((MAX_SYSTEMS, 3)), np.empty(MAX_SYSTEMS), np.empty(MAX_SYSTEMS)
    add_layer(e, group, member, np.ones(n), np.zeros(n), normal, np.zeros(3), e_mean, y_mean, w_sum)
    if not invert_3x3(normal, inverse):
        return math.inf
    return math.sqrt(inverse[0, 0] + inverse[1, 1])
