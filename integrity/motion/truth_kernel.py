"""Numba kernels that compute the true motion of an epoch from the poses at its start and end."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit


@jit
def wrap(angle):  # type: ignore[no-untyped-def]
    """Wrap an angle [rad] to [-pi, pi); rounding can give pi."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@jit
def between(p0, p1, v0, v1, h0, h1, down, position, velocity, heading, turn, delta_v, distance):  # type: ignore[no-untyped-def]
    """Write the arrays of a Truth: p, v (B, 2) East, North; h (B,) azimuths; ``down`` [m/s] downward part of delta_v.

    ``turn`` (B, 3) and ``delta_v`` (B, 3) are in the body axes (forward, right, down) at the middle of the epoch.
    """
    for b in range(h1.shape[0]):
        turned = wrap(h1[b] - h0[b])
        s, c = math.sin(h0[b] + 0.5 * turned), math.cos(h0[b] + 0.5 * turned)
        de, dn = p1[b, 0] - p0[b, 0], p1[b, 1] - p0[b, 1]
        we, wn = v1[b, 0] - v0[b, 0], v1[b, 1] - v0[b, 1]
        for k in range(2):
            position[b, k], velocity[b, k] = p1[b, k], v1[b, k]
        position[b, 2] = velocity[b, 2] = turn[b, 0] = turn[b, 1] = 0.0
        heading[b] = wrap(h1[b])
        turn[b, 2] = turned
        delta_v[b, 0], delta_v[b, 1], delta_v[b, 2] = s * we + c * wn, c * we - s * wn, down
        distance[b] = math.copysign(math.hypot(de, dn), s * de + c * dn)


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
