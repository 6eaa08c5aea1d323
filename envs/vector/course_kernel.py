"""Traffic of the curved roads: a vehicle that keeps its lane and drives a profile of speeds, whoever is behind it."""

from __future__ import annotations

import math

from lanebound.envs.vector.collisions_kernel import LENGTH_M
from lanebound.envs.vector.columns_kernel import COS, CRASHED, HEADING, LANE, SIN, SPEED, TARGET, X, Y
from lanebound.envs.vector.ego_kernel import steering_to
from lanebound.envs.vector.lanes_kernel import nearest
from lanebound.envs.vector.motorway_kernel import SPEED_MOST_MPS, settle
from lanebound.integrity.accel import jit

__all__ = ["drive_leads"]


@jit
def drive_leads(c, w, lanes, profile, step, dt):  # type: ignore[no-untyped-def]
    """Vehicles 1 and up drive to the speed that ``profile`` (S,) [m/s] has for the end of step number ``step``."""
    for i in range(1, c.shape[1]):
        speed = c[SPEED, i]
        if w[CRASHED, i] != 0:
            steering, a = 0.0, -speed
        else:
            steering = steering_to(lanes, w[TARGET, i], c[X, i], c[Y, i], c[HEADING, i], speed)
            a = (profile[min(step, profile.shape[0] - 1)] - speed) / dt
        if speed > SPEED_MOST_MPS:
            a = min(a, SPEED_MOST_MPS - speed)
        slip = math.atan(0.5 * math.tan(steering))
        cosine, sine = math.cos(slip), math.sin(slip)
        dx = speed * (c[COS, i] * cosine - c[SIN, i] * sine) * dt
        dy = speed * (c[SIN, i] * cosine + c[COS, i] * sine) * dt
        settle(c, w, i, dx, dy, c[HEADING, i] + speed * sine / (0.5 * LENGTH_M) * dt, speed + a * dt)
        w[LANE, i] = nearest(lanes, c[X, i], c[Y, i], c[HEADING, i])
