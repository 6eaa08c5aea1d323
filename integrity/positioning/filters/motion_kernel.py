"""Motion of a road vehicle between two scans (S4 eq 1-2), for one model of one vehicle.

States as in :mod:`.vehicle_models`. ``x(k+1) = f(x(k)) + G(x(k)) v(k)`` with the course ``c = heading + slip + slide``,
the acceleration a less its bias, and the rate ``w = yaw rate + slip rate``:

``along = T v + T^2 a / 2``, ``across = T^2 v w / 2``, ``E += sin(c) along + cos(c) across``,
``N += cos(c) along - sin(c) across``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.positioning.filters.vehicle_states_kernel import (
    ACCEL_BIAS,
    EAST,
    GYRO_ANGLE,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADING,
    NORTH,
    SLIDE,
    SLIP,
    SLIP_RATE,
    SPEED,
    YAW_RATE,
)

__all__ = ["Slopes", "fill_noise", "move_columns", "move_rows", "move_state", "slopes_of"]

Array = NDArray[np.float64]
REST = 1.0 / math.sqrt(12.0)  # integral of white noise over a scan that is independent of its mean: sqrt(1/3 - 1/4)


class Slopes(NamedTuple):
    """What differs from the unit matrix in ``F = df/dx``: derivatives of East and North by each of heading, slip and
    slide (angle), by speed, by each of yaw rate and slip rate (rate), by the bias of the acceleration (bias); T [s],
    increment of the gyro [rad], and T where the acceleration is measured, else 0."""

    east_angle: float
    north_angle: float
    east_speed: float
    north_speed: float
    east_rate: float
    north_rate: float
    east_bias: float
    north_bias: float
    dt: float
    turn: float
    driven: float


@jit
def slopes_of(x: Array, dt: float, turn: float, acceleration: float, driven: bool) -> Slopes:
    """The derivatives at a state x (STATES,); ``driven``: the acceleration is measured [m/s^2]."""
    course = x[HEADING] + x[SLIP] + x[SLIDE]
    s, c, half = math.sin(course), math.cos(course), 0.5 * dt * dt
    a = acceleration - x[ACCEL_BIAS] if driven else 0.0
    rate = x[YAW_RATE] + x[SLIP_RATE]
    along, across = dt * x[SPEED] + half * a, half * x[SPEED] * rate
    biased = half if driven else 0.0
    return Slopes(
        c * along - s * across, -s * along - c * across, dt * s + half * rate * c, dt * c - half * rate * s,
        half * x[SPEED] * c, -half * x[SPEED] * s, -biased * s, -biased * c, dt, turn, dt if driven else 0.0,
    )  # fmt: skip


@jit
def move_state(x: Array, dt: float, turn: float, acceleration: float, driven: bool) -> None:
    """``x <- f(x)`` without noise."""
    course = x[HEADING] + x[SLIP] + x[SLIDE]
    s, c, half = math.sin(course), math.cos(course), 0.5 * dt * dt
    a = acceleration - x[ACCEL_BIAS] if driven else 0.0
    along, across = dt * x[SPEED] + half * a, half * x[SPEED] * (x[YAW_RATE] + x[SLIP_RATE])
    x[EAST] += s * along + c * across
    x[NORTH] += c * along - s * across
    x[HEADING] += dt * x[YAW_RATE]
    x[SPEED] += dt * a
    x[SLIP] += dt * x[SLIP_RATE]
    x[GYRO_ANGLE] += dt * x[GYRO_BIAS] + turn * x[GYRO_SCALE]


@jit
def move_rows(f: Slopes, m: Array) -> None:
    """``M <- F M`` for M (STATES, n)."""
    for k in range(m.shape[1]):
        angle, rate = m[HEADING, k] + m[SLIP, k] + m[SLIDE, k], m[YAW_RATE, k] + m[SLIP_RATE, k]
        speed, bias = m[SPEED, k], m[ACCEL_BIAS, k]
        m[EAST, k] += f.east_angle * angle + f.east_speed * speed + f.east_rate * rate + f.east_bias * bias
        m[NORTH, k] += f.north_angle * angle + f.north_speed * speed + f.north_rate * rate + f.north_bias * bias
        m[HEADING, k] += f.dt * m[YAW_RATE, k]
        m[SPEED, k] -= f.driven * bias
        m[SLIP, k] += f.dt * m[SLIP_RATE, k]
        m[GYRO_ANGLE, k] += f.dt * m[GYRO_BIAS, k] + f.turn * m[GYRO_SCALE, k]


@jit
def move_columns(f: Slopes, m: Array) -> None:
    """``M <- M F'`` for M (n, STATES)."""
    for k in range(m.shape[0]):
        row = m[k]
        angle, rate = row[HEADING] + row[SLIP] + row[SLIDE], row[YAW_RATE] + row[SLIP_RATE]
        speed, bias = row[SPEED], row[ACCEL_BIAS]
        row[EAST] += f.east_angle * angle + f.east_speed * speed + f.east_rate * rate + f.east_bias * bias
        row[NORTH] += f.north_angle * angle + f.north_speed * speed + f.north_rate * rate + f.north_bias * bias
        row[HEADING] += f.dt * row[YAW_RATE]
        row[SPEED] -= f.driven * bias
        row[SLIP] += f.dt * row[SLIP_RATE]
        row[GYRO_ANGLE] += f.dt * row[GYRO_BIAS] + f.turn * row[GYRO_SCALE]


@jit
def fill_noise(x: Array, dt: float, curved: bool, sigma: Array, g: Array) -> None:
    """``G(x) sqrt(Q)`` into g (STATES, WHITE), with 1-sigmas over a scan sigma (WHITE,).

    The first four columns are those of S4 eq 2, accelerations that are constant over a scan. They leave heading and yaw
    rate with one noise for two states: a filter that measures the heading precisely would find each acceleration
    exactly, and would swing about a yaw rate that has stepped (the zero of the sampled model lies at -1). White
    accelerations move the angle, the position and the slip by an independent part of ``T^2 / sqrt(12)`` beside: the
    last columns, for yaw acceleration, acceleration and slip: acceleration (curved), or rate (straight), which moves
    the position.
    """
    course = x[HEADING] + x[SLIP] + x[SLIDE]
    s, c, half, rest, speed = math.sin(course), math.cos(course), 0.5 * dt * dt, REST * dt * dt, x[SPEED]
    g[:] = 0.0
    g[HEADING, 0], g[YAW_RATE, 0] = half * sigma[0], dt * sigma[0]
    g[EAST, 1], g[NORTH, 1], g[SPEED, 1] = half * s * sigma[1], half * c * sigma[1], dt * sigma[1]
    if curved:
        g[SLIP, 2], g[SLIP_RATE, 2], g[SLIP, 6] = half * sigma[2], dt * sigma[2], rest * sigma[6]
    else:  # a change of the slip turns the velocity
        g[SLIP, 2] = dt * sigma[2]
        g[EAST, 2], g[NORTH, 2] = half * speed * c * sigma[2], -half * speed * s * sigma[2]
        g[EAST, 6], g[NORTH, 6] = rest * speed * c * sigma[6], -rest * speed * s * sigma[6]
    g[SLIDE, 3] = dt * sigma[3]
    g[EAST, 3], g[NORTH, 3] = half * speed * c * sigma[3], -half * speed * s * sigma[3]
    g[HEADING, 4] = rest * sigma[4]
    g[EAST, 5], g[NORTH, 5] = rest * s * sigma[5], rest * c * sigma[5]
