"""Numba kernel that interpolates the sky between two knots of a track."""

from __future__ import annotations

import math

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import TWO_PI

__all__ = ["sky_at"]


@jit
def sky_at(offset, rate, k, step, u, mask):  # type: ignore[no-untyped-def]
    """Cubic Hermite interpolation of S relative vectors, and the angles and ranges derived from it.

    offset (N, S, 3) [m] and rate (N, S, 3) [m/s] at the knots; k index of the knot before the epoch; u in [0, 1] time
    since that knot over ``step`` [s]; mask [rad]. Returns los (1, S, 3), (4, 1, S) elevation [rad], azimuth [rad],
    range [m] and range rate [m/s], above (1, S).
    """
    s_count = offset.shape[1]
    los = np.empty((1, s_count, 3))
    out = np.empty((4, 1, s_count))
    above = np.empty((1, s_count), dtype=np.bool_)
    a1 = u * u * (3.0 - 2.0 * u)
    a0 = 1.0 - a1
    b0, b1 = step * u * (1.0 - u) * (1.0 - u), step * u * u * (u - 1.0)
    da = 6.0 * u * (1.0 - u) / step
    db0, db1 = (1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)
    for s in range(s_count):
        square, along = 0.0, 0.0
        for i in range(3):
            x = a0 * offset[k, s, i] + a1 * offset[k + 1, s, i] + b0 * rate[k, s, i] + b1 * rate[k + 1, s, i]
            v = da * (offset[k + 1, s, i] - offset[k, s, i]) + db0 * rate[k, s, i] + db1 * rate[k + 1, s, i]
            los[0, s, i] = x
            square += x * x
            along += x * v
        distance = math.sqrt(square)
        for i in range(3):
            los[0, s, i] /= distance
        elevation = math.asin(min(1.0, max(-1.0, los[0, s, 2])))
        azimuth = math.atan2(los[0, s, 0], los[0, s, 1])
        out[0, 0, s] = elevation
        out[1, 0, s] = azimuth if azimuth >= 0.0 else azimuth + TWO_PI
        out[2, 0, s] = distance
        out[3, 0, s] = along / distance
        above[0, s] = elevation > mask
    return los, out, above
