"""Numba kernels that compute the true motion of an epoch from the poses at its start and end."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import remainder

__all__ = ["EndRows", "TrueMotion", "all_finite", "between"]

Array = NDArray[np.float64]


class EndRows(NamedTuple):
    """B vehicles at one end of an epoch: position, velocity (B, 2) East, North; heading (B,) azimuth."""

    position: Array
    velocity: Array
    heading: Array


class TrueMotion(NamedTuple):
    """Arrays of a :class:`~lanebound.integrity.motion.truth.Truth`: (B, 3), heading and distance (B,)."""

    position: Array
    velocity: Array
    heading: Array
    turn: Array
    delta_v: Array
    distance: Array


@jit(borrows=True)
def between(start, end, down, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` (TrueMotion) from both ends (EndRows) of an epoch; ``down`` [m/s] is what gravity adds.

    ``turn`` and ``delta_v`` are in body axes, forward, right, down, of the middle of the epoch.
    """
    for b in range(end.heading.shape[0]):
        h0, p0, p1, v0, v1 = start.heading[b], start.position, end.position, start.velocity, end.velocity
        turned = remainder(end.heading[b] - h0)
        s, c = math.sin(h0 + 0.5 * turned), math.cos(h0 + 0.5 * turned)
        de, dn = p1[b, 0] - p0[b, 0], p1[b, 1] - p0[b, 1]
        we, wn = v1[b, 0] - v0[b, 0], v1[b, 1] - v0[b, 1]
        for k in range(2):
            out.position[b, k], out.velocity[b, k] = p1[b, k], v1[b, k]
        out.position[b, 2] = out.velocity[b, 2] = out.turn[b, 0] = out.turn[b, 1] = 0.0
        out.heading[b] = remainder(end.heading[b])
        out.turn[b, 2] = turned
        out.delta_v[b, 0], out.delta_v[b, 1], out.delta_v[b, 2] = s * we + c * wn, c * we - s * wn, down
        out.distance[b] = math.copysign(math.hypot(de, dn), s * de + c * dn)


@jit
def all_finite(position, velocity, heading, arc):  # type: ignore[no-untyped-def]
    """Whether all entries of (B, 3), (B, 3), (B,) and (B,) are finite."""
    for b in range(heading.shape[0]):
        total = heading[b] + arc[b]
        for k in range(3):
            total += position[b, k] + velocity[b, k]
        if not math.isfinite(total):  # a sum with an infinity or NaN is not finite
            return False
    return True
