"""The start of an episode on a motorway: highway-env's draws in highway-env's order, so that seeds mean the same."""

from __future__ import annotations

import math

from lanebound.envs.vector.columns_kernel import (
    COS,
    DELTA,
    HEADING,
    LANE,
    ORDER,
    PRESENT,
    SIN,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    X,
    Y,
)
from lanebound.envs.vector.lanes_kernel import LIMIT, OFFSET
from lanebound.integrity.core.accel import jit

__all__ = ["line_up"]

EGO_MPS, PLACE_M = 25.0, 12.0  # of HighwayEnv and Vehicle.create_random
DELTA_LOW, DELTA_HIGH = 3.5, 4.5  # IDMVehicle.DELTA_RANGE


@jit
def line_up(rng, c, w, table, ego_lane, ego_spacing, spacing):  # type: ignore[no-untyped-def]
    """Vehicles of one environment, each ahead of those before; ``ego_lane`` -1 draws the ego's lane as well."""
    lanes = table.shape[0]
    packed = math.exp(-5.0 / 40.0 * lanes)
    c[:, :] = 0.0
    w[:, :] = 0
    for i in range(c.shape[1]):
        lane = ego_lane if i == 0 and ego_lane >= 0 else rng.integers(0, lanes)
        speed = EGO_MPS if i == 0 else rng.uniform(0.7 * table[lane, LIMIT], 0.8 * table[lane, LIMIT])
        gap = (ego_spacing if i == 0 else spacing) * (PLACE_M + speed) * packed
        x = 3.0 * gap if i == 0 else c[X, i - 1]
        x += gap * rng.uniform(0.9, 1.1)
        c[X, i], c[Y, i], c[SPEED, i], c[TARGET_SPEED, i] = x, table[lane, OFFSET], speed, speed
        c[HEADING, i], c[SIN, i], c[COS, i] = 0.0, 0.0, 1.0
        c[TIMER, i] = (x + table[lane, OFFSET]) * math.pi % 1.0
        if i > 0:
            c[DELTA, i] = rng.uniform(DELTA_LOW, DELTA_HIGH)
        w[LANE, i] = w[TARGET, i] = lane
        w[ORDER, i], w[PRESENT, i] = i, 1
