"""Numba kernel: the sky between two knots of a track."""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.accel import jit

__all__ = ["sky_at"]

TWO_PI = 2.0 * math.pi


@jit
def sky_at(offset0, offset1, rate0, rate1, step, u, mask):  # type: ignore[no-untyped-def]
    """Cubic Hermite interpolation of S relative vectors, and what follows from it.

    offset0, offset1 (S, 3) [m] and rate0, rate1 (S, 3) [m/s] at the knots; step [s] between them; u in [0, 1] the
    place between them; mask [rad]. Returns los (S, 3), elevation, azimuth, range, range rate and above, each (S,).
    """
    s_count = offset0.shape[0]
    los = np.empty((s_count, 3))
    out = np.empty((4, s_count))
    above = np.empty(s_count, dtype=np.bool_)
    a1 = u * u * (3.0 - 2.0 * u)
    a0 = 1.0 - a1
    b0, b1 = step * u * (1.0 - u) * (1.0 - u), step * u * u * (u - 1.0)
    da = 6.0 * u * (1.0 - u) / step
    db0, db1 = (1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)
    for s in range(s_count):
        square, along = 0.0, 0.0
        for i in range(3):
            x = a0 * offset0[s, i] + a1 * offset1[s, i] + b0 * rate0[s, i] + b1 * rate1[s, i]
            v = da * (offset1[s, i] - offset0[s, i]) + db0 * rate0[s, i] + db1 * rate1[s, i]
            los[s, i] = x
            square += x * x
            along += x * v
        distance = math.sqrt(square)
        for i in range(3):
            los[s, i] /= distance
        elevation = math.asin(min(1.0, max(-1.0, los[s, 2])))
        azimuth = math.atan2(los[s, 0], los[s, 1])
        out[0, s] = elevation
        out[1, s] = azimuth if azimuth >= 0.0 else azimuth + TWO_PI
        out[2, s] = distance
        out[3, s] = along / distance
        above[s] = elevation > mask
    return los, out, above
