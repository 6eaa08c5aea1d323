"""Weighted least squares of one epoch with one row for each satellite, the clocks eliminated analytically.

The receiver has one clock for each group (constellation, or band of it). Centring the design rows in each group by
their weighted mean removes the clocks exactly and leaves a 3x3 normal matrix.

Letters: ``g`` centred design row (``-e`` less its group's mean), ``w = 1/variance``, ``P = (sum w g g')^-1``,
``S_qj = w_j q'P g_j`` the gain of satellite j on axis q, ``h_kj = w_j (g_k'P g_j + 1/W_group)`` the hat matrix.

Scratch belongs to the caller (:func:`scratch`) and is reused from epoch to epoch:

``geo (GEO_ROWS, capacity)``
    One column for each satellite. Columns n to the next multiple of WIDTH hold zeros: sums run over whole vectors.
``head (HEAD_SIZE,)``
    Figures of the epoch: ``P``, the fault-free solution, the clock of each group.
``mode (MODE_ROWS, capacity)``
    One column for each fault mode, filled by :mod:`lanebound.integrity.monitoring.separation_kernel`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.simd_kernel import WIDTH, absolute, fma, load, padded, spread, store, total
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_upper

__all__ = ["HEAD_SIZE", "MAX_GROUPS", "capacity", "geometry", "scratch", "solve"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SOLVED, TOO_FEW, SINGULAR = 0, 1, 2  # the codes of positioning.least_squares.Solvability

# rows of geo
GX, GY, GZ, W, HX, HY, HZ, S_AT, S_CT, FREE, RESIDUAL, CLOCK = range(12)
V, B, WB, BX, BY, BZ, SB_AT, SB_CT = range(12, 20)  # w^2 var_acc, b, w b, w b g, S b
C_AT, C_CT, TESTED = range(20, 23)  # c_qk, root of sum_j (delta_kj - h_kj)^2 var_acc_j
VARIANCE, ACCURACY = range(23, 25)  # var, var_acc
GROUP_CLOCK = 25  # MAX_GROUPS rows: CLOCK of the satellites of one group, 0 elsewhere
GEO_ROWS = GROUP_CLOCK + MAX_GROUPS

# entries of head
P_EE, P_EN, P_EU, P_NN, P_NU, P_UU, SIGMA0_AT, SIGMA0_CT, B0_AT, B0_CT, GROUPS = range(11)
X_E, X_N, X_U, CHI2, STATUS = range(11, 16)
LOST = 16  # total prior of the modes without a solution
CLOCKS = 17  # MAX_GROUPS records of CLOCK_STEP entries
C_INVERSE, C_E, C_N, C_U, C_COUNT, C_Y = range(6)  # 1/W, mean design row, satellites, mean measurement
C_V, C_VE, C_VN, C_VU = range(6, 10)  # sums of w^2 var_acc, and twice those of it times g
C_PRIOR, C_LOG_PRIOR = range(10, 12)  # of one satellite
CLOCK_STEP = 12
HEAD_SIZE = CLOCKS + MAX_GROUPS * CLOCK_STEP

# rows of mode
SIGMA_AT, SIGMA_CT, DELTA_AT, DELTA_CT, BIAS_AT, BIAS_CT, D_AT, D_CT, PRIOR, LOG_PRIOR = range(10)
WEIGHT = 10  # PRIOR of the modes with a solution
OFFSET_AT, OFFSET_CT, RATE_AT, RATE_CT = range(11, 15)  # K_fa sigma_d + b, 1 / sigma
MODE_ROWS = 15


@jit
def capacity(n: int, hypotheses: int = 0) -> int:
    """Columns that ``geo`` and ``mode`` need for n satellites, all constellation modes and ``hypotheses`` more."""
    return int(padded(n + 1 + MAX_GROUPS + hypotheses))


@jit
def scratch(n: int, hypotheses: int = 0) -> tuple[Array, Array, Array]:
    """Allocate ``(geo, head, mode)`` for up to n satellites."""
    columns = capacity(n, hypotheses)
    return np.zeros((GEO_ROWS, columns)), np.zeros(HEAD_SIZE), np.zeros((MODE_ROWS, columns))


@jit
def centre(los: Array, group: Ints, n: int, geo: Array, head: Array) -> int:
    """Centre the design rows in each group with the weights geo[W]; returns the number of groups present."""
    for i in range(CLOCKS, HEAD_SIZE):
        head[i] = 0.0
    present = 0
    for i in range(n):
        present |= 1 << group[i]
    for g in range(MAX_GROUPS):
        if present >> g & 1:
            for i in range(0, n, WIDTH):
                store(spread(0.0), geo, GROUP_CLOCK + g, i)
    for i in range(n):
        geo[GX, i], geo[GY, i], geo[GZ, i] = -los[i, 0], -los[i, 1], -los[i, 2]
        geo[GROUP_CLOCK + group[i], i] = 1.0
    groups, lonely = 0, False
    for g in range(MAX_GROUPS):
        q = CLOCKS + g * CLOCK_STEP
        if present >> g & 1:
            groups += 1
            _mean_of_group(g, n, geo, head)
            lonely |= head[q + C_COUNT] == 1.0
    for i in range(0, n, WIDTH):
        x, y, z, clock = load(geo, GX, i), load(geo, GY, i), load(geo, GZ, i), spread(0.0)
        for g in range(MAX_GROUPS):
            q = CLOCKS + g * CLOCK_STEP
            if head[q + C_COUNT] > 0.0:
                member = load(geo, GROUP_CLOCK + g, i)
                x, y, z = fma(member, -head[q + C_E], x), fma(member, -head[q + C_N], y), fma(member, -head[q + C_U], z)
                member *= head[q + C_INVERSE]
                clock += member
                store(member, geo, GROUP_CLOCK + g, i)
        store(x, geo, GX, i)
        store(y, geo, GY, i)
        store(z, geo, GZ, i)
        store(clock, geo, CLOCK, i)
    if lonely:
        _without_lonely(group, n, geo, head)
    return groups


@jit
def _mean_of_group(g: int, n: int, geo: Array, head: Array) -> None:
    """Count, clock's variance and mean design row of group g, whose members have 1 in row GROUP_CLOCK + g."""
    count, w, e, north, up = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        member = load(geo, GROUP_CLOCK + g, i)
        weight = member * load(geo, W, i)
        count, w = count + member, w + weight
        e, north = fma(weight, load(geo, GX, i), e), fma(weight, load(geo, GY, i), north)
        up = fma(weight, load(geo, GZ, i), up)
    q, inverse = CLOCKS + g * CLOCK_STEP, 1.0 / total(w)
    head[q + C_COUNT], head[q + C_INVERSE] = total(count), inverse
    head[q + C_E], head[q + C_N], head[q + C_U] = total(e) * inverse, total(north) * inverse, total(up) * inverse


@jit
def _without_lonely(group: Ints, n: int, geo: Array, head: Array) -> None:
    """A satellite alone with its clock says nothing of the position: its design row is exactly 0."""
    for i in range(n):
        if head[CLOCKS + group[i] * CLOCK_STEP + C_COUNT] == 1.0:
            geo[GX, i], geo[GY, i], geo[GZ, i] = 0.0, 0.0, 0.0


@jit
def normal(geo: Array, n: int, row: int) -> tuple[float, float, float, float, float, float]:
    """Upper triangle of ``sum weight g g'`` with the weights in geo[row]."""
    a, b, c = spread(0.0), spread(0.0), spread(0.0)
    d, e, f = spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        x, y, z, w = load(geo, GX, i), load(geo, GY, i), load(geo, GZ, i), load(geo, row, i)
        wx, wy, wz = w * x, w * y, w * z
        a, b, c = fma(wx, x, a), fma(wx, y, b), fma(wx, z, c)
        d, e, f = fma(wy, y, d), fma(wy, z, e), fma(wz, z, f)
    return total(a), total(b), total(c), total(d), total(e), total(f)


@jit
def geometry(
    los: Array, group: Ints, variance: Array, bias: Array, n: int, sin_h: float, cos_h: float, geo: Array, head: Array
) -> int:
    """Fault-free solution of one epoch: gains, standard deviation and bias bound on AT and CT (equations 2, 6).

    Parameters
    ----------
    los : (>= n, 3) unit vectors receiver to satellite, ENU.
    group : (>= n,) clock group of each satellite, 0 to MAX_GROUPS - 1.
    variance : (>= n,) positive variance for integrity [m^2].
    bias : (>= n,) bound of the nominal bias, >= 0 [m].
    sin_h, cos_h : sine and cosine of the azimuth of motion.
    geo, head : scratch; rows GX to CLOCK (less RESIDUAL), B, VARIANCE and GROUP_CLOCK of ``geo`` and P, SIGMA0, B0,
        GROUPS of ``head`` are filled. Gains on E, N and U are ``geo[W]`` times ``geo[HX]``, ``geo[HY]``, ``geo[HZ]``.

    Returns
    -------
    SOLVED, TOO_FEW or SINGULAR (also in head[STATUS]). Unless SOLVED, SIGMA0 is inf, P and B0 are zero.
    """
    for i in range(n):
        geo[VARIANCE, i], geo[B, i] = variance[i], bias[i]
    for i in range(n, padded(n)):
        geo[VARIANCE, i], geo[B, i], geo[GX, i], geo[GY, i], geo[GZ, i] = np.inf, 0.0, 0.0, 0.0, 0.0
    for i in range(0, n, WIDTH):
        store(1.0 / load(geo, VARIANCE, i), geo, W, i)
        store(spread(0.0), geo, RESIDUAL, i)
    for i in range(n, padded(n)):
        geo[VARIANCE, i] = 0.0
    groups = centre(los, group, n, geo, head)
    for i in range(SIGMA0_AT):
        head[i] = 0.0
    head[SIGMA0_AT], head[SIGMA0_CT], head[B0_AT], head[B0_CT] = np.inf, np.inf, 0.0, 0.0
    head[X_E], head[X_N], head[X_U], head[CHI2], head[GROUPS] = 0.0, 0.0, 0.0, 0.0, groups
    status = TOO_FEW
    if n >= 3 + groups:
        a, b, c, d, e, f = normal(geo, n, W)
        ok, head[P_EE], head[P_EN], head[P_EU], head[P_NN], head[P_NU], head[P_UU] = invert_upper(a, b, c, d, e, f)
        status = SOLVED if ok else SINGULAR
    head[STATUS] = status
    if status == SOLVED:
        _gains(n, sin_h, cos_h, geo, head)
    return status


@jit
def _gains(n: int, sin_h: float, cos_h: float, geo: Array, head: Array) -> None:
    """Rows HX to FREE of ``geo``, and the fault-free standard deviations and bias bounds."""
    ee, en, eu, nn, nu, uu = head[P_EE], head[P_EN], head[P_EU], head[P_NN], head[P_NU], head[P_UU]
    b_at, b_ct = spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        x, y, z, w = load(geo, GX, i), load(geo, GY, i), load(geo, GZ, i), load(geo, W, i)
        hx = fma(z, eu, fma(y, en, x * ee))
        hy = fma(z, nu, fma(y, nn, x * en))
        hz = fma(z, uu, fma(y, nu, x * eu))
        s_at, s_ct = w * (hx * sin_h + hy * cos_h), w * (hx * cos_h - hy * sin_h)
        store(hx, geo, HX, i)
        store(hy, geo, HY, i)
        store(hz, geo, HZ, i)
        store(s_at, geo, S_AT, i)
        store(s_ct, geo, S_CT, i)
        store(1.0 - w * fma(hx, x, fma(hy, y, fma(hz, z, load(geo, CLOCK, i)))), geo, FREE, i)
        b_at = fma(absolute(s_at), load(geo, B, i), b_at)
        b_ct = fma(absolute(s_ct), load(geo, B, i), b_ct)
    head[B0_AT], head[B0_CT] = total(b_at), total(b_ct)
    head[SIGMA0_AT] = math.sqrt(sin_h * sin_h * ee + 2.0 * sin_h * cos_h * en + cos_h * cos_h * nn)
    head[SIGMA0_CT] = math.sqrt(cos_h * cos_h * ee - 2.0 * sin_h * cos_h * en + sin_h * sin_h * nn)


@jit
def solve(y: Array, group: Ints, n: int, geo: Array, head: Array) -> float:
    """Least squares of ``y`` (n,) [m] after a SOLVED :func:`geometry`.

    Writes the position to head[X_E], head[X_N], head[X_U] and the residuals to geo[RESIDUAL]. Returns the sum of
    squared normalised residuals (also in head[CHI2]), chi-square with n - 3 - groups degrees of freedom when
    fault-free (S1 eq 8 with ``Q_y^-1``).
    """
    for i in range(n):
        q = CLOCKS + group[i] * CLOCK_STEP
        head[q + C_Y] = 0.0
    for i in range(n):
        q = CLOCKS + group[i] * CLOCK_STEP
        head[q + C_Y] += geo[W, i] * head[q + C_INVERSE] * y[i]
    for i in range(n):
        geo[RESIDUAL, i] = y[i] - head[CLOCKS + group[i] * CLOCK_STEP + C_Y]
    x, y, z = spread(0.0), spread(0.0), spread(0.0)
    for i in range(0, n, WIDTH):
        weighted = load(geo, W, i) * load(geo, RESIDUAL, i)
        x, y = fma(weighted, load(geo, HX, i), x), fma(weighted, load(geo, HY, i), y)
        z = fma(weighted, load(geo, HZ, i), z)
    east, north, up = total(x), total(y), total(z)
    squares = spread(0.0)
    for i in range(0, n, WIDTH):
        said = fma(load(geo, GX, i), east, fma(load(geo, GY, i), north, load(geo, GZ, i) * up))
        r = load(geo, RESIDUAL, i) - said
        store(r, geo, RESIDUAL, i)
        squares = fma(load(geo, W, i) * r, r, squares)
    chi2 = float(total(squares))
    head[X_E], head[X_N], head[X_U], head[CHI2] = east, north, up, chi2
    return chi2
