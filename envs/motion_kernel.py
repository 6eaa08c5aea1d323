"""True motion from poses, compiled: see :mod:`.motion` for the rule of velocities."""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.motion.truth_kernel import EndRows, TrueMotion, between

__all__ = ["advance", "epoch"]


@jit
def advance(rows, xy, heading, position_m, heading_rad, chord, chord_before):  # type: ignore[no-untyped-def]
    """Take the poses ``xy`` (n, 2) and ``heading`` (n,) of the slots ``rows`` after a simulation step."""
    for i in range(rows.shape[0]):
        b = rows[i]
        for k in range(2):
            chord_before[b, k] = chord[b, k]
            chord[b, k] = xy[i, k] - position_m[b, k]
            position_m[b, k] = xy[i, k]
        heading_rad[b] = heading[i]


@jit
def epoch(  # type: ignore[no-untyped-def]
    step, down, position_m, heading_rad, chord, chord_before, start_m, start_mps, start_rad,
    position, velocity, heading, turn, delta_v, distance,
):  # fmt: skip
    """Fill the arrays of a Truth from the last mark to now, and set the mark here.

    x, y and heading are the plane's, E = x, N = -y, azimuth = heading + pi / 2; ``down`` as in :func:`between`.
    """
    count = heading_rad.shape[0]
    p0, p1, v0, v1 = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    h0, h1 = np.empty(count), np.empty(count)
    for b in range(count):
        for k in range(2):
            sign = 1.0 if k == 0 else -1.0
            now = (1.5 * chord[b, k] - 0.5 * chord_before[b, k]) / step
            p0[b, k], p1[b, k] = sign * start_m[b, k], sign * position_m[b, k]
            v0[b, k], v1[b, k] = sign * start_mps[b, k], sign * now
            start_m[b, k], start_mps[b, k] = position_m[b, k], now
        h0[b], h1[b] = start_rad[b] + 0.5 * math.pi, heading_rad[b] + 0.5 * math.pi
        start_rad[b] = heading_rad[b]
    out = TrueMotion(position, velocity, heading, turn, delta_v, distance)
    between(EndRows(p0, v0, h0), EndRows(p1, v1, h1), down, out)
