"""The start of an episode in compiled traffic.

:func:`clear_rows` empties the places of vehicles, the starter of the world fills them, and :func:`seat_rows` puts the
other drivers on their lines and completes the records. :func:`line_up` is the starter of a motorway: highway-env's
draws in highway-env's order, so that a seed gives the same traffic.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.batch.records_kernel import cars_of
from lanebound.envs.vector.drivers_kernel import clear, drivers_of, seat
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.bundle_kernel import unbundle
from lanebound.integrity.core.streams_kernel import fill

__all__ = ["clear_rows", "line_up", "seat_rows"]

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


@jit(borrows=True)
def clear_rows(rows, batch, traffic, length, width):  # type: ignore[no-untyped-def]
    """Empty the places of all vehicles of the environments ``rows``; places are for vehicles of one size."""
    a, t = unbundle(batch), unbundle(traffic)
    for e in rows:
        clear(cars_of(a.cars, e), drivers_of(t.drivers, e), length, width)


@jit
def seat_rows(rows, batch, traffic, states, table):  # type: ignore[no-untyped-def]
    """Put the others of the environments ``rows`` on their lines, and complete the records from the poses.

    states (n, 4): generators of the stream ``wander`` of the episodes, None where no driver leaves the middle of its
    lane; table: of normal draws, see :func:`~lanebound.integrity.core.streams_kernel.fill`.
    """
    a, t = unbundle(batch), unbundle(traffic)
    drawn = np.empty(t.wander.shape[1] * a.cars.x.shape[1])
    for n in range(rows.shape[0]):
        car, drv = cars_of(a.cars, rows[n]), drivers_of(t.drivers, rows[n])
        if states is not None:
            _spread(car, drv, t.wander[0], states[n], table, drawn)
        seat(car, drv, car.present)


@jit(inline=True)
def _spread(car, drv, shape, state, table, drawn):  # type: ignore[no-untyped-def]
    """Draw the weights of the others in the order of their places, and put them on their lines.

    The sum is taken in the order of :func:`.drivers_kernel.wander_all`; shape (K,): the first row of the shapes.
    """
    kinds = shape.shape[0]
    fill(state, table, drawn[: kinds * (car.present - 1)])
    for i in range(1, car.present):
        line = 0.0
        for k in range(kinds):
            drv.wander[k, i] = drawn[kinds * (i - 1) + k]
            line += shape[k] * drv.wander[k, i]
        drv.aside[i] = min(max(line, -WANDER_MOST_M), WANDER_MOST_M)
        car.x[i] -= math.sin(car.heading[i]) * drv.aside[i]
        car.y[i] += math.cos(car.heading[i]) * drv.aside[i]
