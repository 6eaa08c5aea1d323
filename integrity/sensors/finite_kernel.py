"""Whether the measurements of an epoch are finite: sums of zeros, which a NaN or an infinity makes NaN."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit

__all__ = ["finite_bands", "finite_signals"]


@jit(borrows=True)
def finite_signals(los, cn0, code, phase, rate, age, turn, delta_v, speed, distance):  # type: ignore[no-untyped-def]
    """Whether los (N, S, 3), cn0 and rate (B, S), code and phase (B, S, 2), turn and delta_v (B, 3), speed and
    distance (B,) hold finite values alone, and age (B,) no NaN."""
    total = 0.0
    for x in (cn0, rate, turn, delta_v):
        for i in range(x.shape[0]):
            for j in range(x.shape[1]):
                total += 0.0 * x[i, j]
    for y in (los, code, phase):
        for i in range(y.shape[0]):
            for j in range(y.shape[1]):
                for k in range(y.shape[2]):
                    total += 0.0 * y[i, j, k]
    for i in range(speed.shape[0]):
        total += 0.0 * speed[i] + 0.0 * distance[i]
        if age[i] != age[i]:
            return False
    return total == 0.0


@jit(borrows=True)
def finite_bands(code, phase):  # type: ignore[no-untyped-def]
    """Whether code and phase (B, S, 2) hold finite values alone."""
    total = 0.0
    for i in range(code.shape[0]):
        for j in range(code.shape[1]):
            for k in range(code.shape[2]):
                total += 0.0 * code[i, j, k] + 0.0 * phase[i, j, k]
    return total == 0.0
