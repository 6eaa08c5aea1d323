"""Correction of the models of one vehicle by one sensor vector, and the test of its innovation (S4 eq 8).

``z = H x + w``, ``w ~ N(0, R)``: ``nu = z - H x``, ``S = H P H' + R``, ``NIS = nu' S^-1 nu``, ``W = P H' S^-1``,
``x + W nu``, ``P - W S W'`` (S4 section II-D3). With every correction, the change of the state per unit of bounded
constant errors and of slow errors, the influence, advances: ``I <- I + W (B - H I)``, B that of the vector itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

__all__ = ["MOST", "UNTESTED", "Models", "Vector", "best_nis", "clear", "observe", "vector_of"]

Array = NDArray[np.float64]
MOST = 3  # components of a sensor vector
UNTESTED = math.inf  # threshold of a vector that is not tested
LOG_2PI = math.log(2.0 * math.pi)


class Models(NamedTuple):
    """Filters of one vehicle: x (r, STATES), p (r, STATES, STATES), influence (r, STATES, J), log likelihood (r,)."""

    x: Array
    p: Array
    influence: Array
    likelihood: Array


class Vector(NamedTuple):
    """A sensor vector of up to MOST components, and memory for its correction.

    z (MOST,), h (MOST, STATES); r (MOST, MOST) covariance with which the state is corrected, and ``single`` of one
    vector by itself, with which it is tested: smaller, where errors last and so bring less than they seem to; errors
    (MOST, J): change per unit of the bounded and of the slow errors. The rest is memory.
    """

    z: Array
    h: Array
    r: Array
    single: Array
    errors: Array
    residual: Array
    ph: Array
    gain: Array
    s: Array
    inverse: Array
    brought: Array


@jit
def vector_of(errors: int) -> Vector:
    """A sensor vector of zeros with J kinds of errors."""
    square = (MOST, MOST)
    return Vector(
        np.zeros(MOST), np.zeros((MOST, STATES)), np.zeros(square), np.zeros(square), np.zeros((MOST, errors)),
        np.zeros(MOST), np.zeros((STATES, MOST)), np.zeros((STATES, MOST)), np.zeros(square), np.zeros(square),
        np.zeros((MOST, errors)),
    )  # fmt: skip


@jit
def clear(v: Vector) -> None:
    """Zero what describes a vector."""
    v.h[:] = 0.0
    v.r[:] = 0.0
    v.single[:] = 0.0
    v.errors[:] = 0.0


@jit
def observe(models: Models, v: Vector, size: int, threshold: float, angular: bool) -> tuple[float, bool]:
    """Correct all models by a vector of ``size`` components, and add its log likelihood; NIS and whether it was used.

    A vector is rejected when it fails the gate of every model, so that the likelihoods of the models are of the same
    measurements; the NIS is that of the model that fits best. What is not finite is rejected, tested or not.
    """
    best = best_nis(models, v, size, angular)
    if not (math.isfinite(best) and best <= threshold):
        return best, False
    for j in range(models.x.shape[0]):
        log_det = _innovate(models, v, j, size, v.r, angular)
        models.likelihood[j] -= 0.5 * (_nis(v, size) + size * LOG_2PI + log_det)
        _correct(models, v, j, size)
        _influence(models, v, j, size)
    return best, True


@jit
def best_nis(models: Models, v: Vector, size: int, angular: bool) -> float:
    """NIS of a vector by itself, of the model that fits best."""
    best = math.inf
    for j in range(models.x.shape[0]):
        _innovate(models, v, j, size, v.single, angular)
        nis = _nis(v, size)
        if not math.isfinite(nis):
            return math.inf
        best = min(best, nis)
    return best


@jit
def _innovate(models: Models, v: Vector, j: int, size: int, noise: Array, angular: bool) -> float:
    """Residual, ``P H'``, S and its inverse of model j; returns ``log det S``."""
    x, p = models.x[j], models.p[j]
    for a in range(size):
        expected = 0.0
        for k in range(STATES):
            v.ph[k, a] = 0.0
        for k in range(STATES):
            h = v.h[a, k]
            if h != 0.0:
                expected += h * x[k]
                for i in range(STATES):
                    v.ph[i, a] += h * p[k, i]
        nu = v.z[a] - expected
        if angular:
            nu = wrap(nu)
        v.residual[a] = nu
    for a in range(size):
        for b in range(a + 1):
            total = noise[a, b]
            for k in range(STATES):
                total += v.h[b, k] * v.ph[k, a]
            v.s[a, b] = v.s[b, a] = total
    return float(_invert(v.s, v.inverse, size))


@jit
def _invert(s: Array, inverse: Array, size: int) -> float:
    """Inverse of a symmetric positive definite matrix by elimination; returns the logarithm of its determinant."""
    if size == 1:
        inverse[0, 0] = 1.0 / s[0, 0]
        return math.log(s[0, 0])
    left, log_det = s.copy(), 0.0
    inverse[:] = 0.0
    for a in range(size):
        inverse[a, a] = 1.0
    for a in range(size):
        pivot = left[a, a]
        log_det += math.log(pivot)
        for c in range(size):
            left[a, c] /= pivot
            inverse[a, c] /= pivot
        for b in range(size):
            if b != a:
                by = left[b, a]
                for c in range(size):
                    left[b, c] -= by * left[a, c]
                    inverse[b, c] -= by * inverse[a, c]
    return log_det


@jit
def _nis(v: Vector, size: int) -> float:
    total = 0.0
    for a in range(size):
        for b in range(size):
            total += v.residual[a] * v.inverse[a, b] * v.residual[b]
    return total


@jit
def _correct(models: Models, v: Vector, j: int, size: int) -> None:
    """``x + W nu`` and ``P - W (P H')'`` of model j."""
    x, p = models.x[j], models.p[j]
    for k in range(STATES):
        for a in range(size):
            total = 0.0
            for b in range(size):
                total += v.ph[k, b] * v.inverse[b, a]
            v.gain[k, a] = total
            x[k] += total * v.residual[a]
    for k in range(STATES):
        for i in range(k + 1):
            total = 0.0
            for a in range(size):
                total += v.gain[k, a] * v.ph[i, a]
            p[k, i] -= total
            p[i, k] = p[k, i]


@jit
def _influence(models: Models, v: Vector, j: int, size: int) -> None:
    """``I <- I + W (B - H I)`` of model j."""
    influence = models.influence[j]
    for a in range(size):
        brought = v.brought[a]
        brought[:] = v.errors[a]
        for k in range(STATES):
            h = v.h[a, k]
            if h != 0.0:
                for e in range(brought.shape[0]):
                    brought[e] -= h * influence[k, e]
    for k in range(STATES):
        for a in range(size):
            gain, brought = v.gain[k, a], v.brought[a]
            if gain != 0.0:
                for e in range(brought.shape[0]):
                    influence[k, e] += gain * brought[e]
