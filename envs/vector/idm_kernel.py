"""The Intelligent Driver Model of highway-env, for the parameters of any class of drivers.

M. Treiber, A. Hennecke, S. Helbing, Phys. Rev. E 62, 1805, 2000; highway-env takes the speed difference along the own
heading, and predicts the acceleration of another driver with the own parameters.
"""

from __future__ import annotations

from lanebound.envs.batch.ego_kernel import not_zero
from lanebound.envs.vector.arithmetic_kernel import power
from lanebound.integrity.core.accel import jit

__all__ = ["ACC_MOST", "BRAKING_IMPOSED", "braking", "braking_of", "free", "gap_wanted", "wanted_speed"]

ACC_MOST, BRAKING_IMPOSED = 6.0, 2.0  # of IDMVehicle [m/s2], whatever the parameters


@jit(inline=True)
def gap_wanted(v, i, j, idm):  # type: ignore[no-untyped-def]
    """The distance wanted of vehicle i behind j."""
    closing_x = v.speed[i] * v.cos[i] - v.speed[j] * v.cos[j]
    closing_y = v.speed[i] * v.sin[i] - v.speed[j] * v.sin[j]
    return _gap_of(v.speed[i], closing_x * v.cos[i] + closing_y * v.sin[i], idm)


@jit(inline=True)
def _gap_of(speed, closing, idm):  # type: ignore[no-untyped-def]
    """The distance wanted, for a speed and the speed at which the gap closes."""
    return idm.gap_m + speed * idm.headway_s + speed * closing / idm.twice_root


@jit(inline=True)
def free(speed, wanted, delta, idm):  # type: ignore[no-untyped-def]
    """Acceleration on an empty road, for a wanted speed and an exponent."""
    return idm.comfort * (1.0 - power(max(speed, 0.0) / abs(not_zero(wanted)), delta))


@jit(inline=True)
def wanted_speed(v, i, limit):  # type: ignore[no-untyped-def]
    """Target speed of vehicle i under a limit."""
    return min(max(v.target_speed[i], 0.0), limit)


@jit(inline=True)
def braking(v, i, j, gap, idm):  # type: ignore[no-untyped-def]
    """Reduction of the acceleration of vehicle i by vehicle j, a gap ahead."""
    return _braking_of(gap_wanted(v, i, j, idm), gap, idm)


@jit(inline=True)
def braking_of(speed, closing, gap, idm):  # type: ignore[no-untyped-def]
    """Reduction of the acceleration for a speed, the speed at which the gap closes, and the gap; 0 for gap inf."""
    return _braking_of(_gap_of(speed, closing, idm), gap, idm)


@jit(inline=True)
def _braking_of(wanted, gap, idm):  # type: ignore[no-untyped-def]
    share = wanted / not_zero(gap)
    return idm.comfort * share * share
