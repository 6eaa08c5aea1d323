"""Weighted least squares of one epoch with one row for each satellite, the clocks eliminated analytically.

The receiver has one clock for each group (constellation, or band of it). Centring the design rows in each group by
their weighted mean removes the clocks exactly and leaves a 3x3 normal matrix.

Letters: ``g`` centred design row (``-e`` less its group's mean), ``w = 1/variance``, ``P = (sum w g g')^-1``,
``S_qj = w_j q'P g_j`` the gain of satellite j on axis q, ``h_kj = w_j (g_k'P g_j + 1/W_group)`` the hat matrix.
Axes ``q``: 0 along track, 1 across track.

The caller allocates a :class:`Geometry` (:func:`geometry_scratch`) once and uses it for one epoch after another.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.simd_kernel import WIDTH, absolute, fma, load, padded, spread, store, total
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_upper

__all__ = ["CLOCK", "FIX", "MAX_GROUPS", "Geometry", "capacity", "find_geometry", "geometry_scratch", "solve"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SOLVED, TOO_FEW, SINGULAR = 0, 1, 2  # codes of positioning.least_squares.Solvability

FIX = record(
    p_ee="P, East East [m^2]",
    p_en="P, East North [m^2]",
    p_eu="P, East Up [m^2]",
    p_nn="P, North North [m^2]",
    p_nu="P, North Up [m^2]",
    p_uu="P, Up Up [m^2]",
    sigma=("f8", (2,), "standard deviation of the fault-free solution, by axis [m]"),
    bias=("f8", (2,), "bound of its nominal bias, by axis [m]"),
    position=("f8", (3,), "solution, East North Up [m]"),
    chi2="sum of the squared normalised residuals [-]",
    height="Up as known from elsewhere [m]",
    height_weight="1 / variance of it [1/m^2]; 0: not known, as a new scratch has it",
    groups=("i8", "clocks in use"),
    status=("i8", "SOLVED, TOO_FEW or SINGULAR"),
)
"""The fault-free solution of an epoch."""

CLOCK = record(
    satellites="number of satellites of the group",
    variance="1 / W, the reciprocal of the sum of the weights [m^2]",
    mean_e="weighted mean of the design rows, East",
    mean_n="the same, North",
    mean_u="the same, Up",
    mean_y="weighted mean of the measurements [m]",
    spread="W times the sum of w^2 var_acc",
    cross_e="2 W times the sum of w^2 var_acc g, East",
    cross_n="the same, North",
    cross_u="the same, Up",
    prior="fault probability of one satellite [-]",
    log_prior="its natural logarithm",
)
"""The clock of one group of satellites; all zeros where the group has no satellite."""


class Geometry(NamedTuple):
    """One epoch of up to W satellites; entries n to the next multiple of WIDTH hold zeros, as sums run over vectors.

    fix (1,) of FIX and clocks (MAX_GROUPS,) of CLOCK; row (3, W) ``g``; weight (W,) ``w`` [1/m^2]; lever (3, W)
    ``P g``; gain (2, W) ``S``; free (W,) ``1 - h_kk``; residual (W,) [m]; clock (W,) ``1/W_group`` [m^2], and
    member (MAX_GROUPS, W) the same for the satellites of one group, 0 elsewhere; variance, bias (W,) as given.
    """

    fix: Records
    clocks: Records
    row: Array
    weight: Array
    lever: Array
    gain: Array
    free: Array
    residual: Array
    clock: Array
    member: Array
    variance: Array
    bias: Array


@jit
def capacity(n: int, subsets: int = 0) -> int:
    """Entries that the scratch needs for n satellites, all constellation modes and ``subsets`` more."""
    return int(padded(n + 1 + MAX_GROUPS + subsets))


@jit(forceinline=True)
def geometry_scratch(n: int, subsets: int = 0) -> Geometry:
    """Allocate a Geometry for up to n satellites."""
    w = capacity(n, subsets)
    return Geometry(
        np.zeros(1, FIX), np.zeros(MAX_GROUPS, CLOCK), np.zeros((3, w)), np.zeros(w), np.zeros((3, w)),
        np.zeros((2, w)), np.zeros(w), np.zeros(w), np.zeros(w), np.zeros((MAX_GROUPS, w)), np.zeros(w), np.zeros(w),
    )  # fmt: skip


@jit(borrows=True, forceinline=True)
def _centre(los: Array, group: Ints, n: int, geo: Geometry) -> int:
    """Centre the design rows in each group; returns the number of groups present."""
    row, member, clocks, clock = geo.row, geo.member, geo.clocks, geo.clock
    present = 0
    for i in range(n):
        present |= 1 << group[i]
    for g in range(MAX_GROUPS):
        clocks[g].satellites = 0.0
        if present >> g & 1:
            for i in range(0, n, WIDTH):
                store(spread(0.0), member, g, i)
    for i in range(n):
        row[0, i], row[1, i], row[2, i] = -los[i, 0], -los[i, 1], -los[i, 2]
        member[group[i], i] = 1.0
    groups, lonely = 0, False
    for g in range(MAX_GROUPS):
        if present >> g & 1:
            groups += 1
            _mean_of_group(g, n, row, geo.weight, member, clocks[g])
            lonely |= clocks[g].satellites == 1.0
    for i in range(0, n, WIDTH):
        x, y, z, own = load(row, 0, i), load(row, 1, i), load(row, 2, i), spread(0.0)
        for g in range(MAX_GROUPS):
            c = clocks[g]
            if c.satellites > 0.0:
                is_member = load(member, g, i)
                x, y, z = fma(is_member, -c.mean_e, x), fma(is_member, -c.mean_n, y), fma(is_member, -c.mean_u, z)
                is_member *= c.variance
                own += is_member
                store(is_member, member, g, i)
        store(x, row, 0, i)
        store(y, row, 1, i)
        store(z, row, 2, i)
        store(own, clock, i)
    if lonely:
        _clear_lonely(group, n, row, clocks)
    return groups


@jit(borrows=True)
def _mean_of_group(g: int, n: int, row: Array, weight: Array, member: Array, clock: Any) -> None:
    """Count, clock variance and mean design row of group g, whose satellites have 1 in row g of ``member``."""
    count, w, e, north, up = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        is_member = load(member, g, i)
        share = is_member * load(weight, i)
        count, w = count + is_member, w + share
        e, north, up = (
            fma(share, load(row, 0, i), e),
            fma(share, load(row, 1, i), north),
            fma(share, load(row, 2, i), up),
        )
    inverse = 1.0 / total(w)
    clock.satellites, clock.variance = total(count), inverse
    clock.mean_e, clock.mean_n, clock.mean_u = total(e) * inverse, total(north) * inverse, total(up) * inverse


@jit(borrows=True)
def _clear_lonely(group: Ints, n: int, row: Array, clocks: Records) -> None:
    """A satellite alone with its clock gives no information on the position: its design row is exactly 0."""
    for i in range(n):
        if clocks[group[i]].satellites == 1.0:
            row[0, i], row[1, i], row[2, i] = 0.0, 0.0, 0.0


@jit(borrows=True)
def normal_matrix(row: Array, weight: Array, n: int) -> tuple[float, float, float, float, float, float]:
    """Upper triangle of ``sum weight g g'``.  row (3, W), weight (W,)."""
    a, b, c = spread(0.0), spread(0.0), spread(0.0)
    d, e, f = spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        x, y, z, w = load(row, 0, i), load(row, 1, i), load(row, 2, i), load(weight, i)
        wx, wy, wz = w * x, w * y, w * z
        a, b, c = fma(wx, x, a), fma(wx, y, b), fma(wx, z, c)
        d, e, f = fma(wy, y, d), fma(wy, z, e), fma(wz, z, f)
    return total(a), total(b), total(c), total(d), total(e), total(f)


@jit(borrows=True)
def find_geometry(
    los: Array, group: Ints, variance: Array, bias: Array, n: int, sin_h: float, cos_h: float, geo: Geometry
) -> int:
    """Fault-free solution of one epoch: gains, standard deviation and bias bound on AT and CT (equations 2, 6).

    Parameters
    ----------
    los : (>= n, 3) unit vectors receiver to satellite, ENU.
    group : (>= n,) clock group of each satellite, 0 to MAX_GROUPS - 1.
    variance : (>= n,) positive variance for integrity [m^2].
    bias : (>= n,) bound of the nominal bias, >= 0 [m].
    sin_h, cos_h : sine and cosine of the azimuth of motion.
    geo : filled, except for the residuals (zeros) and the position (zeros).

    Returns
    -------
    SOLVED, TOO_FEW or SINGULAR. Unless SOLVED, the standard deviations are inf, P and the bias bounds zero.
    """
    fix, row, weight = geo.fix[0], geo.row, geo.weight
    for i in range(n):
        geo.variance[i], geo.bias[i] = variance[i], bias[i]
    for i in range(n, padded(n)):
        geo.variance[i], geo.bias[i], row[0, i], row[1, i], row[2, i] = np.inf, 0.0, 0.0, 0.0, 0.0
    for i in range(0, n, WIDTH):
        store(1.0 / load(geo.variance, i), weight, i)
        store(spread(0.0), geo.residual, i)
    for i in range(n, padded(n)):
        geo.variance[i] = 0.0
    groups = _centre(los, group, n, geo)
    fix.p_ee, fix.p_en, fix.p_eu, fix.p_nn, fix.p_nu, fix.p_uu = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fix.sigma[0], fix.sigma[1], fix.bias[0], fix.bias[1] = np.inf, np.inf, 0.0, 0.0
    fix.position[0], fix.position[1], fix.position[2], fix.chi2, fix.groups = 0.0, 0.0, 0.0, 0.0, groups
    status = TOO_FEW
    if n + (1 if fix.height_weight > 0.0 else 0) >= 3 + groups:
        a, b, c, d, e, f = normal_matrix(row, weight, n)
        f += fix.height_weight
        ok, fix.p_ee, fix.p_en, fix.p_eu, fix.p_nn, fix.p_nu, fix.p_uu = invert_upper(a, b, c, d, e, f)
        status = SOLVED if ok else SINGULAR
    fix.status = status
    if status == SOLVED:
        _find_gains(n, sin_h, cos_h, geo)
    return status


@jit(borrows=True, forceinline=True)
def _find_gains(n: int, sin_h: float, cos_h: float, geo: Geometry) -> None:
    """Levers, gains, ``1 - h``, and the fault-free standard deviations and bias bounds."""
    fix, row, lever, gain = geo.fix[0], geo.row, geo.lever, geo.gain
    ee, en, eu, nn, nu, uu = fix.p_ee, fix.p_en, fix.p_eu, fix.p_nn, fix.p_nu, fix.p_uu
    b_at, b_ct = spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        x, y, z, w = load(row, 0, i), load(row, 1, i), load(row, 2, i), load(geo.weight, i)
        hx = fma(z, eu, fma(y, en, x * ee))
        hy = fma(z, nu, fma(y, nn, x * en))
        hz = fma(z, uu, fma(y, nu, x * eu))
        s_at, s_ct = w * (hx * sin_h + hy * cos_h), w * (hx * cos_h - hy * sin_h)
        store(hx, lever, 0, i)
        store(hy, lever, 1, i)
        store(hz, lever, 2, i)
        store(s_at, gain, 0, i)
        store(s_ct, gain, 1, i)
        store(1.0 - w * fma(hx, x, fma(hy, y, fma(hz, z, load(geo.clock, i)))), geo.free, i)
        b_at = fma(absolute(s_at), load(geo.bias, i), b_at)
        b_ct = fma(absolute(s_ct), load(geo.bias, i), b_ct)
    fix.bias[0], fix.bias[1] = total(b_at), total(b_ct)
    fix.sigma[0] = math.sqrt(sin_h * sin_h * ee + 2.0 * sin_h * cos_h * en + cos_h * cos_h * nn)
    fix.sigma[1] = math.sqrt(cos_h * cos_h * ee - 2.0 * sin_h * cos_h * en + sin_h * sin_h * nn)


@jit(borrows=True)
def solve(y: Array, group: Ints, n: int, geo: Geometry) -> float:
    """Least squares of ``y`` (n,) [m] after a SOLVED :func:`find_geometry`; fills the position and the residuals.

    Returns the sum of squared normalised residuals (also in the fix), chi-square with n - 3 - groups degrees of freedom
    when fault-free (S1 eq 8 with ``Q_y^-1``), one more where the height is known.
    """
    fix, clocks, row, lever, weight, residual = geo.fix[0], geo.clocks, geo.row, geo.lever, geo.weight, geo.residual
    for i in range(n):
        clocks[group[i]].mean_y = 0.0
    for i in range(n):
        c = clocks[group[i]]
        c.mean_y += weight[i] * c.variance * y[i]
    for i in range(n):
        residual[i] = y[i] - clocks[group[i]].mean_y
    x, yy, z = spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        weighted = load(weight, i) * load(residual, i)
        x, yy = fma(weighted, load(lever, 0, i), x), fma(weighted, load(lever, 1, i), yy)
        z = fma(weighted, load(lever, 2, i), z)
    east, north, up = total(x), total(yy), total(z)
    pull = fix.height_weight * fix.height
    east, north, up = east + pull * fix.p_eu, north + pull * fix.p_nu, up + pull * fix.p_uu
    squares = spread(0.0)
    for i in range(0, n, WIDTH):
        explained = fma(load(row, 0, i), east, fma(load(row, 1, i), north, load(row, 2, i) * up))
        r = load(residual, i) - explained
        store(r, residual, i)
        squares = fma(load(weight, i) * r, r, squares)
    fix.position[0], fix.position[1], fix.position[2] = east, north, up
    fix.chi2 = total(squares) + fix.height_weight * (up - fix.height) ** 2
    return float(fix.chi2)
