"""Solution separation of one epoch by downdates of the fault-free solution (S1 eq 10-12).

Removing satellite k is a rank-one downdate: ``[S_k]_qj = S_qj - c_qk (delta_kj - h_kj)`` with
``c_qk = S_qk / (1 - h_kk)``, so ``sigma_k^2 = sigma_0^2 + c_qk^2 (1 - h_kk) var_k`` and ``x - x_k = c_qk r_k`` with the
fault-free residual ``r_k``. Any other subset (a constellation, a pair) is removed by centring the remaining rows anew
in their groups, which is exact because each group has a clock of its own.

Order of the modes: 0 is fault-free, k = 1..n removes satellite k - 1, then one for each constellation present in
ascending order of group if wanted, then the subsets that the caller adds with :func:`add_subset`. Letters:
:mod:`lanebound.integrity.positioning.geometry_kernel`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.simd_kernel import (
    WIDTH,
    absolute,
    fma,
    load,
    maximum,
    padded,
    root_of,
    spread,
    store,
    total,
)
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_upper
from lanebound.integrity.positioning.geometry_kernel import Geometry, capacity, normal_matrix

__all__ = [
    "Modes",
    "Moments",
    "add_subset",
    "find_modes",
    "mode_scratch",
    "moment_scratch",
    "set_factors",
    "set_priors",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNSOLVABLE_BELOW = 1e-10  # of 1 - h_kk: without this satellite there is no solution
LOG_2 = math.log(2.0)
CAREFUL_BELOW = 0.05  # of 1 - h_kk: sum the separation's variance term by term, without cancellation


class Modes(NamedTuple):
    """Fault modes, one column each (W); axis 0 of the matrices is AT, CT.

    sigma (2, W) standard deviation of the mode's solution [m], inf without one; delta (2, W) of its separation from the
    fault-free solution; bias (2, W) bound of its nominal bias; separation (2, W) ``x - x_i`` [m]; prior, log_prior (W,)
    fault probability; weight (W,) the prior of the modes with a solution, 0 of the others; k_fa (W,) the normalised
    separation that passes the fault test, filled by :func:`set_factors`; offset (2, W) ``K_fa sigma_d + b`` and
    rate (2, W) ``1 / sigma``, filled by :mod:`.protection_kernel`; scratch: removed (W,), the satellites
    that a mode removes, order (W,) of them, and rows (3, W), design rows of the others.
    """

    sigma: Array
    delta: Array
    bias: Array
    separation: Array
    prior: Array
    log_prior: Array
    weight: Array
    offset: Array
    rate: Array
    k_fa: Array
    removed: Bools
    order: Ints
    rows: Array


class Moments(NamedTuple):
    """What makes each mode cheap, one column for each satellite (W).

    accuracy (W,) ``var_acc``; spread (W,) ``w^2 var_acc``; weighted_bias (W,) ``w b``; row_bias (3, W) ``w b g``;
    gain_bias (2, W) ``S b``; change (2, W) ``c``; tested (W,) root of ``sum_j (delta_kj - h_kj)^2 var_acc_j``.
    """

    accuracy: Array
    spread: Array
    weighted_bias: Array
    row_bias: Array
    gain_bias: Array
    change: Array
    tested: Array


@jit(forceinline=True)
def mode_scratch(n: int, subsets: int = 0) -> Modes:
    """Allocate Modes for up to n satellites and ``subsets`` more modes."""
    w = capacity(n, subsets)
    return Modes(
        np.zeros((2, w)), np.zeros((2, w)), np.zeros((2, w)), np.zeros((2, w)), np.zeros(w), np.zeros(w), np.zeros(w),
        np.zeros((2, w)), np.zeros((2, w)), np.zeros(w), np.zeros(w, dtype=np.bool_),
        np.zeros(w, dtype=np.int64), np.zeros((3, w)),
    )  # fmt: skip


@jit(forceinline=True)
def moment_scratch(n: int) -> Moments:
    """Allocate Moments for up to n satellites."""
    w = capacity(n)
    return Moments(
        np.zeros(w), np.zeros(w), np.zeros(w), np.zeros((3, w)), np.zeros((2, w)), np.zeros((2, w)), np.zeros(w)
    )


@jit(borrows=True, forceinline=True)
def find_modes(
    group: Ints, accuracy: Array, n: int, sin_h: float, cos_h: float, constellations: bool, published: bool,
    geo: Geometry, moments: Moments, modes: Modes,
) -> int:  # fmt: skip
    """Fill the modes after a SOLVED ``find_geometry`` (and after ``solve`` when separations are wanted).

    Parameters
    ----------
    group : as given to ``find_geometry``.
    accuracy : (>= n,) variance that the separations are tested with [m^2]; equal to the variance in S1.
    constellations : add a mode for each group present.
    published : take the signed bias of S1 eq 17 in place of the bound ``sum_j abs([R S_i]_qj) b_j``.

    Returns
    -------
    Number of modes, the fault-free one included. A mode that cannot be solved has an infinite sigma and zeros
    elsewhere. The separations are 0 unless ``solve`` was called. Priors are left to :func:`set_priors`.
    """
    fix = geo.fix[0]
    _find_moments(accuracy, n, geo, moments)
    for q in range(2):
        modes.sigma[q, 0], modes.bias[q, 0], modes.delta[q, 0], modes.separation[q, 0] = (
            fix.sigma[q],
            fix.bias[q],
            0.0,
            0.0,
        )
    _find_changes(group, n, geo, moments)
    _remove_satellites(n, geo, moments, modes)
    _bound_biases(group, n, geo, moments, modes.bias)
    for k in range(n):
        if geo.free[k] < UNSOLVABLE_BELOW and geo.clocks[group[k]].satellites > 1.0:
            _mark_unsolvable(k + 1, modes)
    count = n + 1
    if constellations:
        for g in range(MAX_GROUPS):
            if geo.clocks[g].satellites > 0.0:
                _mark_group(g, group, n, modes.removed)
                _remove_subset(count, modes.removed, group, moments.accuracy, n, sin_h, cos_h, geo, modes)
                count += 1
    if published:
        _replace_biases(group, n, count, sin_h, cos_h, geo, moments, modes)
    return count


@jit(borrows=True, forceinline=True)
def _find_moments(accuracy: Array, n: int, geo: Geometry, moments: Moments) -> None:
    """All moments but ``change`` and ``tested``, and those of the clocks."""
    row, weight, bias, gain, member = geo.row, geo.weight, geo.bias, geo.gain, geo.member
    spread_out, row_bias, gain_bias = moments.spread, moments.row_bias, moments.gain_bias
    for i in range(n):
        moments.accuracy[i] = accuracy[i]
    for i in range(n, padded(n)):
        moments.accuracy[i] = 0.0
    for i in range(0, n, WIDTH):
        b, w = load(bias, i), load(weight, i)
        wb = w * b
        store(w * w * load(moments.accuracy, i), spread_out, i)
        store(wb, moments.weighted_bias, i)
        store(wb * load(row, 0, i), row_bias, 0, i)
        store(wb * load(row, 1, i), row_bias, 1, i)
        store(wb * load(row, 2, i), row_bias, 2, i)
        store(load(gain, 0, i) * b, gain_bias, 0, i)
        store(load(gain, 1, i) * b, gain_bias, 1, i)
    for g in range(MAX_GROUPS):
        c = geo.clocks[g]
        if c.satellites > 0.0:
            v, ve, vn, vu = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for i in range(0, n, WIDTH):
                share = load(member, g, i) * load(spread_out, i)
                v += share
                ve, vn, vu = (
                    fma(share, load(row, 0, i), ve),
                    fma(share, load(row, 1, i), vn),
                    fma(share, load(row, 2, i), vu),
                )
            total_weight = 1.0 / c.variance
            c.spread = total_weight * total(v)
            c.cross_e, c.cross_n = 2.0 * total_weight * total(ve), 2.0 * total_weight * total(vn)
            c.cross_u = 2.0 * total_weight * total(vu)


@jit(borrows=True, forceinline=True)
def _find_changes(group: Ints, n: int, geo: Geometry, moments: Moments) -> None:
    """``change`` and ``tested``, from moments.

    A satellite alone with its clock does not move the solution: its c is 0, and so is its separation. A known height
    is one more row, whose variance is as stated.
    """
    lever, free, clocks = geo.lever, geo.free, geo.clocks
    change, tested = moments.change, moments.tested
    ee, en, eu, nn, nu, uu = normal_matrix(geo.row, moments.spread, n)
    uu += geo.fix[0].height_weight
    for k in range(0, n, WIDTH):
        x, y, z, f = load(lever, 0, k), load(lever, 1, k), load(lever, 2, k), load(free, k)
        vx, vy, vz = fma(x, ee, y * (2.0 * en)), fma(y, nn, z * (2.0 * nu)), fma(z, uu, x * (2.0 * eu))
        square = fma(load(moments.accuracy, k), fma(f, 2.0, -1.0), fma(x, vx, fma(y, vy, z * vz)))
        for g in range(MAX_GROUPS):
            c = clocks[g]
            if c.satellites > 0.0:
                own = load(geo.member, g, k)
                cross = fma(x, c.cross_e, fma(y, c.cross_n, fma(z, c.cross_u, own * c.spread)))
                square = fma(own, cross, square)
        inverse = 1.0 / f
        store(root_of(maximum(square, 0.0)), tested, k)
        store(load(geo.gain, 0, k) * inverse, change, 0, k)
        store(load(geo.gain, 1, k) * inverse, change, 1, k)
    for k in range(n):
        if free[k] < CAREFUL_BELOW:
            if clocks[group[k]].satellites == 1.0:
                change[0, k], change[1, k], tested[k] = 0.0, 0.0, 0.0
            else:
                tested[k] = math.sqrt(_tested_variance(k, group, n, geo, moments))


@jit(borrows=True, forceinline=True)
def _remove_satellites(n: int, geo: Geometry, moments: Moments, modes: Modes) -> None:
    """Standard deviations and separations of the single-satellite modes."""
    fix, change = geo.fix[0], moments.change
    for q in range(2):
        variance = fix.sigma[q] * fix.sigma[q]
        for k in range(0, n, WIDTH):
            c, residual = load(change, q, k), load(geo.residual, k)
            free, tested = load(geo.free, k) * load(geo.variance, k), load(moments.tested, k)
            store(root_of(fma(c * c, free, variance)), modes.sigma, q, k + 1)
            store(absolute(c) * tested, modes.delta, q, k + 1)
            store(c * residual, modes.separation, q, k + 1)


@jit(borrows=True)
def _tested_variance(k: int, group: Ints, n: int, geo: Geometry, moments: Moments) -> float:
    """``sum_j (delta_kj - h_kj)^2 var_acc_j``."""
    row, lever = geo.row, geo.lever
    variance = float(geo.free[k] * geo.free[k] * moments.accuracy[k])
    for j in range(n):
        if j != k:
            level = lever[0, k] * row[0, j] + lever[1, k] * row[1, j] + lever[2, k] * row[2, j]
            if group[j] == group[k]:
                level += geo.clock[k]
            variance += float(moments.spread[j] * level * level)
    return variance + float(geo.fix[0].height_weight * lever[2, k] * lever[2, k])


@jit(borrows=True)
def _mark_unsolvable(column: int, modes: Modes) -> None:
    """A mode without a solution: infinite standard deviation, zeros elsewhere."""
    for q in range(2):
        modes.sigma[q, column], modes.delta[q, column] = np.inf, 0.0
        modes.bias[q, column], modes.separation[q, column] = 0.0, 0.0


@jit(borrows=True, forceinline=True)
def _bound_biases(group: Ints, n: int, geo: Geometry, moments: Moments, bias: Array) -> None:
    """``sum_j abs([R S_k]_qj) b_j`` of every single-satellite mode, one mode in each lane: the hot loop of this file.

    The sum runs over all satellites; the removed satellite's own term, ``abs(c_qk) b_k``, is subtracted again.
    """
    lever, member, change = geo.lever, geo.member, moments.change
    weighted, row_bias, gain_bias = moments.weighted_bias, moments.row_bias, moments.gain_bias
    for k in range(0, n, WIDTH):
        c_at, c_ct, b = load(change, 0, k), load(change, 1, k), load(geo.bias, k)
        x, y, z = load(lever, 0, k), load(lever, 1, k), load(lever, 2, k)
        at, ct = spread(0.0), spread(0.0)
        for j in range(n):
            level = load(member, group[j], k) * weighted[j]
            level = fma(x, row_bias[0, j], fma(y, row_bias[1, j], fma(z, row_bias[2, j], level)))
            at += absolute(fma(c_at, level, gain_bias[0, j]))
            ct += absolute(fma(c_ct, level, gain_bias[1, j]))
        store(maximum(at - absolute(c_at) * b, 0.0), bias, 0, k + 1)
        store(maximum(ct - absolute(c_ct) * b, 0.0), bias, 1, k + 1)


@jit(borrows=True)
def _mark_group(g: int, group: Ints, n: int, removed: Bools) -> None:
    for i in range(n):
        removed[i] = group[i] == g


@jit(borrows=True)
def _solve_without(removed: Bools, group: Ints, n: int, geo: Geometry, rows: Array) -> Any:
    """Whether the satellites outside a subset give a position, and the upper triangle of its covariance.

    ``rows`` (3, >= n) receives their design rows centred anew in each group, 0 for those removed.
    """
    row, weight = geo.row, geo.weight
    left, groups = 0, 0
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for g in range(MAX_GROUPS):
        if geo.clocks[g].satellites == 0.0:
            continue
        members, w, x, y, z = 0, 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            if group[i] == g and not removed[i]:
                members += 1
                w += weight[i]
                x += weight[i] * row[0, i]
                y += weight[i] * row[1, i]
                z += weight[i] * row[2, i]
        left += members
        groups += members > 0
        for i in range(n):
            if group[i] == g:
                counts = members > 1 and not removed[i]  # one alone with its clock says nothing of the position
                rows[0, i] = row[0, i] - x / w if counts else 0.0
                rows[1, i] = row[1, i] - y / w if counts else 0.0
                rows[2, i] = row[2, i] - z / w if counts else 0.0
    known = geo.fix[0].height_weight
    if left + (1 if known > 0.0 else 0) < 3 + groups:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    f += known
    for i in range(n):
        w, x, y, z = weight[i], rows[0, i], rows[1, i], rows[2, i]
        a += w * x * x
        b += w * x * y
        c += w * x * z
        d += w * y * y
        e += w * y * z
        f += w * z * z
    return invert_upper(a, b, c, d, e, f)


@jit(borrows=True)
def _remove_subset(
    column: int, removed: Bools, group: Ints, accuracy: Array, n: int, sin_h: float, cos_h: float, geo: Geometry,
    modes: Modes,
) -> None:  # fmt: skip
    """The mode that removes any subset of the satellites: a constellation, a pair."""
    rows, gain, weight = modes.rows, geo.gain, geo.weight
    ok, ee, en, eu, nn, nu, _ = _solve_without(removed, group, n, geo, rows)
    if not ok:
        _mark_unsolvable(column, modes)
        return
    r_at_e, r_at_n, r_at_u = sin_h * ee + cos_h * en, sin_h * en + cos_h * nn, sin_h * eu + cos_h * nu
    r_ct_e, r_ct_n, r_ct_u = cos_h * ee - sin_h * en, cos_h * en - sin_h * nn, cos_h * eu - sin_h * nu
    v_at, v_ct, b_at, b_ct, d_at, d_ct = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x, y, z = rows[0, i], rows[1, i], rows[2, i]
        s_at = weight[i] * (r_at_e * x + r_at_n * y + r_at_u * z)
        s_ct = weight[i] * (r_ct_e * x + r_ct_n * y + r_ct_u * z)
        v_at += (s_at - gain[0, i]) ** 2 * accuracy[i]
        v_ct += (s_ct - gain[1, i]) ** 2 * accuracy[i]
        b_at += abs(s_at) * geo.bias[i]
        b_ct += abs(s_ct) * geo.bias[i]
        d_at -= s_at * geo.residual[i]  # x_i = S_i (G x + r) = x + S_i r
        d_ct -= s_ct * geo.residual[i]
    known = geo.fix[0].height_weight
    if known > 0.0:
        fix = geo.fix[0]
        off = known * (fix.height - fix.position[2])
        d_at, d_ct = d_at - r_at_u * off, d_ct - r_ct_u * off
        v_at += known * (r_at_u - (sin_h * fix.p_eu + cos_h * fix.p_nu)) ** 2
        v_ct += known * (r_ct_u - (cos_h * fix.p_eu - sin_h * fix.p_nu)) ** 2
    modes.sigma[0, column] = math.sqrt(sin_h * r_at_e + cos_h * r_at_n)
    modes.sigma[1, column] = math.sqrt(cos_h * r_ct_e - sin_h * r_ct_n)
    modes.delta[0, column], modes.delta[1, column] = math.sqrt(v_at), math.sqrt(v_ct)
    modes.bias[0, column], modes.bias[1, column] = b_at, b_ct
    modes.separation[0, column], modes.separation[1, column] = d_at, d_ct


@jit(inline=True)
def _replace_biases(
    group: Ints, n: int, count: int, sin_h: float, cos_h: float, geo: Geometry, moments: Moments, modes: Modes
) -> None:
    """S1 eq 17: ``B_AT = sqrt((sin t a1'S_i b)^2 + (cos t a2'S_i b)^2)``, B_CT with sin and cos exchanged."""
    lever, weight, bias, clocks = geo.lever, geo.weight, geo.bias, geo.clocks
    weighted, row_bias = moments.weighted_bias, moments.row_bias
    e, north = 0.0, 0.0
    for j in range(n):
        e += weight[j] * lever[0, j] * bias[j]
        north += weight[j] * lever[1, j] * bias[j]
    _write_bias(0, e, north, sin_h, cos_h, modes.bias)
    for k in range(n):
        level = 0.0
        for j in range(n):
            level += lever[0, k] * row_bias[0, j] + lever[1, k] * row_bias[1, j] + lever[2, k] * row_bias[2, j]
            level += geo.member[group[j], k] * weighted[j]
        if modes.sigma[0, k + 1] < np.inf:
            alone = clocks[group[k]].satellites == 1.0
            drop = 0.0 if alone else weight[k] / geo.free[k] * (bias[k] - level)
            _write_bias(k + 1, e - drop * lever[0, k], north - drop * lever[1, k], sin_h, cos_h, modes.bias)
    g, rows = -1, modes.rows
    for column in range(n + 1, count):
        g += 1
        while clocks[g].satellites == 0.0:
            g += 1
        _mark_group(g, group, n, modes.removed)
        ok, ee, en, eu, nn, nu, _ = _solve_without(modes.removed, group, n, geo, rows)
        if ok:
            x, y, z = 0.0, 0.0, 0.0
            for j in range(n):
                x += weighted[j] * rows[0, j]
                y += weighted[j] * rows[1, j]
                z += weighted[j] * rows[2, j]
            e_g, n_g = ee * x + en * y + eu * z, en * x + nn * y + nu * z
            _write_bias(column, e_g, n_g, sin_h, cos_h, modes.bias)


@jit(borrows=True)
def _write_bias(column: int, e: float, north: float, sin_h: float, cos_h: float, bias: Array) -> None:
    bias[0, column] = math.sqrt((sin_h * e) ** 2 + (cos_h * north) ** 2)
    bias[1, column] = math.sqrt((cos_h * e) ** 2 + (sin_h * north) ** 2)


@jit(borrows=True)
def set_priors(
    group: Ints, n: int, count: int, satellite: Array, constellation: Array, clocks: Records, modes: Modes
) -> float:
    """Fill prior, log_prior and weight from the priors of each group (MAX_GROUPS,).

    The fault-free mode gets 2: both sides of its error count (S2 eq 10). Returns the total prior of the modes without a
    solution, whose weight is 0.
    """
    prior, log_prior, weight = modes.prior, modes.log_prior, modes.weight
    last, logarithm = 0.0, -np.inf
    for g in range(MAX_GROUPS):
        if clocks[g].satellites > 0.0:
            if satellite[g] != last:
                last, logarithm = satellite[g], math.log(satellite[g])
            clocks[g].prior, clocks[g].log_prior = last, logarithm
    prior[0], log_prior[0] = 2.0, LOG_2
    for k in range(n):
        c = clocks[group[k]]
        prior[k + 1], log_prior[k + 1] = c.prior, c.log_prior
    column = n + 1
    for g in range(MAX_GROUPS):
        if column < count and clocks[g].satellites > 0.0:
            prior[column], log_prior[column] = constellation[g], math.log(constellation[g])
            column += 1
    lost = 0.0
    for k in range(count):
        weight[k] = prior[k]
        if not modes.sigma[0, k] < np.inf:
            lost += prior[k]
            weight[k], log_prior[k] = 0.0, -np.inf
    return lost


@jit(borrows=True)
def set_factors(n: int, count: int, factors: Array, least: float, clocks: Records, modes: Modes) -> None:
    """Fill k_fa of ``count`` modes of n satellites: the threshold of the test by the rank of the mode.

    ``factors`` (R,) by rank from 0, the last for all higher ranks; R = 2 where the rank does not matter. The rank of a
    satellite is 1, that of a constellation one less than its satellites, as its clock takes one row; a subset counts
    as of the highest rank. ``least``: lower bound of every factor.
    """
    k_fa, highest = modes.k_fa, factors.shape[0] - 1
    single = max(factors[1], least)
    k_fa[0] = 0.0
    for k in range(1, n + 1):
        k_fa[k] = single
    column = n + 1
    for g in range(MAX_GROUPS):
        if column < count and clocks[g].satellites > 0.0:
            rank = min(max(int(clocks[g].satellites) - 1, 1), highest)
            k_fa[column] = max(factors[rank], least)
            column += 1
    for k in range(column, count):
        k_fa[k] = max(factors[highest], least)


@jit(borrows=True)
def add_subset(
    column: int, prior: float, removed: Bools, group: Ints, n: int, sin_h: float, cos_h: float, geo: Geometry,
    moments: Moments, modes: Modes,
) -> tuple[int, float]:  # fmt: skip
    """Append the tested mode of a subset of the satellites, ``removed`` (>= n,), after :func:`set_priors`.

    A subset with none of its satellites in view adds nothing. Returns the number of modes, and the prior if the mode
    has no solution, else 0.
    """
    some = False
    for i in range(n):
        some = some or removed[i]
    if not some:
        return column, 0.0
    _remove_subset(column, removed, group, moments.accuracy, n, sin_h, cos_h, geo, modes)
    solved = modes.sigma[0, column] < np.inf
    modes.prior[column] = prior
    modes.weight[column] = prior if solved else 0.0
    modes.log_prior[column] = math.log(prior) if solved else -np.inf
    return column + 1, 0.0 if solved else prior
