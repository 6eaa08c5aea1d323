"""Traffic of the curved roads: a vehicle that keeps its lane and drives a profile of speeds, whoever is behind it."""

from __future__ import annotations

from lanebound.envs.vector.columns_kernel import CRASHED, HEADING, SPEED, TARGET, X, Y
from lanebound.envs.vector.ego_kernel import roll, steering_to
from lanebound.envs.vector.idm_kernel import SPEED_MOST_MPS
from lanebound.integrity.core.accel import jit

__all__ = ["drive_leads"]


@jit
def drive_leads(c, w, lanes, profile, step, dt):  # type: ignore[no-untyped-def]
    """Vehicles 1 and up drive to the speed that ``profile`` (S,) [m/s] has for the end of step number ``step``."""
    for i in range(1, c.shape[1]):
        speed, steering, a = c[SPEED, i], 0.0, 0.0
        if w[CRASHED, i] == 0:
            steering = steering_to(lanes, w[TARGET, i], c[X, i], c[Y, i], c[HEADING, i], speed)
            a = (profile[min(step, profile.shape[0] - 1)] - speed) / dt
        roll(c, w, i, steering, a, -SPEED_MOST_MPS, SPEED_MOST_MPS, lanes, dt)
