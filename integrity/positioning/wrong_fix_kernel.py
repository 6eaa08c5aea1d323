"""Wrong integers that fit almost as well as the right ones: what the search of one epoch offers after the best vector.

Used by the fault ``wrong_fix``. A wrong fix of a receiver is not any vector: it is one whose distance from the float
solution is small, so that its residuals and its displacement look likely.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, invert_3x3, multiply_3
from lanebound.integrity.positioning.lambda_kernel import integer_least_squares, search_scratch
from lanebound.integrity.positioning.rtk_kernel import (
    BASE,
    MOST_AMBIGUITIES,
    Carriers,
    float_ambiguities,
    order_by_variance,
)

__all__ = ["displacement_of", "next_best_integers"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SEARCH_NODES = 200_000


@jit
def _clock_free_normals(
    signals: Records, satellites: Records, variance: Array, rows: Records, mean: Array, normal: Array
) -> None:
    """``sum (e - e-)(e - e-)' / variance`` (3, 3) of the rows in use, and e- and the weight by system, (G, 4)."""
    mean[:], normal[:] = 0.0, 0.0
    for s in range(rows.shape[0]):
        if rows[s].used:
            c, w = satellites[s].system, 1.0 / variance[s]
            for k in range(3):
                mean[c, k] += w * signals[s].e[k]
            mean[c, 3] += w
    for c in range(mean.shape[0]):
        if mean[c, 3] > 0.0:
            for k in range(3):
                mean[c, k] /= mean[c, 3]
    for s in range(rows.shape[0]):
        if rows[s].used:
            c, e = satellites[s].system, signals[s].e
            for i in range(3):
                for k in range(3):
                    normal[i, k] += (e[i] - mean[c, i]) * (e[k] - mean[c, k]) / variance[s]


@jit
def displacement_of(integers: Ints, carriers: Carriers, rows: Records, bands: int, out: Array) -> bool:
    """By how much integers (S, 2) [cycles] that positioning subtracts move the position of the carriers, (3,) [m].

    ``y = -e.x`` becomes ``y - lambda N``; both bands weigh alike. False where the geometry is singular.
    """
    satellites, signals, variance = carriers
    mean, normal, inverse, rhs = np.empty((MAX_GROUPS, 4)), np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    _clock_free_normals(signals, satellites, variance, rows, mean, normal)
    if not invert_3x3(normal, inverse):
        return False
    for s in range(rows.shape[0]):
        if rows[s].used:
            length, c = 0.0, satellites[s].system
            for b in range(bands):
                length += satellites[s].wavelength[b] * integers[s, b] / bands
            for k in range(3):
                rhs[k] += (signals[s].e[k] - mean[c, k]) * length / variance[s]
    multiply_3(inverse, rhs, out)
    return True


@jit
def next_best_integers(carriers: Carriers, rows: Records, rank: int, azimuth: float, rules: Any, out: Ints) -> bool:
    """Fill the integers (S, 2) that are off by the ``rank``-th best wrong vector of the rows (S,) in use, of one epoch.

    The vectors ``z != 0`` of least ``z' Q_a^-1 z``, Q_a the covariance of the float ambiguities by code and carrier of
    this epoch alone: with noise-free measurements the second best candidate of a search is the best of them. z and -z
    fit alike; it is the one that moves the position towards the azimuth [rad]. ``carriers.variance`` holds the variance
    factors; rules of RTK_RULES. False where there is no such vector.
    """
    satellites, signals, factor = carriers
    bands, count = rules.bands, 0
    order, used = np.empty(MOST_AMBIGUITIES // bands, dtype=np.int64), np.empty(rows.shape[0], dtype=np.bool_)
    for s in range(rows.shape[0]):
        used[s] = rows[s].used
    count = order_by_variance(used, factor, order.shape[0], order)
    mean, normal, q = np.empty((MAX_GROUPS, 4)), np.empty((3, 3)), np.empty((3, 3))
    _clock_free_normals(signals, satellites, factor, rows, mean, normal)
    code = rules.sigma_code * rules.sigma_code / bands
    if not invert_3x3(normal / code, q):
        return False
    c = bands * count
    owner, a_hat, q_a, base = np.empty(c, dtype=np.int64), np.empty(c), np.empty((c, c)), np.zeros(MAX_GROUPS, BASE)
    precise = Carriers(satellites, signals, factor * rules.sigma_phase**2)
    n = float_ambiguities(precise, order, count, bands, np.zeros(3), q, base, a_hat, q_a, owner)
    a_hat[:] = 0.0
    scratch = search_scratch(c, 2 * rank + 1)
    integer_least_squares(n, a_hat, q_a, SEARCH_NODES, False, scratch)
    if not scratch.norms[2 * rank - 1] < math.inf:
        return False
    out[:] = 0
    for i in range(n):
        out[owner[i], i % bands] = np.int64(scratch.candidates[2 * rank - 1, i])
    moved = np.zeros(3)
    if displacement_of(out, carriers, rows, bands, moved):
        if moved[0] * math.sin(azimuth) + moved[1] * math.cos(azimuth) < 0.0:
            for s in range(out.shape[0]):
                out[s, 0], out[s, 1] = -out[s, 0], -out[s, 1]
    return True
