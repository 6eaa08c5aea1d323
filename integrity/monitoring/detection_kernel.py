"""Detection and exclusion for the satellites of one vehicle, one row each, a clock for each group.

The receiver clocks are eliminated analytically: centring each group's rows on their weighted mean leaves a 3x3 normal
matrix A. Letters: ``z = e - mean(e)`` of the row's group, ``w`` weight, ``r`` residual,
``M_ii = w - w^2 (1 / sum(w) + z'A^-1 z)``, ``w-statistic = w r / sqrt(M_ii)``. Removing row k from a group of weight V
is the rank-one downdate ``A -= w V / (V - w) z z'``. For single-row modes the AT and CT separation tests and the
direction test all equal the w-statistic: ``d = S c (c'Mc)^-1 c'We`` has rank 1, so ``abs(d_q) / sigma_dq = abs(w)``
wherever it moves d_q. Only their thresholds differ (:class:`Thresholds`).

The rows of a constellation are a mode too, where ``rules.constellations``: the solution without them gives
``d = x - x_i``, ``Q_d = Q_i - Q`` and ``T = e'We - e_i'W e_i``, which is chi-square of the lost redundancy. By
Cauchy-Schwarz ``d_q^2 / sigma_dq^2 <= d'Q_d^+ d <= T <= e'We``: a test of any of them bounds the separation.
Reference: :func:`lanebound.integrity.monitoring.exclusion.detect_and_exclude`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_3x3

__all__ = ["FDE_RULES", "LIMIT", "Thresholds", "detect_and_exclude"]

Array = NDArray[np.float64]

CLEAN, EXCLUDED, UNRESOLVED, NO_REDUNDANCY, SINGULAR = 0, 1, 2, 3, 4  # codes of FdeOutcome

W_TEST, SEPARATION, DIRECTION = 0, 1, 2  # codes of Search

MAX_CLOCKS = 16
RANK_TOLERANCE = 1e-9  # as in detection.py: a row with less redundancy cannot be checked
STILL_BELOW = 1e-12  # variance of a separation, of the variance without the mode: the mode does not move the solution

FDE_RULES = record(
    global_first=("?", "search only after the global test has failed"),
    max_excluded=("i8", "fault modes excluded at most"),
    min_redundancy=("i8", "redundancy that an exclusion must leave"),
    by_tests=("?", "local thresholds depend on the number of tests, not on the redundancy"),
    constellations=("?", "the rows of a constellation are a mode too"),
    search=("i8", "code of Search: the test that names the mode"),
)
"""FdeConfig as the kernel takes it."""

GROUP = record(
    e=("f8", (3,), "weighted mean line of sight"), y="weighted mean measurement", weight="sum of the weights"
)


LIMIT = record(
    overall="of the global test, by the redundancy [-]",
    local="of the w-statistic of one row, by the number of tests or by the redundancy [-]",
    counted="the global threshold that protection levels count on [-]",
    published=("f8", (2,), "S1's factor of the separation, by the number of fault modes [-]"),
)
"""Thresholds by number."""


class Thresholds(NamedTuple):
    """Thresholds of the tests; the first axis is the redundancy, or the number of tests.

    limits (N + 1,) of LIMIT; factor (N + 1, K) of the normalised separation of a mode by its rank, the last column for
    all higher ranks; chi2 (N + 1, C) of the statistic T of a mode by its rank, which only modes of several rows need.
    """

    limits: Records
    factor: Array
    chi2: Array


@jit(borrows=True)
def _centre_groups(rows: Records, groups: Records) -> tuple[int, int]:
    """Weighted means of each group (MAX_CLOCKS,) of GROUP; returns the rows and groups in use."""
    count, present = 0, 0
    for g in range(groups.shape[0]):
        mean = groups[g]
        mean.e[0], mean.e[1], mean.e[2], mean.y, mean.weight = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows.shape[0]):
        row = rows[i]
        if row.used:
            mean, w = groups[row.group], 1.0 / row.variance
            mean.e[0] += w * row.e[0]
            mean.e[1] += w * row.e[1]
            mean.e[2] += w * row.e[2]
            mean.y += w * row.y
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
def _normal_equations(rows: Records, groups: Records, A: Array, b: Array) -> None:
    """``A = sum w z z'``, its upper triangle, and ``b = -sum w z (y - mean)`` of the rows in use."""
    a00, a01, a02, a11, a12, a22, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows.shape[0]):
        row = rows[i]
        if row.used:
            mean, w = groups[row.group], 1.0 / row.variance
            z0, z1, z2 = row.e[0] - mean.e[0], row.e[1] - mean.e[1], row.e[2] - mean.e[2]
            w0, w1, w2, r = w * z0, w * z1, w * z2, row.y - mean.y
            a00, a01, a02, a11, a12, a22 = (
                a00 + w0 * z0, a01 + w0 * z1, a02 + w0 * z2, a11 + w1 * z1, a12 + w1 * z2, a22 + w2 * z2,
            )  # fmt: skip
            b0, b1, b2 = b0 - w0 * r, b1 - w1 * r, b2 - w2 * r
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = a00, a01, a02, a11, a12, a22
    b[0], b[1], b[2] = b0, b1, b2


@jit(borrows=True)
def _remove_row(row: Any, mean: Any, A: Array, b: Array) -> None:
    """Downdate the upper triangle of A and b by a row of the group with this mean."""
    w = 1.0 / row.variance
    factor = w * mean.weight / (mean.weight - w)
    for p in range(3):
        zp = factor * (row.e[p] - mean.e[p])
        b[p] += zp * (row.y - mean.y)
        for q in range(p, 3):
            A[p, q] -= zp * (row.e[q] - mean.e[q])


@jit(borrows=True)
def _worst_row(rows: Records, groups: Records, Q: Array, x: Array) -> tuple[float, float, int]:
    """Global statistic, largest absolute w-statistic and its row (-1: none can be checked)."""
    total, largest, at = 0.0, 0.0, -1
    q00, q11, q22, q01, q02, q12 = Q[0, 0], Q[1, 1], Q[2, 2], 2.0 * Q[0, 1], 2.0 * Q[0, 2], 2.0 * Q[1, 2]
    x0, x1, x2 = x[0], x[1], x[2]
    for i in range(rows.shape[0]):
        row = rows[i]
        if not row.used:
            continue
        mean, w = groups[row.group], 1.0 / row.variance
        z0, z1, z2 = row.e[0] - mean.e[0], row.e[1] - mean.e[1], row.e[2] - mean.e[2]
        r = row.y - mean.y + z0 * x0 + z1 * x1 + z2 * x2
        square = w * r * r
        total += square
        leverage = z0 * (q00 * z0 + q01 * z1 + q02 * z2) + z1 * (q11 * z1 + q12 * z2) + q22 * z2 * z2
        redundancy = 1.0 - w * (1.0 / mean.weight + leverage)
        if redundancy > RANK_TOLERANCE and (square > largest * redundancy or at < 0):
            largest, at = square / redundancy, i
    return total, math.sqrt(largest), at


@jit
def _worst_constellation(
    rows: Records, heading: float, fit: Any, limits: tuple[Array, Array], search: int, x: Array, Q: Array
) -> tuple[float, float, int, int]:
    """Test each constellation whose removal leaves a solution.

    Parameters
    ----------
    fit : global statistic and redundancy of all rows in use.
    limits : rows of ``Thresholds.factor`` and ``Thresholds.chi2``.

    Returns
    -------
    largest statistic of the search over its threshold, both squared; the same of the mode to name, which T confirms;
    its system (-1: none can be tested); redundancy without it.
    """
    total, df = fit
    factor, chi2 = limits
    groups, rest = np.empty(MAX_CLOCKS, GROUP), rows.copy()
    A, b, x_i, Q_i = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((3, 3))
    sin_h, cos_h = math.sin(heading), math.cos(heading)
    suspicion, largest, at, df_left = 0.0, 0.0, -1, 0
    for g in range(MAX_GROUPS):
        removed = 0
        for i in range(rows.shape[0]):
            rest[i].used = rows[i].used and rows[i].system != g
            removed += rows[i].used and rows[i].system == g
        if removed == 0:
            continue
        left, present = _centre_groups(rest, groups)
        _normal_equations(rest, groups, A, b)
        df_i = left - 3 - present
        rank = df - df_i
        if df_i < 0 or rank < 1 or not invert_3x3(A, Q_i):
            continue
        for p in range(3):
            x_i[p] = Q_i[p, 0] * b[0] + Q_i[p, 1] * b[1] + Q_i[p, 2] * b[2]
        total_i, _, _ = _worst_row(rest, groups, Q_i, x_i)
        drop = max(total - total_i, 0.0)
        confirmed = drop / chi2[rank]
        if search == W_TEST:
            suspected = confirmed
        else:
            suspected = _separation(x, x_i, Q, Q_i, sin_h, cos_h, factor, search)
        suspicion = max(suspicion, suspected)
        excess = min(suspected, confirmed)
        if at < 0 or excess > largest:
            largest, at, df_left = excess, g, df_i
    return suspicion, largest, at, df_left


@jit
def _separation(
    x: Array, x_i: Array, Q: Array, Q_i: Array, sin_h: float, cos_h: float, factor: Array, search: int
) -> float:
    """Squared separation over squared threshold (R,): the larger of AT and CT, or the direction of maximum error."""
    e, n = x[0] - x_i[0], x[1] - x_i[1]
    ee, en, nn = Q_i[0, 0] - Q[0, 0], Q_i[0, 1] - Q[0, 1], Q_i[1, 1] - Q[1, 1]
    still = STILL_BELOW * (Q_i[0, 0] + Q_i[1, 1])
    if search == SEPARATION:
        at, ct = sin_h * e + cos_h * n, cos_h * e - sin_h * n
        cross = 2.0 * sin_h * cos_h * en
        v_at, v_ct = sin_h * sin_h * ee + cross + cos_h * cos_h * nn, cos_h * cos_h * ee - cross + sin_h * sin_h * nn
        worst = at * at / v_at if v_at > still else 0.0
        worst = max(worst, ct * ct / v_ct if v_ct > still else 0.0)
        return float(worst / factor[1] ** 2)
    half, det = 0.5 * (ee + nn), ee * nn - en * en
    major = half + math.sqrt(max(half * half - det, 0.0))
    if not major > still:
        return 0.0
    if det > RANK_TOLERANCE * major * major:
        return float((nn * e * e - 2.0 * en * e * n + ee * n * n) / (det * factor[2] ** 2))
    a, c = (major - nn, en) if ee > nn else (en, major - ee)
    along = (a * e + c * n) ** 2 / (a * a + c * c)
    return float(along / (major * factor[1] ** 2))


@jit(borrows=True)
def _systems_in_use(rows: Records) -> int:
    """Number of constellations with rows in use."""
    seen = 0
    for i in range(rows.shape[0]):
        if rows[i].used:
            seen |= 1 << rows[i].system
    count = 0
    for g in range(MAX_GROUPS):
        count += seen >> g & 1
    return count


@jit
def detect_and_exclude(
    rows: Records, heading: float, thresholds: Thresholds, rules: Any, x: Array, Q: Array
) -> tuple[int, float, float, int, int]:
    """Test, exclude the mode that exceeds its threshold most, test again.

    Parameters
    ----------
    rows : (S,) of ROW; ``used`` of excluded rows is cleared in place. Groups 0 to MAX_CLOCKS - 1, systems 0 to
        MAX_GROUPS - 1.
    heading : azimuth of motion [rad], along and across which constellations are tested.
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
    modes, excluded = 0, 0
    while True:
        df = count - 3 - present
        if count < 4 or not invert_3x3(A, Q):
            return SINGULAR, 0.0, 0.0, 0, excluded
        for p in range(3):
            x[p] = Q[p, 0] * b[0] + Q[p, 1] * b[1] + Q[p, 2] * b[2]
        total, largest, at = _worst_row(rows, groups, Q, x)
        if df < 1:
            return NO_REDUNDANCY, 0.0, 0.0, 0, excluded
        tests = count + (_systems_in_use(rows) if rules.constellations else 0)
        index = tests if rules.by_tests else df
        limit = thresholds.limits[index].local
        suspicion, excess, failed, df_left = 0.0, 0.0, -1, 0
        if rules.constellations:
            limits = (thresholds.factor[index], thresholds.chi2[index])
            suspicion, excess, failed, df_left = _worst_constellation(
                rows, heading, (total, df), limits, rules.search, x, Q
            )
        beyond = total >= thresholds.limits[df].overall
        detected = beyond or (not rules.global_first and (largest >= limit or suspicion >= 1.0))
        if not detected:
            return (EXCLUDED if modes > 0 else CLEAN), total, largest, df, excluded
        if failed >= 0 and excess > (largest / limit) ** 2:
            if excess < 1.0 or modes >= rules.max_excluded or df_left < rules.min_redundancy:
                return UNRESOLVED, total, largest, df, excluded
            for i in range(rows.shape[0]):
                if rows[i].used and rows[i].system == failed:
                    rows[i].used = False
                    excluded += 1
            count, present = _centre_groups(rows, groups)
            _normal_equations(rows, groups, A, b)
        else:
            if at < 0 or largest < limit or modes >= rules.max_excluded or df - 1 < rules.min_redundancy:
                return UNRESOLVED, total, largest, df, excluded
            _remove_row(rows[at], groups[rows[at].group], A, b)
            rows[at].used = False
            excluded += 1
            count, present = _centre_groups(rows, groups)
        modes += 1
