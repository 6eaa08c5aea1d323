"""Traffic of the curved roads: vehicles that keep their lane and drive a profile of speeds, whatever is behind them."""

from __future__ import annotations

from lanebound.envs.vector.drivers_kernel import SPEED_MOST_MPS, roll, steer_along
from lanebound.integrity.core.accel import jit

__all__ = ["drive_profiles", "lead"]


@jit(inline=True)
def drive_profiles(v, lanes, profile, step, dt):  # type: ignore[no-untyped-def]
    """Vehicles 1 and up drive to the speeds that ``profile`` (K, S) [m/s] has for the end of step number ``step``.

    Vehicle 1 has the first row; those beyond the last row have that one.
    """
    for i in range(1, v.x.shape[0]):
        steering, a = 0.0, 0.0
        if v.crashed[i] == 0:
            steering = steer_along(v, lanes, i)
            row = profile[min(i, profile.shape[0]) - 1]
            a = (row[min(step, row.shape[0] - 1)] - v.speed[i]) / dt
        roll(v, i, steering, a, -SPEED_MOST_MPS, SPEED_MOST_MPS, lanes, dt)


@jit(inline=True)
def lead(v, count, profile, step, dt):  # type: ignore[no-untyped-def]
    """The accelerations to the speeds of ``profile`` (K, S) of the first K others, where there are profiles."""
    for i in range(1, min(profile.shape[0] + 1, count) if profile.shape[1] > 1 else 1):
        v.acceleration[i] = (profile[i - 1, min(step, profile.shape[1] - 1)] - v.speed[i]) / dt
