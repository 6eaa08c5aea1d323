"""The start of an episode in compiled traffic.

:func:`clear_rows` empties the places of vehicles, the starter of the world fills them, and :func:`seat_rows` puts the
other drivers on their lines and completes the records. :func:`line_up` is the starter of a motorway: highway-env's
draws in highway-env's order, so that a seed gives the same traffic.
"""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.vector.drivers_kernel import clear, fill_onward, seat
from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.streams_kernel import fill

__all__ = ["clear_rows", "line_up", "seat_rows"]

EGO_MPS, PLACE_M = 25.0, 12.0  # of HighwayEnv and Vehicle.create_random
DELTA_LOW, DELTA_HIGH = 3.5, 4.5  # IDMVehicle.DELTA_RANGE


@jit
def line_up(rng, cars, drivers, table, ego_lane, ego_spacing, spacing):  # type: ignore[no-untyped-def]
    """Vehicles of one environment, each ahead of those before; ``ego_lane`` -1 draws the ego's lane as well."""
    lanes = table.shape[0]
    packed = math.exp(-5.0 / 40.0 * lanes)
    for i in range(cars.shape[0]):
        lane = ego_lane if i == 0 and ego_lane >= 0 else rng.integers(0, lanes)
        limit = table[lane].speed_limit_mps
        speed = EGO_MPS if i == 0 else rng.uniform(0.7 * limit, 0.8 * limit)
        gap = (ego_spacing if i == 0 else spacing) * (PLACE_M + speed) * packed
        x = 3.0 * gap if i == 0 else cars[i - 1].x
        x += gap * rng.uniform(0.9, 1.1)
        cars[i].x, cars[i].y, cars[i].speed, drivers[i].target_speed = x, table[lane].y_m, speed, speed
        drivers[i].timer = (x + table[lane].y_m) * math.pi % 1.0
        if i > 0:
            drivers[i].delta = rng.uniform(DELTA_LOW, DELTA_HIGH)
        cars[i].lane = drivers[i].target = lane


@jit(borrows=True)
def clear_rows(rows, cars, drivers, length, width):  # type: ignore[no-untyped-def]
    """Empty the places of all vehicles of the environments ``rows``; places are for vehicles of one size."""
    for e in rows:
        clear(cars[e], drivers[e], length, width)


@jit
def seat_rows(rows, cars, drivers, egos, shapes, states, table, lanes, routes):  # type: ignore[no-untyped-def]
    """Put the others of the environments ``rows`` on their lines, and complete the records from poses and routes.

    shapes (S, K): of lines over time, by simulation step; states (n, 4): generators of the stream ``wander`` of the
    episodes, None where no driver leaves the middle of its lane; table: of normal draws, see
    :func:`~lanebound.integrity.core.streams_kernel.fill`.
    """
    drawn = np.empty(shapes.shape[1] * cars.shape[1])
    for n in range(rows.shape[0]):
        e = rows[n]
        if states is not None:
            _spread(cars[e, : egos[e].vehicles], drivers[e], shapes[0], states[n], table, drawn)
        ego = egos[e]
        ego.placed, ego.place, ego.route = cars[e, 0].lane, drivers[e, 0].order, drivers[e, 0].route
        seat(cars[e], drivers[e], ego.vehicles)
        fill_onward(cars[e, : ego.vehicles], drivers[e], ego, lanes, routes)


@jit(inline=True)
def _spread(cars, drivers, shape, state, table, drawn):  # type: ignore[no-untyped-def]
    """Draw the weights of the others in the order of their places, and put them on their lines.

    The sum is taken in the order of :func:`.drivers_kernel.wander_all`; shape (K,): the first row of the shapes.
    """
    kinds = shape.shape[0]
    fill(state, table, drawn[: kinds * (cars.shape[0] - 1)])
    for i in range(1, cars.shape[0]):
        car, driver, line = cars[i], drivers[i], 0.0
        for k in range(kinds):
            driver.wander[k] = drawn[kinds * (i - 1) + k]
            line += shape[k] * driver.wander[k]
        driver.aside = min(max(line, -WANDER_MOST_M), WANDER_MOST_M)
        car.x -= math.sin(car.heading) * driver.aside
        car.y += math.cos(car.heading) * driver.aside
