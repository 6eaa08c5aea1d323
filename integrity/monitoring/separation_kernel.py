"""Solution separation of one epoch by downdates of the fault-free solution (S1 eq 10-12).

Removing satellite k is a rank-one downdate: ``[S_k]_qj = S_qj - c_qk (delta_kj - h_kj)`` with
``c_qk = S_qk / (1 - h_kk)``, so ``sigma_k^2 = sigma_0^2 + c_qk^2 (1 - h_kk) var_k`` and ``x - x_k = c_qk r_k`` with the
fault-free residual ``r_k``. Any other subset (a constellation, a pair) is removed by centring the rows that are left
anew in their groups, which is exact because each group has a clock of its own.

Columns of ``mode``: 0 is fault-free, k = 1..n removes satellite k - 1, then one for each constellation present in
ascending order of group when asked for, then subsets and untested hypotheses that the caller adds with
:func:`add_subset` and :func:`add_hypothesis`. Letters and scratch:
:mod:`lanebound.integrity.monitoring.geometry_kernel`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
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
from lanebound.integrity.monitoring.geometry_kernel import (
    ACCURACY,
    B0_AT,
    B0_CT,
    BIAS_AT,
    BIAS_CT,
    BX,
    BY,
    BZ,
    C_AT,
    C_COUNT,
    C_CT,
    C_INVERSE,
    C_LOG_PRIOR,
    C_PRIOR,
    C_V,
    C_VE,
    C_VN,
    C_VU,
    CLOCK,
    CLOCK_STEP,
    CLOCKS,
    D_AT,
    D_CT,
    DELTA_AT,
    DELTA_CT,
    FREE,
    GROUP_CLOCK,
    GX,
    GY,
    GZ,
    HX,
    HY,
    HZ,
    LOG_PRIOR,
    LOST,
    PRIOR,
    RESIDUAL,
    S_AT,
    S_CT,
    SB_AT,
    SB_CT,
    SIGMA0_AT,
    SIGMA0_CT,
    SIGMA_AT,
    SIGMA_CT,
    TESTED,
    VARIANCE,
    WB,
    WEIGHT,
    B,
    V,
    W,
    normal,
)

__all__ = ["add_hypothesis", "add_subset", "modes", "set_priors"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNSOLVABLE_BELOW = 1e-10  # of 1 - h_kk: the other satellites do not determine what this one did
LOG_2 = math.log(2.0)
CAREFUL_BELOW = 0.05  # of 1 - h_kk: sum the separation's variance term by term, without cancellation


@jit
def modes(
    group: Ints,
    variance: Array,
    accuracy: Array,
    n: int,
    sin_h: float,
    cos_h: float,
    constellations: bool,
    published: bool,
    geo: Array,
    head: Array,
    mode: Array,
) -> int:
    """Fill the columns of ``mode`` after a SOLVED ``geometry`` (and after ``solve`` when separations are wanted).

    Parameters
    ----------
    group, variance : as given to ``geometry``.
    accuracy : (>= n,) variance that the separations are tested with [m^2]; equal to ``variance`` in S1.
    constellations : add a mode for each group present.
    published : take the signed bias of S1 eq 17 in place of the bound ``sum_j abs([R S_i]_qj) b_j``.

    Returns
    -------
    Columns filled, the fault-free one included. A mode that cannot be solved has SIGMA inf and the rest 0. Rows
    D_AT, D_CT are 0 unless ``solve`` was called. Row PRIOR is left to :func:`set_priors`.
    """
    _prepare(accuracy, n, geo, head)
    mode[SIGMA_AT, 0], mode[SIGMA_CT, 0] = head[SIGMA0_AT], head[SIGMA0_CT]
    mode[BIAS_AT, 0], mode[BIAS_CT, 0] = head[B0_AT], head[B0_CT]
    mode[DELTA_AT, 0], mode[DELTA_CT, 0], mode[D_AT, 0], mode[D_CT, 0] = 0.0, 0.0, 0.0, 0.0
    _tested(group, accuracy, n, geo, head)
    _satellites(n, geo, head, mode)
    _biases(group, n, geo, mode)
    for k in range(n):
        if geo[FREE, k] < UNSOLVABLE_BELOW and head[CLOCKS + group[k] * CLOCK_STEP + C_COUNT] > 1.0:
            _unsolvable(k + 1, mode)
    count = n + 1
    if constellations:
        for g in range(MAX_GROUPS):
            if head[CLOCKS + g * CLOCK_STEP + C_COUNT] > 0.0:
                _subset(count, group[:n] == g, group, accuracy, n, sin_h, cos_h, geo, head, mode)
                count += 1
    if published:
        _published_biases(group, n, count, sin_h, cos_h, geo, head, mode)
    return count


@jit
def _prepare(accuracy: Array, n: int, geo: Array, head: Array) -> None:
    """Rows and moments that make each mode cheap: ``w b g``, ``S b``, ``w^2 var_acc``."""
    for i in range(n):
        geo[ACCURACY, i] = accuracy[i]
    for i in range(n, padded(n)):
        geo[ACCURACY, i] = 0.0
    for i in range(0, n, WIDTH):
        b, w = load(geo, B, i), load(geo, W, i)
        wb = w * b
        store(w * w * load(geo, ACCURACY, i), geo, V, i)
        store(wb, geo, WB, i)
        store(wb * load(geo, GX, i), geo, BX, i)
        store(wb * load(geo, GY, i), geo, BY, i)
        store(wb * load(geo, GZ, i), geo, BZ, i)
        store(load(geo, S_AT, i) * b, geo, SB_AT, i)
        store(load(geo, S_CT, i) * b, geo, SB_CT, i)
    for g in range(MAX_GROUPS):
        q = CLOCKS + g * CLOCK_STEP
        if head[q + C_COUNT] > 0.0:
            v, ve, vn, vu = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for i in range(0, n, WIDTH):
                share = load(geo, GROUP_CLOCK + g, i) * load(geo, V, i)
                v += share
                ve, vn = fma(share, load(geo, GX, i), ve), fma(share, load(geo, GY, i), vn)
                vu = fma(share, load(geo, GZ, i), vu)
            weight = 1.0 / head[q + C_INVERSE]
            head[q + C_V] = weight * total(v)
            head[q + C_VE], head[q + C_VN] = 2.0 * weight * total(ve), 2.0 * weight * total(vn)
            head[q + C_VU] = 2.0 * weight * total(vu)


@jit
def _tested(group: Ints, accuracy: Array, n: int, geo: Array, head: Array) -> None:
    """Rows C_AT, C_CT and TESTED, the root of ``sum_j (delta_kj - h_kj)^2 var_acc_j``, from moments.

    A satellite alone with its clock moves nothing: its c is 0, and so is its separation.
    """
    ee, en, eu, nn, nu, uu = normal(geo, n, V)
    for k in range(0, n, WIDTH):
        x, y, z, free = load(geo, HX, k), load(geo, HY, k), load(geo, HZ, k), load(geo, FREE, k)
        vx, vy, vz = fma(x, ee, y * (2.0 * en)), fma(y, nn, z * (2.0 * nu)), fma(z, uu, x * (2.0 * eu))
        square = fma(load(geo, ACCURACY, k), fma(free, 2.0, -1.0), fma(x, vx, fma(y, vy, z * vz)))
        for g in range(MAX_GROUPS):
            q = CLOCKS + g * CLOCK_STEP
            if head[q + C_COUNT] > 0.0:
                clock = load(geo, GROUP_CLOCK + g, k)
                cross = fma(x, head[q + C_VE], fma(y, head[q + C_VN], fma(z, head[q + C_VU], clock * head[q + C_V])))
                square = fma(clock, cross, square)
        inverse = 1.0 / free
        store(root_of(maximum(square, 0.0)), geo, TESTED, k)
        store(load(geo, S_AT, k) * inverse, geo, C_AT, k)
        store(load(geo, S_CT, k) * inverse, geo, C_CT, k)
    for k in range(n):
        if geo[FREE, k] < CAREFUL_BELOW:
            if head[CLOCKS + group[k] * CLOCK_STEP + C_COUNT] == 1.0:
                geo[C_AT, k], geo[C_CT, k], geo[TESTED, k] = 0.0, 0.0, 0.0
            else:
                geo[TESTED, k] = math.sqrt(_tested_variance(k, group, accuracy, n, geo))


@jit
def _satellites(n: int, geo: Array, head: Array, mode: Array) -> None:
    """Standard deviations and separations of the single-satellite modes."""
    var_at, var_ct = head[SIGMA0_AT] * head[SIGMA0_AT], head[SIGMA0_CT] * head[SIGMA0_CT]
    for k in range(0, n, WIDTH):
        c_at, c_ct, residual = load(geo, C_AT, k), load(geo, C_CT, k), load(geo, RESIDUAL, k)
        free, tested = load(geo, FREE, k) * load(geo, VARIANCE, k), load(geo, TESTED, k)
        store(root_of(fma(c_at * c_at, free, var_at)), mode, SIGMA_AT, k + 1)
        store(root_of(fma(c_ct * c_ct, free, var_ct)), mode, SIGMA_CT, k + 1)
        store(absolute(c_at) * tested, mode, DELTA_AT, k + 1)
        store(absolute(c_ct) * tested, mode, DELTA_CT, k + 1)
        store(c_at * residual, mode, D_AT, k + 1)
        store(c_ct * residual, mode, D_CT, k + 1)


@jit
def _tested_variance(k: int, group: Ints, accuracy: Array, n: int, geo: Array) -> float:
    """``sum_j (delta_kj - h_kj)^2 var_acc_j``."""
    total = float(geo[FREE, k] * geo[FREE, k] * accuracy[k])
    for j in range(n):
        if j != k:
            level = geo[HX, k] * geo[GX, j] + geo[HY, k] * geo[GY, j] + geo[HZ, k] * geo[GZ, j]
            if group[j] == group[k]:
                level += geo[CLOCK, k]
            total += float(geo[V, j] * level * level)
    return total


@jit
def _unsolvable(column: int, mode: Array) -> None:
    """A mode without a solution: infinite standard deviation, the rest zero."""
    for row in range(D_CT + 1):
        mode[row, column] = 0.0
    mode[SIGMA_AT, column], mode[SIGMA_CT, column] = np.inf, np.inf


@jit
def _biases(group: Ints, n: int, geo: Array, mode: Array) -> None:
    """``sum_j abs([R S_k]_qj) b_j`` of every single-satellite mode: the inner loop of the room, one mode in each lane.

    The sum runs over all satellites and the removed one's own term, ``abs(c_qk) b_k``, is taken off again.
    """
    for k in range(0, n, WIDTH):
        c_at, c_ct, b = load(geo, C_AT, k), load(geo, C_CT, k), load(geo, B, k)
        x, y, z = load(geo, HX, k), load(geo, HY, k), load(geo, HZ, k)
        at, ct = spread(0.0), spread(0.0)
        for j in range(n):
            level = load(geo, GROUP_CLOCK + group[j], k) * geo[WB, j]
            level = fma(x, geo[BX, j], fma(y, geo[BY, j], fma(z, geo[BZ, j], level)))
            at += absolute(fma(c_at, level, geo[SB_AT, j]))
            ct += absolute(fma(c_ct, level, geo[SB_CT, j]))
        store(maximum(at - absolute(c_at) * b, 0.0), mode, BIAS_AT, k + 1)
        store(maximum(ct - absolute(c_ct) * b, 0.0), mode, BIAS_CT, k + 1)


@jit
def _without(removed: Bools, group: Ints, n: int, geo: Array, head: Array, rows: Array) -> Any:
    """Whether the satellites outside a subset give a position, and the upper triangle of its covariance.

    ``rows`` (3, >= n) receives their design rows centred anew in each group, 0 for those removed.
    """
    left, groups = 0, 0
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for g in range(MAX_GROUPS):
        if head[CLOCKS + g * CLOCK_STEP + C_COUNT] == 0.0:
            continue
        members, w, x, y, z = 0, 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            if group[i] == g and not removed[i]:
                members += 1
                w += geo[W, i]
                x += geo[W, i] * geo[GX, i]
                y += geo[W, i] * geo[GY, i]
                z += geo[W, i] * geo[GZ, i]
        left += members
        groups += members > 0
        for i in range(n):
            if group[i] == g:
                keep = members > 1 and not removed[i]  # one alone with its clock says nothing of the position
                rows[0, i] = geo[GX, i] - x / w if keep else 0.0
                rows[1, i] = geo[GY, i] - y / w if keep else 0.0
                rows[2, i] = geo[GZ, i] - z / w if keep else 0.0
    if left < 3 + groups:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        w, x, y, z = geo[W, i], rows[0, i], rows[1, i], rows[2, i]
        a += w * x * x
        b += w * x * y
        c += w * x * z
        d += w * y * y
        e += w * y * z
        f += w * z * z
    return invert_upper(a, b, c, d, e, f)


@jit
def _subset(
    column: int,
    removed: Bools,
    group: Ints,
    accuracy: Array,
    n: int,
    sin_h: float,
    cos_h: float,
    geo: Array,
    head: Array,
    mode: Array,
) -> None:
    """The mode that removes any subset of the satellites: a constellation, a pair."""
    rows = np.empty((3, n))
    ok, ee, en, eu, nn, nu, _ = _without(removed, group, n, geo, head, rows)
    if not ok:
        _unsolvable(column, mode)
        return
    r_at_e, r_at_n, r_at_u = sin_h * ee + cos_h * en, sin_h * en + cos_h * nn, sin_h * eu + cos_h * nu
    r_ct_e, r_ct_n, r_ct_u = cos_h * ee - sin_h * en, cos_h * en - sin_h * nn, cos_h * eu - sin_h * nu
    v_at, v_ct, b_at, b_ct, d_at, d_ct = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x, y, z = rows[0, i], rows[1, i], rows[2, i]
        s_at = geo[W, i] * (r_at_e * x + r_at_n * y + r_at_u * z)
        s_ct = geo[W, i] * (r_ct_e * x + r_ct_n * y + r_ct_u * z)
        v_at += (s_at - geo[S_AT, i]) ** 2 * accuracy[i]
        v_ct += (s_ct - geo[S_CT, i]) ** 2 * accuracy[i]
        b_at += abs(s_at) * geo[B, i]
        b_ct += abs(s_ct) * geo[B, i]
        d_at -= s_at * geo[RESIDUAL, i]  # x_i = S_i (G x + r) = x + S_i r
        d_ct -= s_ct * geo[RESIDUAL, i]
    mode[SIGMA_AT, column] = math.sqrt(sin_h * r_at_e + cos_h * r_at_n)
    mode[SIGMA_CT, column] = math.sqrt(cos_h * r_ct_e - sin_h * r_ct_n)
    mode[DELTA_AT, column], mode[DELTA_CT, column] = math.sqrt(v_at), math.sqrt(v_ct)
    mode[BIAS_AT, column], mode[BIAS_CT, column] = b_at, b_ct
    mode[D_AT, column], mode[D_CT, column] = d_at, d_ct


@jit
def _published_biases(
    group: Ints, n: int, count: int, sin_h: float, cos_h: float, geo: Array, head: Array, mode: Array
) -> None:
    """S1 eq 17: ``B_AT = sqrt((sin t a1'S_i b)^2 + (cos t a2'S_i b)^2)``, B_CT with sin and cos exchanged."""
    e, north = 0.0, 0.0
    for j in range(n):
        e += geo[W, j] * geo[HX, j] * geo[B, j]
        north += geo[W, j] * geo[HY, j] * geo[B, j]
    _write_published(0, e, north, sin_h, cos_h, mode)
    for k in range(n):
        level = 0.0
        for j in range(n):
            level += geo[HX, k] * geo[BX, j] + geo[HY, k] * geo[BY, j] + geo[HZ, k] * geo[BZ, j]
            level += geo[GROUP_CLOCK + group[j], k] * geo[WB, j]
        if mode[SIGMA_AT, k + 1] < np.inf:
            alone = head[CLOCKS + group[k] * CLOCK_STEP + C_COUNT] == 1.0
            drop = 0.0 if alone else geo[W, k] / geo[FREE, k] * (geo[B, k] - level)
            _write_published(k + 1, e - drop * geo[HX, k], north - drop * geo[HY, k], sin_h, cos_h, mode)
    g, rows = -1, np.empty((3, n))
    for column in range(n + 1, count):
        g += 1
        while head[CLOCKS + g * CLOCK_STEP + C_COUNT] == 0.0:
            g += 1
        ok, ee, en, eu, nn, nu, _ = _without(group[:n] == g, group, n, geo, head, rows)
        if ok:
            x, y, z = 0.0, 0.0, 0.0
            for j in range(n):
                x += geo[WB, j] * rows[0, j]
                y += geo[WB, j] * rows[1, j]
                z += geo[WB, j] * rows[2, j]
            e_g, n_g = ee * x + en * y + eu * z, en * x + nn * y + nu * z
            _write_published(column, e_g, n_g, sin_h, cos_h, mode)


@jit
def _write_published(column: int, e: float, north: float, sin_h: float, cos_h: float, mode: Array) -> None:
    mode[BIAS_AT, column] = math.sqrt((sin_h * e) ** 2 + (cos_h * north) ** 2)
    mode[BIAS_CT, column] = math.sqrt((cos_h * e) ** 2 + (sin_h * north) ** 2)


@jit
def set_priors(
    group: Ints, n: int, count: int, satellite: Array, constellation: Array, head: Array, mode: Array
) -> None:
    """Rows PRIOR, LOG_PRIOR, WEIGHT from the priors of each group, ``satellite`` and ``constellation`` (MAX_GROUPS,).

    The fault-free column gets 2: both sides of its error count (S2 eq 10). Where a mode has no solution WEIGHT is 0,
    LOG_PRIOR -inf, and head[LOST] collects the prior.
    """
    last, logarithm = 0.0, -np.inf
    for g in range(MAX_GROUPS):
        q = CLOCKS + g * CLOCK_STEP
        if head[q + C_COUNT] > 0.0:
            if satellite[g] != last:
                last, logarithm = satellite[g], math.log(satellite[g])
            head[q + C_PRIOR], head[q + C_LOG_PRIOR] = last, logarithm
    mode[PRIOR, 0], mode[LOG_PRIOR, 0] = 2.0, LOG_2
    for k in range(n):
        q = CLOCKS + group[k] * CLOCK_STEP
        mode[PRIOR, k + 1], mode[LOG_PRIOR, k + 1] = head[q + C_PRIOR], head[q + C_LOG_PRIOR]
    column = n + 1
    for g in range(MAX_GROUPS):
        if column < count and head[CLOCKS + g * CLOCK_STEP + C_COUNT] > 0.0:
            mode[PRIOR, column], mode[LOG_PRIOR, column] = constellation[g], math.log(constellation[g])
            column += 1
    lost = 0.0
    for k in range(count):
        mode[WEIGHT, k] = mode[PRIOR, k]
        if not mode[SIGMA_AT, k] < np.inf:
            lost += mode[PRIOR, k]
            mode[WEIGHT, k], mode[LOG_PRIOR, k] = 0.0, -np.inf
    head[LOST] = lost


@jit
def add_subset(
    column: int,
    prior: float,
    removed: Bools,
    group: Ints,
    accuracy: Array,
    n: int,
    sin_h: float,
    cos_h: float,
    geo: Array,
    head: Array,
    mode: Array,
) -> int:
    """Append the tested mode of a subset of the satellites, ``removed`` (n,), after :func:`set_priors`.

    A subset with none of its satellites in view adds nothing. Returns the new number of columns.
    """
    if not removed.any():
        return column
    _subset(column, removed, group, accuracy, n, sin_h, cos_h, geo, head, mode)
    solved = mode[SIGMA_AT, column] < np.inf
    mode[PRIOR, column] = prior
    mode[WEIGHT, column] = prior if solved else 0.0
    mode[LOG_PRIOR, column] = math.log(prior) if solved else -np.inf
    head[LOST] += 0.0 if solved else prior
    return column + 1


@jit
def add_hypothesis(
    column: int, prior: float, sigma_at: float, sigma_ct: float, bias_at: float, bias_ct: float, mode: Array
) -> int:
    """Append an untested hypothesis (a wrong fix, say) after :func:`set_priors`; returns the new number of columns."""
    mode[SIGMA_AT, column], mode[SIGMA_CT, column] = sigma_at, sigma_ct
    mode[BIAS_AT, column], mode[BIAS_CT, column] = abs(bias_at), abs(bias_ct)
    mode[DELTA_AT, column], mode[DELTA_CT, column], mode[D_AT, column], mode[D_CT, column] = 0.0, 0.0, 0.0, 0.0
    mode[PRIOR, column], mode[LOG_PRIOR, column], mode[WEIGHT, column] = prior, math.log(prior), prior
    return column + 1
