"""Correction of the models of one vehicle by one sensor vector, and the test of its innovation (S4 eq 8).

``z = H x + w``, ``w ~ N(0, R)``: ``nu = z - H x``, ``S = H P H' + R``, ``NIS = nu' S^-1 nu``, ``W = P H' S^-1``,
``x + W nu``, ``P - W S W'`` (S4 section II-D3). With every correction, the change of the state per unit of bounded
constant errors and of slow errors, the influence, advances: ``I <- I + W (B - H I)``, B that of the vector itself.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

__all__ = ["MOST", "UNTESTED", "VECTOR", "Models", "Vector", "best_nis", "cleared", "observe", "vector_of"]

Array = NDArray[np.float64]
MOST = 3  # components of a sensor vector
UNTESTED = math.inf  # threshold of a vector that is not tested
LOG_2PI = math.log(2.0 * math.pi)


class Models(NamedTuple):
    """Filters of one vehicle: filters (r,) of MODEL, influence (r, STATES, J)."""

    filters: Records
    influence: Array


VECTOR = record(
    z=("f8", (MOST,), "the components"),
    h=("f8", (MOST, STATES), "their derivatives by the states"),
    r=("f8", (MOST, MOST), "covariance with which the state is corrected"),
    single=("f8", (MOST, MOST), "that of one vector by itself, with which it is tested: smaller, where errors last"),
    residual=("f8", (MOST,), "nu"),
    ph=("f8", (STATES, MOST), "P H'"),
    gain=("f8", (STATES, MOST), "W"),
    s=("f8", (MOST, MOST), "S"),
    inverse=("f8", (MOST, MOST), "its inverse"),
)
"""A sensor vector of up to MOST components, and memory for its correction."""


class Vector(NamedTuple):
    """row (1,) of VECTOR; errors (MOST, J) change per unit of bounded and of slow errors, brought its memory."""

    row: Records
    errors: Array
    brought: Array


@jit
def vector_of(errors: int) -> Vector:
    """A sensor vector of zeros with J kinds of errors."""
    return Vector(np.zeros(1, VECTOR), np.zeros((MOST, errors)), np.zeros((MOST, errors)))


@jit
def cleared(w: Vector) -> Any:
    """The record of a vector, with zeros in all that describes it."""
    v = w.row[0]
    v.h[:] = 0.0
    v.r[:] = 0.0
    v.single[:] = 0.0
    w.errors[:] = 0.0
    return v


@jit
def observe(models: Models, w: Vector, size: int, threshold: float, angular: bool) -> tuple[float, bool]:
    """Correct all models by a vector of ``size`` components, and add its log likelihood; NIS and whether it was used.

    A vector is rejected when it fails the gate of every model, so that the likelihoods of the models are of the same
    measurements; the NIS is that of the model that fits best. What is not finite is rejected, tested or not.
    """
    v, filters = w.row[0], models.filters
    best = best_nis(filters, v, size, angular)
    if not (math.isfinite(best) and best <= threshold):
        return best, False
    for j in range(filters.shape[0]):
        log_det = _innovate(filters[j], v, size, v.r, angular)
        filters[j].likelihood -= 0.5 * (_nis(v, size) + size * LOG_2PI + log_det)
        _correct(filters[j], v, size)
        _influence(models.influence[j], w, size)
    return best, True


@jit
def best_nis(filters: Records, v: Any, size: int, angular: bool) -> float:
    """NIS of a vector by itself, of the model that fits best."""
    best = math.inf
    for j in range(filters.shape[0]):
        _innovate(filters[j], v, size, v.single, angular)
        nis = _nis(v, size)
        if not math.isfinite(nis):
            return math.inf
        best = min(best, nis)
    return best


@jit
def _innovate(model: Any, v: Any, size: int, noise: Array, angular: bool) -> float:
    """Residual, ``P H'``, S and its inverse of a model; returns ``log det S``."""
    x, p = model.x, model.p
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
def _nis(v: Any, size: int) -> float:
    total = 0.0
    for a in range(size):
        for b in range(size):
            total += v.residual[a] * v.inverse[a, b] * v.residual[b]
    return total


@jit
def _correct(model: Any, v: Any, size: int) -> None:
    """``x + W nu`` and ``P - W (P H')'`` of a model."""
    x, p = model.x, model.p
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
def _influence(influence: Array, w: Vector, size: int) -> None:
    """``I <- I + W (B - H I)`` of a model."""
    v = w.row[0]
    for a in range(size):
        brought = w.brought[a]
        brought[:] = w.errors[a]
        for k in range(STATES):
            h = v.h[a, k]
            if h != 0.0:
                for e in range(brought.shape[0]):
                    brought[e] -= h * influence[k, e]
    for k in range(STATES):
        for a in range(size):
            gain, brought = v.gain[k, a], w.brought[a]
            if gain != 0.0:
                for e in range(brought.shape[0]):
                    influence[k, e] += gain * brought[e]
