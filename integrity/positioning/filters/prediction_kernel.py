"""Prediction of state and covariance of one model: extended (S4 section II-D1) and unscented (section II-E)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.positioning.filters.motion_kernel import (
    Slopes,
    fill_noise,
    move_columns,
    move_rows,
    move_state,
)
from lanebound.integrity.positioning.filters.vehicle_states_kernel import SLIP_RATE, STATES, WHITE

__all__ = ["PREDICTION", "predict_extended", "predict_unscented"]

Array = NDArray[np.float64]
POINTS = 1 + 2 * (STATES + WHITE)
SCALE = float(STATES + WHITE)  # L + lambda of S4 section II-E: alpha 1, kappa 0
CENTRE_WEIGHT, CENTRE_COVARIANCE_WEIGHT, POINT_WEIGHT = 0.0, 2.0, 0.5 / SCALE  # beta 2
JITTER = 1e-16  # makes a singular covariance decomposable; a standard deviation of 1e-8
RELATIVE = 1e-12  # likewise, of the variance of each state
MOVING = SLIP_RATE + 1  # states that noise of the motion reaches come first


PREDICTION = record(
    noise=("f8", (STATES, WHITE), "the motion's noise, ``G sqrt(Q)``"),
    root=("f8", (STATES, STATES), "Cholesky factor of the covariance"),
    points=("f8", (POINTS, STATES), "sigma points"),
    mean=("f8", (STATES,), "their mean"),
)
"""Memory of a prediction."""


@jit
def predict_extended(model: Any, f: Slopes, curved: bool, sigma: Array, errors: Array, w: Any) -> None:
    """``x <- f(x)``, ``P <- F P F' + G Q G' + errors``.

    sigma (WHITE,) noise of the motion over a scan; errors (STATES,) variance that sensor errors gain.
    """
    x, p = model.x, model.p
    fill_noise(x, f.dt, curved, sigma, w.noise)
    move_rows(f, p)
    move_columns(f, p)
    for i in range(MOVING):
        for j in range(MOVING):
            total = 0.0
            for k in range(WHITE):
                total += w.noise[i, k] * w.noise[j, k]
            p[i, j] += total
    for i in range(STATES):
        p[i, i] += errors[i]
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
    move_state(x, f.dt, f.turn, model.acceleration, f.driven > 0.0)


@jit
def predict_unscented(model: Any, f: Slopes, curved: bool, sigma: Array, errors: Array, w: Any) -> None:
    """The unscented prediction with the noise as part of the state (S4 section II-E).

    The noises of the motion extend the state. Errors of sensors change linearly, so their noise is added afterwards. A
    straight model has no slip rate: the jitter of the decomposition must not create one.
    """
    x, p, points, mean = model.x, model.p, w.points, w.mean
    fill_noise(x, f.dt, curved, sigma, w.noise)
    _decompose(p, w.root)
    spread, driven = math.sqrt(SCALE), f.driven > 0.0
    for n in range(STATES):
        up, down = points[1 + n], points[1 + STATES + n]
        for i in range(STATES):
            up[i], down[i] = x[i] + w.root[i, n], x[i] - w.root[i, n]
        move_state(up, f.dt, f.turn, model.acceleration, driven)
        move_state(down, f.dt, f.turn, model.acceleration, driven)
    move_state(x, f.dt, f.turn, model.acceleration, driven)
    points[0] = x
    for n in range(WHITE):
        up, down = points[1 + 2 * STATES + n], points[1 + 2 * STATES + WHITE + n]
        for i in range(STATES):
            by = spread * w.noise[i, n]
            up[i], down[i] = x[i] + by, x[i] - by
    if not curved:
        points[:, SLIP_RATE] = 0.0
    mean[:] = CENTRE_WEIGHT * points[0]
    for n in range(1, POINTS):
        for i in range(STATES):
            mean[i] += POINT_WEIGHT * points[n, i]
    p[:] = 0.0
    for n in range(POINTS):
        weight = CENTRE_COVARIANCE_WEIGHT if n == 0 else POINT_WEIGHT
        for i in range(STATES):
            apart = weight * (points[n, i] - mean[i])
            for j in range(i + 1):
                p[i, j] += apart * (points[n, j] - mean[j])
    for i in range(STATES):
        p[i, i] += errors[i]
        for j in range(i):
            p[j, i] = p[i, j]
        x[i] = mean[i]


@jit
def _decompose(p: Array, root: Array) -> None:
    """Lower Cholesky factor of ``SCALE P``, made regular."""
    root[:] = 0.0
    for i in range(STATES):
        for j in range(i + 1):
            total = SCALE * p[i, j]
            if i == j:
                total += SCALE * (JITTER + RELATIVE * p[i, i])
            for k in range(j):
                total -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(total, SCALE * JITTER))
            else:
                root[i, j] = total / root[j, j]
