"""RTK with one vehicle's single differences, epoch by epoch (S1 section 3: no dynamic model), fast form.

Receiver clocks are eliminated by centring: within one system and observable type, weights ``w_s`` and lines of sight
``e_s`` give the mean ``e- = sum w e / sum w``, and the clock-free normal matrix is ``sum w (e - e-)(e - e-)'``. Code
and
phase of both bands share one variance factor ``f_s`` (as RTKLIB's constant code/phase ratio), so the observables of one
satellite collapse into one row of weight ``sum of weights`` without loss. :mod:`.rtk` holds the dense reference.
"""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS


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
    count = np.zeros(MAX_GROUPS, dtype=np.int64)
    for s in range(member.shape[0]):
        if member[s]:
            count[system[s]] += 1
    satellites, systems = 0, 0
    for c in range(MAX_GROUPS):
        if count[c] >= minimum:
            satellites += count[c]
            systems += 1
    for s in range(member.shape[0]):
        if member[s] and count[system[s]] < minimum:
            member[s] = False
    return satellites, systems
