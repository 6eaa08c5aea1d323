"""The Intelligent Driver Model as highway-env has it, with the parameters of several classes of drivers.

M. Treiber, A. Hennecke, S. Helbing, Phys. Rev. E 62, 1805, 2000; highway-env takes the speed difference along the own
heading, and lets a driver reason about another one by its own parameters.
"""

from __future__ import annotations

from typing import NamedTuple

from lanebound.envs.batch.ego_kernel import not_zero
from lanebound.envs.vector.arithmetic_kernel import power
from lanebound.integrity.core.accel import jit

__all__ = ["ACC_MOST", "BRAKING_IMPOSED", "IdmParameters", "braking", "free", "gap_wanted", "wanted_speed"]

ACC_MOST, BRAKING_IMPOSED = 6.0, 2.0  # of IDMVehicle [m/s2], whatever the parameters


class IdmParameters(NamedTuple):
    """Parameters of a class of drivers.

    gap_m: wanted at standstill, middle to middle; headway_s: time gap; comfort: acceleration [m/s2]; twice_root:
    ``2 sqrt(a b)`` of it and of the deceleration [m/s2]; delay_s: between considerations of a lane change; gain: of
    acceleration by which a change is worth it [m/s2].
    """

    gap_m: float
    headway_s: float
    comfort: float
    twice_root: float
    delay_s: float
    gain: float


@jit(inline=True)
def gap_wanted(car, drv, i, j, idm):  # type: ignore[no-untyped-def]
    """The distance wanted of vehicle i behind j."""
    closing_x = car.speed[i] * drv.cos[i] - car.speed[j] * drv.cos[j]
    closing_y = car.speed[i] * drv.sin[i] - car.speed[j] * drv.sin[j]
    closing = closing_x * drv.cos[i] + closing_y * drv.sin[i]
    return idm.gap_m + car.speed[i] * idm.headway_s + car.speed[i] * closing / idm.twice_root


@jit(inline=True)
def free(speed, wanted, delta, idm):  # type: ignore[no-untyped-def]
    """Acceleration on an empty road, for a wanted speed and an exponent."""
    return idm.comfort * (1.0 - power(max(speed, 0.0) / abs(not_zero(wanted)), delta))


@jit(inline=True)
def wanted_speed(drv, i, limit):  # type: ignore[no-untyped-def]
    """Speed that vehicle i goes for under a limit."""
    return min(max(drv.target_speed[i], 0.0), limit)


@jit(inline=True)
def braking(car, drv, i, j, gap, idm):  # type: ignore[no-untyped-def]
    """What vehicle j, a gap ahead, takes off the acceleration of vehicle i."""
    share = gap_wanted(car, drv, i, j, idm) / not_zero(gap)
    return idm.comfort * share * share
