"""Whether the measurements of an epoch are finite: sums of zeros, which a NaN or an infinity makes NaN."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.sensors.arrival_kernel import BANDS

__all__ = ["finite_bands", "finite_records"]


@jit(borrows=True)
def finite_records(signals, vehicles):  # type: ignore[no-untyped-def]
    """Whether signals (B, S) of OBSERVED_SIGNAL and vehicles (B,) of OBSERVED_VEHICLE hold finite values alone, and no
    NaN as age."""
    total = 0.0
    for v in range(vehicles.shape[0]):
        vehicle = vehicles[v]
        if math.isnan(vehicle.age):
            return False
        total += 0.0 * vehicle.speed + 0.0 * vehicle.distance
        for k in range(3):
            total += 0.0 * vehicle.turn[k] + 0.0 * vehicle.delta_v[k]
        for s in range(signals.shape[1]):
            signal = signals[v, s]
            total += 0.0 * signal.cn0 + 0.0 * signal.range_rate
            total += 0.0 * signal.e[0] + 0.0 * signal.e[1] + 0.0 * signal.e[2]
            for b in range(BANDS):
                total += 0.0 * signal.code[b] + 0.0 * signal.phase[b]
    return total == 0.0


@jit
def finite_bands(code, phase):  # type: ignore[no-untyped-def]
    """Whether code and phase (B, S, 2) hold finite values alone."""
    total = 0.0
    for i in range(code.shape[0]):
        for j in range(code.shape[1]):
            for k in range(code.shape[2]):
                total += 0.0 * code[i, j, k] + 0.0 * phase[i, j, k]
    return total == 0.0
