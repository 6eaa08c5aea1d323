"""Detection and exclusion for the satellites of one vehicle, one row each, a clock for each group.

The receiver clocks are eliminated analytically: centring each group's rows on their weighted mean leaves a 3x3 normal
matrix A. Letters: ``z = e - mean(e)`` of the row's group, ``w`` weight, ``r`` residual,
``M_ii = w - w^2 (1 / sum(w) + z'A^-1 z)``, ``w-statistic = w r / sqrt(M_ii)``. Removing row k from a group of weight V
is the rank-one downdate ``A -= w V / (V - w) z z'``. For single-row modes the AT and CT separation tests and the
direction test all equal the w-statistic, so the table chooses the test: ``threshold_tables(axes=1)`` or ``axes=2``.
Reference: :func:`lanebound.integrity.monitoring.exclusion.detect_and_exclude`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.small_matrix_kernel import invert_3x3

__all__ = ["detect_and_exclude"]

# Codes of FdeOutcome, repeated because Numba's cache does not see other files change (a test compares them).
CLEAN, EXCLUDED, UNRESOLVED, NO_REDUNDANCY, SINGULAR = 0, 1, 2, 3, 4

MAX_GROUPS = 16
RANK_TOLERANCE = 1e-9  # as in detection.py: a row with less redundancy cannot be checked


@jit
def centre_groups(
    los: NDArray[Any], group: NDArray[Any], variance: NDArray[Any], y: NDArray[Any], mask: NDArray[Any],
    mean: NDArray[Any],
) -> tuple[int, int]:  # fmt: skip
    """Weighted means of each group into ``mean``: e (3), y, sum of weights; returns the rows and groups in use."""
    rows, groups = 0, 0
    mean[:] = 0.0
    for i in range(y.size):
        if mask[i]:
            g, w = group[i], 1.0 / variance[i]
            mean[g, 0] += w * los[i, 0]
            mean[g, 1] += w * los[i, 1]
            mean[g, 2] += w * los[i, 2]
            mean[g, 3] += w * y[i]
            mean[g, 4] += w
            rows += 1
    for g in range(mean.shape[0]):
        if mean[g, 4] > 0.0:
            groups += 1
            for c in range(4):
                mean[g, c] /= mean[g, 4]
    return rows, groups


@jit
def normal_equations(
    los: NDArray[Any], group: NDArray[Any], variance: NDArray[Any], y: NDArray[Any], mask: NDArray[Any],
    mean: NDArray[Any], A: NDArray[Any], b: NDArray[Any],
) -> None:  # fmt: skip
    """``A = sum w z z'``, its upper triangle, and ``b = -sum w z (y - mean)`` of the rows in use."""
    a00, a01, a02, a11, a12, a22, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(y.size):
        if mask[i]:
            g, w = group[i], 1.0 / variance[i]
            z0, z1, z2 = los[i, 0] - mean[g, 0], los[i, 1] - mean[g, 1], los[i, 2] - mean[g, 2]
            w0, w1, w2, r = w * z0, w * z1, w * z2, y[i] - mean[g, 3]
            a00, a01, a02, a11, a12, a22 = (
                a00 + w0 * z0, a01 + w0 * z1, a02 + w0 * z2, a11 + w1 * z1, a12 + w1 * z2, a22 + w2 * z2,
            )  # fmt: skip
            b0, b1, b2 = b0 - w0 * r, b1 - w1 * r, b2 - w2 * r
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = a00, a01, a02, a11, a12, a22
    b[0], b[1], b[2] = b0, b1, b2


@jit
def take_off(
    i: int, factor: float, los: NDArray[Any], y: NDArray[Any], centre: NDArray[Any], A: NDArray[Any], b: NDArray[Any]
) -> None:
    """Take ``factor z z'`` off the upper triangle of A, and ``-factor z (y - mean)`` off b, for row ``i``."""
    for p in range(3):
        zp = factor * (los[i, p] - centre[p])
        b[p] += zp * (y[i] - centre[3])
        for q in range(p, 3):
            A[p, q] -= zp * (los[i, q] - centre[q])


@jit
def worst_row(
    los: NDArray[Any], group: NDArray[Any], variance: NDArray[Any], y: NDArray[Any], mask: NDArray[Any],
    mean: NDArray[Any], Q: NDArray[Any], x: NDArray[Any],
) -> tuple[float, float, int]:  # fmt: skip
    """Global statistic, largest absolute w-statistic and its row (-1: none can be checked)."""
    total, largest, at = 0.0, 0.0, -1
    q00, q11, q22, q01, q02, q12 = Q[0, 0], Q[1, 1], Q[2, 2], 2.0 * Q[0, 1], 2.0 * Q[0, 2], 2.0 * Q[1, 2]
    x0, x1, x2 = x[0], x[1], x[2]
    for i in range(y.size):
        if not mask[i]:
            continue
        g, w = group[i], 1.0 / variance[i]
        z0, z1, z2 = los[i, 0] - mean[g, 0], los[i, 1] - mean[g, 1], los[i, 2] - mean[g, 2]
        r = y[i] - mean[g, 3] + z0 * x0 + z1 * x1 + z2 * x2
        square = w * r * r
        total += square
        leverage = z0 * (q00 * z0 + q01 * z1 + q02 * z2) + z1 * (q11 * z1 + q12 * z2) + q22 * z2 * z2
        redundancy = 1.0 - w * (1.0 / mean[g, 4] + leverage)
        if redundancy > RANK_TOLERANCE and (square > largest * redundancy or at < 0):
            largest, at = square / redundancy, i
    return total, math.sqrt(largest), at


@jit
def detect_and_exclude(
    los: NDArray[Any],
    group: NDArray[Any],
    variance: NDArray[Any],
    y: NDArray[Any],
    mask: NDArray[Any],
    global_chi2: NDArray[Any],
    local_normal: NDArray[Any],
    global_first: bool,
    max_excluded: int,
    min_redundancy: int,
    x: NDArray[Any],
    Q: NDArray[Any],
) -> tuple[int, float, float, int, int]:
    """Test, exclude the row with the largest w-statistic above its threshold, test again.

    Parameters
    ----------
    los (N, 3) unit vectors e; group (N,) clock of each row, 0..15; variance (N,); y (N,) with ``y = -e.x + clock``.
    mask (N,) bool : rows in use; excluded rows are cleared in place.
    global_chi2, local_normal : of ``threshold_tables``, with N at least the number of rows.
    x (3,), Q (3, 3) : receive the solution and its covariance (East, North, Up).

    Returns
    -------
    outcome code of FdeOutcome, global statistic, largest w-statistic, redundancy, number of rows excluded.
    """
    mean = np.empty((MAX_GROUPS, 5))
    A, b = np.empty((3, 3)), np.empty(3)
    x[:] = 0.0
    Q[:] = 0.0
    rows, groups = centre_groups(los, group, variance, y, mask, mean)
    normal_equations(los, group, variance, y, mask, mean, A, b)
    excluded = 0
    while True:
        df = rows - 3 - groups
        if rows < 4 or not invert_3x3(A, Q):
            return SINGULAR, 0.0, 0.0, 0, excluded
        for p in range(3):
            x[p] = Q[p, 0] * b[0] + Q[p, 1] * b[1] + Q[p, 2] * b[2]
        total, largest, at = worst_row(los, group, variance, y, mask, mean, Q, x)
        if df < 1:
            return NO_REDUNDANCY, 0.0, 0.0, 0, excluded
        limit = local_normal[df, rows]
        detected = total >= global_chi2[df] or (not global_first and largest >= limit)
        if not detected:
            return (EXCLUDED if excluded > 0 else CLEAN), total, largest, df, excluded
        if at < 0 or largest < limit or excluded >= max_excluded or df - 1 < min_redundancy:
            return UNRESOLVED, total, largest, df, excluded
        w, total_weight = 1.0 / variance[at], mean[group[at], 4]
        take_off(at, w * total_weight / (total_weight - w), los, y, mean[group[at]], A, b)
        mask[at] = False
        rows, groups = centre_groups(los, group, variance, y, mask, mean)
        excluded += 1
