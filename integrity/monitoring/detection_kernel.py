"""Detection and exclusion for the satellites of one vehicle, one row each, a clock for each group.

The receiver clocks are eliminated analytically: centring each group's rows on their weighted mean leaves a 3x3 normal
matrix A. Letters: ``z = e - mean(e)`` of the row's group, ``w`` weight, ``r`` residual,
``M_ii = w - w^2 (1 / sum(w) + z'A^-1 z)``, ``w-statistic = w r / sqrt(M_ii)``. Removing row k from a group of weight V
is the rank-one downdate ``A -= w V / (V - w) z z'``. For single-row modes the AT and CT separation tests and the
direction test all equal the w-statistic; only their thresholds differ (:class:`Thresholds`).
Reference: :func:`lanebound.integrity.monitoring.exclusion.detect_and_exclude`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import invert_3x3
from lanebound.integrity.positioning.rows_kernel import Rows

__all__ = ["FDE_RULES", "Thresholds", "detect_and_exclude"]

Array = NDArray[np.float64]

CLEAN, EXCLUDED, UNRESOLVED, NO_REDUNDANCY, SINGULAR = 0, 1, 2, 3, 4  # codes of FdeOutcome

MAX_CLOCKS = 16
RANK_TOLERANCE = 1e-9  # as in detection.py: a row with less redundancy cannot be checked

FDE_RULES = record(
    global_first=("?", "search only after the global test has failed"),
    max_excluded=("i8", "fault modes excluded at most"),
    min_redundancy=("i8", "redundancy that an exclusion must leave"),
    by_tests=("?", "local thresholds depend on the number of tests, not on the redundancy"),
)
"""FdeConfig as the kernel takes it."""

GROUP = record(
    e=("f8", (3,), "weighted mean line of sight"), y="weighted mean measurement", weight="sum of the weights"
)


class Thresholds(NamedTuple):
    """global_chi2 (N + 1,) by redundancy; local (N + 1,) of the w-statistic, by number of tests or redundancy."""

    global_chi2: Array
    local: Array


@jit(borrows=True)
def _centre_groups(rows: Rows, groups: Records) -> tuple[int, int]:
    """Weighted means of each group (MAX_CLOCKS,) of GROUP; returns the rows and groups in use."""
    los, group, variance, y, used = rows
    count, present = 0, 0
    for g in range(groups.shape[0]):
        mean = groups[g]
        mean.e[0], mean.e[1], mean.e[2], mean.y, mean.weight = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(y.size):
        if used[i]:
            mean, w = groups[group[i]], 1.0 / variance[i]
            mean.e[0] += w * los[i, 0]
            mean.e[1] += w * los[i, 1]
            mean.e[2] += w * los[i, 2]
            mean.y += w * y[i]
            mean.weight += w
            count += 1
    for g in range(groups.shape[0]):
        mean = groups[g]
        if mean.weight > 0.0:
            present += 1
            mean.e[0] /= mean.weight
            mean.e[1] /= mean.weight
            mean.e[2] /= mean.weight
            mean.y /= mean.weight
    return count, present


@jit(borrows=True)
def _normal_equations(rows: Rows, groups: Records, A: Array, b: Array) -> None:
    """``A = sum w z z'``, its upper triangle, and ``b = -sum w z (y - mean)`` of the rows in use."""
    los, group, variance, y, used = rows
    a00, a01, a02, a11, a12, a22, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(y.size):
        if used[i]:
            mean, w = groups[group[i]], 1.0 / variance[i]
            z0, z1, z2 = los[i, 0] - mean.e[0], los[i, 1] - mean.e[1], los[i, 2] - mean.e[2]
            w0, w1, w2, r = w * z0, w * z1, w * z2, y[i] - mean.y
            a00, a01, a02, a11, a12, a22 = (
                a00 + w0 * z0, a01 + w0 * z1, a02 + w0 * z2, a11 + w1 * z1, a12 + w1 * z2, a22 + w2 * z2,
            )  # fmt: skip
            b0, b1, b2 = b0 - w0 * r, b1 - w1 * r, b2 - w2 * r
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = a00, a01, a02, a11, a12, a22
    b[0], b[1], b[2] = b0, b1, b2


@jit(borrows=True)
def _remove_row(i: int, rows: Rows, mean: Any, A: Array, b: Array) -> None:
    """Downdate the upper triangle of A and b by row ``i`` of the group with this mean."""
    los, _, variance, y, _ = rows
    w = 1.0 / variance[i]
    factor = w * mean.weight / (mean.weight - w)
    for p in range(3):
        zp = factor * (los[i, p] - mean.e[p])
        b[p] += zp * (y[i] - mean.y)
        for q in range(p, 3):
            A[p, q] -= zp * (los[i, q] - mean.e[q])


@jit(borrows=True)
def _worst_row(rows: Rows, groups: Records, Q: Array, x: Array) -> tuple[float, float, int]:
    """Global statistic, largest absolute w-statistic and its row (-1: none can be checked)."""
    los, group, variance, y, used = rows
    total, largest, at = 0.0, 0.0, -1
    q00, q11, q22, q01, q02, q12 = Q[0, 0], Q[1, 1], Q[2, 2], 2.0 * Q[0, 1], 2.0 * Q[0, 2], 2.0 * Q[1, 2]
    x0, x1, x2 = x[0], x[1], x[2]
    for i in range(y.size):
        if not used[i]:
            continue
        mean, w = groups[group[i]], 1.0 / variance[i]
        z0, z1, z2 = los[i, 0] - mean.e[0], los[i, 1] - mean.e[1], los[i, 2] - mean.e[2]
        r = y[i] - mean.y + z0 * x0 + z1 * x1 + z2 * x2
        square = w * r * r
        total += square
        leverage = z0 * (q00 * z0 + q01 * z1 + q02 * z2) + z1 * (q11 * z1 + q12 * z2) + q22 * z2 * z2
        redundancy = 1.0 - w * (1.0 / mean.weight + leverage)
        if redundancy > RANK_TOLERANCE and (square > largest * redundancy or at < 0):
            largest, at = square / redundancy, i
    return total, math.sqrt(largest), at


@jit
def detect_and_exclude(
    rows: Rows, thresholds: Thresholds, rules: Any, x: Array, Q: Array
) -> tuple[int, float, float, int, int]:
    """Test, exclude the row with the largest w-statistic above its threshold, test again.

    Parameters
    ----------
    rows : rows in use; ``used`` of excluded rows is cleared in place; groups 0 to MAX_CLOCKS - 1.
    rules : of FDE_RULES.
    x (3,), Q (3, 3) : receive the solution and its covariance (East, North, Up).

    Returns
    -------
    outcome code of FdeOutcome, global statistic, largest w-statistic, redundancy, number of rows excluded.
    """
    groups = np.empty(MAX_CLOCKS, GROUP)
    A, b = np.empty((3, 3)), np.empty(3)
    x[:] = 0.0
    Q[:] = 0.0
    count, present = _centre_groups(rows, groups)
    _normal_equations(rows, groups, A, b)
    excluded = 0
    while True:
        df = count - 3 - present
        if count < 4 or not invert_3x3(A, Q):
            return SINGULAR, 0.0, 0.0, 0, excluded
        for p in range(3):
            x[p] = Q[p, 0] * b[0] + Q[p, 1] * b[1] + Q[p, 2] * b[2]
        total, largest, at = _worst_row(rows, groups, Q, x)
        if df < 1:
            return NO_REDUNDANCY, 0.0, 0.0, 0, excluded
        limit = thresholds.local[count if rules.by_tests else df]
        detected = total >= thresholds.global_chi2[df] or (not rules.global_first and largest >= limit)
        if not detected:
            return (EXCLUDED if excluded > 0 else CLEAN), total, largest, df, excluded
        if at < 0 or largest < limit or excluded >= rules.max_excluded or df - 1 < rules.min_redundancy:
            return UNRESOLVED, total, largest, df, excluded
        _remove_row(at, rows, groups[rows.group[at]], A, b)
        rows.used[at] = False
        count, present = _centre_groups(rows, groups)
        excluded += 1
