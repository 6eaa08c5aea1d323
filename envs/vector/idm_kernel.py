"""The Intelligent Driver Model as highway-env has it, for drivers of several manners.

M. Treiber, A. Hennecke, S. Helbing, Phys. Rev. E 62, 1805, 2000; highway-env takes the speed difference along the own
heading, and lets a driver reason about another one by its own figures.
"""

from __future__ import annotations

from typing import NamedTuple

from lanebound.envs.vector.arithmetic_kernel import power
from lanebound.envs.vector.columns_kernel import COS, SIN, SPEED, TARGET_SPEED
from lanebound.integrity.core.accel import jit

__all__ = [
    "ACC_MAX",
    "BRAKING_IMPOSED",
    "SPEED_MOST_MPS",
    "Manners",
    "braking",
    "free",
    "gap_wanted",
    "not_zero",
    "wanted_speed",
]

ACC_MAX, BRAKING_IMPOSED = 6.0, 2.0  # of IDMVehicle, whatever the manners
SPEED_MOST_MPS = 40.0


class Manners(NamedTuple):
    """Figures of a class of drivers.

    gap_m: wanted at standstill, middle to middle; headway_s: time gap; comfort: acceleration [m/s2]; twice_root:
    ``2 sqrt(a b)`` of it and of the deceleration [m/s2]; delay_s: between thoughts of changing lanes; gain: of
    acceleration by which a change is worth it [m/s2].
    """

    gap_m: float
    headway_s: float
    comfort: float
    twice_root: float
    delay_s: float
    gain: float


@jit(inline=True)
def not_zero(x):  # type: ignore[no-untyped-def]
    """x, or 0.01 with its sign when it is smaller."""
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0.0 else -1e-2


@jit
def gap_wanted(c, i, j, manners):  # type: ignore[no-untyped-def]
    """The distance wanted of vehicle i behind j."""
    closing_x = c[SPEED, i] * c[COS, i] - c[SPEED, j] * c[COS, j]
    closing_y = c[SPEED, i] * c[SIN, i] - c[SPEED, j] * c[SIN, j]
    closing = closing_x * c[COS, i] + closing_y * c[SIN, i]
    return manners.gap_m + c[SPEED, i] * manners.headway_s + c[SPEED, i] * closing / manners.twice_root


@jit(inline=True)
def free(speed, wanted, delta, manners):  # type: ignore[no-untyped-def]
    """Acceleration of a driver on an empty road, who wants a speed with an exponent."""
    return manners.comfort * (1.0 - power(max(speed, 0.0) / abs(not_zero(wanted)), delta))


@jit
def wanted_speed(c, i, limit):  # type: ignore[no-untyped-def]
    """Speed that vehicle i goes for under a limit."""
    return min(max(c[TARGET_SPEED, i], 0.0), limit)


@jit
def braking(c, i, j, gap, manners):  # type: ignore[no-untyped-def]
    """What vehicle j, a gap ahead, takes off the acceleration of vehicle i."""
    share = gap_wanted(c, i, j, manners) / not_zero(gap)
    return manners.comfort * share * share
