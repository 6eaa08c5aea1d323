"""Symmetric 3x3 matrices (normal matrices of a position after elimination of the clocks), and HDOP."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["MAX_GROUPS", "cholesky_2", "hdop_of", "invert_3x3", "invert_upper", "multiply_3"]

Array = NDArray[np.float64]

MAX_GROUPS = 8  # clocks of a receiver
SINGULAR_BELOW = 1e-12  # limit of the determinant after scaling to a unit diagonal, and of the ratio in the diagonal


@jit
def cholesky_2(a: float, b: float, c: float) -> tuple[float, float, float]:
    """``l_11, l_21, l_22`` of [[a, b], [b, c]] = L L'; zeros where a is not positive."""
    if not a > 0.0:
        return 0.0, 0.0, math.sqrt(max(c, 0.0))
    first = math.sqrt(a)
    second = b / first
    return first, second, math.sqrt(max(c - second * second, 0.0))


@jit
def invert_upper(
    a: float, b: float, c: float, d: float, e: float, f: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Whether [[a, b, c], [b, d, e], [c, e, f]] is positive definite, and the upper triangle of its inverse."""
    m, o, p = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m + b * o + c * p
    least, most = min(a, d, f), max(a, d, f)
    if not (det > SINGULAR_BELOW * a * d * f and least > SINGULAR_BELOW * most):  # also for NaN
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    t = 1.0 / det
    q, r = a * f - c * c, a * d - b * b
    return m > 0.0 and q > 0.0 and r > 0.0, m * t, o * t, p * t, q * t, (b * c - a * e) * t, r * t


@jit
def invert_3x3(matrix: Array, out: Array) -> bool:
    """Inverse of a symmetric positive definite 3x3 matrix; returns False (``out`` undefined) for other matrices."""
    ok, out[0, 0], out[0, 1], out[0, 2], out[1, 1], out[1, 2], out[2, 2] = invert_upper(
        matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]
    )
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return bool(ok)


@jit
def multiply_3(matrix: Array, vector: Array, out: Array) -> None:
    """``out = matrix vector`` for a 3x3 matrix."""
    for j in range(3):
        out[j] = matrix[j, 0] * vector[0] + matrix[j, 1] * vector[1] + matrix[j, 2] * vector[2]


@jit
def hdop_of(rows: Records) -> float:
    """HDOP ``sqrt(Q_EE + Q_NN)`` of the rows in use, ``Q`` of ``(G'G)^-1`` with a clock for each group; singular: inf.

    rows (S,) of :data:`~lanebound.integrity.positioning.rows_kernel.ROW`, groups below MAX_GROUPS.
    """
    return float(_hdop(rows, np.zeros((MAX_GROUPS, 4))))


@jit(borrows=True)
def _hdop(rows: Records, mean: Array) -> float:
    """:func:`hdop_of`; mean (MAX_GROUPS, 4) of zeros is scratch."""
    for s in range(rows.shape[0]):
        if rows[s].used:
            row, e = mean[rows[s].group], rows[s].e
            row[0] += e[0]
            row[1] += e[1]
            row[2] += e[2]
            row[3] += 1.0
    for k in range(MAX_GROUPS):
        row = mean[k]
        if row[3] > 0.0:
            row[0], row[1], row[2] = row[0] / row[3], row[1] / row[3], row[2] / row[3]
    a, b, c, d, f, g = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for s in range(rows.shape[0]):
        if rows[s].used:
            row, e = mean[rows[s].group], rows[s].e
            x, y, z = e[0] - row[0], e[1] - row[1], e[2] - row[2]
            a += x * x
            b += x * y
            c += x * z
            d += y * y
            f += y * z
            g += z * z
    ok, east, _, _, north, _, _ = invert_upper(a, b, c, d, f, g)
    return math.sqrt(east + north) if ok else math.inf
