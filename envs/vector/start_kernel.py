"""The start of an episode on a motorway: highway-env's draws in highway-env's order, so that seeds mean the same."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

__all__ = ["line_up"]

EGO_MPS, PLACE_M = 25.0, 12.0  # of HighwayEnv and Vehicle.create_random
DELTA_LOW, DELTA_HIGH = 3.5, 4.5  # IDMVehicle.DELTA_RANGE


@jit
def line_up(rng, car, drv, table, ego_lane, ego_spacing, spacing):  # type: ignore[no-untyped-def]
    """Vehicles of one environment, each ahead of those before; ``ego_lane`` -1 draws the ego's lane as well."""
    lanes = table.shape[0]
    packed = math.exp(-5.0 / 40.0 * lanes)
    for i in range(car.x.shape[0]):
        lane = ego_lane if i == 0 and ego_lane >= 0 else rng.integers(0, lanes)
        limit = table[lane].speed_limit_mps
        speed = EGO_MPS if i == 0 else rng.uniform(0.7 * limit, 0.8 * limit)
        gap = (ego_spacing if i == 0 else spacing) * (PLACE_M + speed) * packed
        x = 3.0 * gap if i == 0 else car.x[i - 1]
        x += gap * rng.uniform(0.9, 1.1)
        car.x[i], car.y[i], car.speed[i], drv.target_speed[i] = x, table[lane].y_m, speed, speed
        drv.timer[i] = (x + table[lane].y_m) * math.pi % 1.0
        if i > 0:
            drv.delta[i] = rng.uniform(DELTA_LOW, DELTA_HIGH)
        car.lane[i] = drv.target[i] = lane
