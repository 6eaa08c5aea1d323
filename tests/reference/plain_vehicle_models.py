"""Motion of a road vehicle between two scans in NumPy, for any batch: the reference of ``motion_kernel``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import NOISES, STATES

__all__ = ["MotionInput", "jacobian", "noise_gain", "scan_sigmas", "transition"]

Array = NDArray[np.float64]


REST = 1.0 / np.sqrt(12.0)  # integral of white noise over a scan that is independent of its mean: sqrt(1/3 - 1/4)


@dataclass(frozen=True)
class MotionInput:
    """What is known of the motion over a scan of ``dt_s``.

    turn_rad (...,) increment of the gyro; acceleration_mps2 (...,) measured along the velocity, 0 where it is not an
    input; ``accelerated``: whether it is one, so that its bias counts; gnss_decay, compass_decay: of slow errors [-].
    """

    dt_s: float
    turn_rad: Array
    acceleration_mps2: Array
    accelerated: bool = True
    gnss_decay: float = 1.0
    compass_decay: float = 1.0


def transition(x: Array, u: MotionInput) -> Array:
    """``f(x)`` of S4 eq 1 without noise.  (..., STATES) -> (..., STATES)."""
    t = u.dt_s
    along, across, a = _displacement(x, u)
    course = x[..., S.HEADING] + x[..., S.SLIP] + x[..., S.SLIDE]
    s, c = np.sin(course), np.cos(course)
    out = x.copy()
    out[..., S.EAST] += s * along + c * across
    out[..., S.NORTH] += c * along - s * across
    out[..., S.HEADING] += t * x[..., S.YAW_RATE]
    out[..., S.SPEED] += t * a
    out[..., S.SLIP] += t * x[..., S.SLIP_RATE]
    out[..., S.GYRO_ANGLE] += t * x[..., S.GYRO_BIAS] + u.turn_rad * x[..., S.GYRO_SCALE]
    out[..., S.COMPASS] *= u.compass_decay
    out[..., S.GNSS_EAST :] *= u.gnss_decay
    return out


def jacobian(x: Array, u: MotionInput) -> Array:
    """``F = df/dx`` (..., STATES, STATES)."""
    t = u.dt_s
    along, across, _ = _displacement(x, u)
    course = x[..., S.HEADING] + x[..., S.SLIP] + x[..., S.SLIDE]
    s, c = np.sin(course), np.cos(course)
    speed, rate = x[..., S.SPEED], x[..., S.YAW_RATE] + x[..., S.SLIP_RATE]
    f = np.zeros((*x.shape, STATES))
    f[..., range(STATES), range(STATES)] = 1.0
    for angle in (S.HEADING, S.SLIP, S.SLIDE):
        f[..., S.EAST, angle] = c * along - s * across
        f[..., S.NORTH, angle] = -s * along - c * across
    f[..., S.EAST, S.SPEED] = t * s + 0.5 * t * t * rate * c
    f[..., S.NORTH, S.SPEED] = t * c - 0.5 * t * t * rate * s
    for turning in (S.YAW_RATE, S.SLIP_RATE):
        f[..., S.EAST, turning] = 0.5 * t * t * speed * c
        f[..., S.NORTH, turning] = -0.5 * t * t * speed * s
    if u.accelerated:
        f[..., S.EAST, S.ACCEL_BIAS], f[..., S.NORTH, S.ACCEL_BIAS] = -0.5 * t * t * s, -0.5 * t * t * c
        f[..., S.SPEED, S.ACCEL_BIAS] = -t
    f[..., S.HEADING, S.YAW_RATE] = f[..., S.SLIP, S.SLIP_RATE] = f[..., S.GYRO_ANGLE, S.GYRO_BIAS] = t
    f[..., S.GYRO_ANGLE, S.GYRO_SCALE] = u.turn_rad
    f[..., S.COMPASS, S.COMPASS] = u.compass_decay
    f[..., S.GNSS_EAST, S.GNSS_EAST] = f[..., S.GNSS_NORTH, S.GNSS_NORTH] = u.gnss_decay
    return f


def noise_gain(x: Array, dt_s: float, curved: NDArray[np.bool_]) -> Array:
    """``G(x)`` (..., STATES, NOISES + 3); ``curved`` (r,) by model along the last axis but one of x.

    The first columns are those of S4 eq 2, accelerations that are constant over a scan. They leave heading and yaw rate
    with one noise for two states: a filter that measures the heading precisely would find each acceleration exactly,
    and would swing about a yaw rate that has stepped (the zero of the sampled model lies at -1). White accelerations
    move the angle, the position and the slip by an independent part of ``T^2 / sqrt(12)`` beside: the last columns, for
    yaw acceleration, acceleration and slip: acceleration (curved), or rate (straight), which moves the position.
    """
    t, half = dt_s, 0.5 * dt_s * dt_s
    course = x[..., S.HEADING] + x[..., S.SLIP] + x[..., S.SLIDE]
    s, c, speed = np.sin(course), np.cos(course), x[..., S.SPEED]
    bend = np.broadcast_to(curved, course.shape)
    g = np.zeros((*x.shape, NOISES + 3))
    g[..., S.HEADING, 0], g[..., S.YAW_RATE, 0] = half, t
    g[..., S.EAST, 1], g[..., S.NORTH, 1], g[..., S.SPEED, 1] = half * s, half * c, t
    g[..., S.SLIP, 2], g[..., S.SLIP_RATE, 2] = np.where(bend, half, t), np.where(bend, t, 0.0)
    g[..., S.SLIDE, 3] = t
    g[..., S.EAST, 2] = np.where(bend, 0.0, half * speed * c)  # a change of the slip turns the velocity
    g[..., S.NORTH, 2] = np.where(bend, 0.0, -half * speed * s)
    g[..., S.EAST, 3], g[..., S.NORTH, 3] = half * speed * c, -half * speed * s
    rest = REST * t * t
    g[..., S.HEADING, NOISES] = rest
    g[..., S.EAST, NOISES + 1], g[..., S.NORTH, NOISES + 1] = rest * s, rest * c
    g[..., S.SLIP, NOISES + 2] = np.where(bend, rest, 0.0)
    g[..., S.EAST, NOISES + 2] = np.where(bend, 0.0, rest * speed * c)
    g[..., S.NORTH, NOISES + 2] = np.where(bend, 0.0, -rest * speed * s)
    return g


def _displacement(x: Array, u: MotionInput) -> tuple[Array, Array, Array]:
    """Displacement along and across (to the right) of the velocity [m], and the acceleration [m/s^2]."""
    t, speed = u.dt_s, x[..., S.SPEED]
    a = u.acceleration_mps2 - x[..., S.ACCEL_BIAS] if u.accelerated else np.zeros_like(speed)
    rate = x[..., S.YAW_RATE] + x[..., S.SLIP_RATE]
    return t * speed + 0.5 * t * t * a, 0.5 * t * t * speed * rate, a


def scan_sigmas(sigma: Array) -> Array:
    """1-sigma of the noises over a scan in the columns of :func:`noise_gain`.  (..., NOISES) -> (..., NOISES + 3)."""
    return np.concatenate([sigma, sigma[..., :3]], -1)
