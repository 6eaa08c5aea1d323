"""A vehicle at the start of an episode, as highway-env makes it, in the records of the vector engine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.road.lane import AbstractLane
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.integrity.core.records import Records

__all__ = ["close_up", "put", "put_on_lane"]


def put(
    car: Any, driver: Any, table: LaneTable, position: NDArray[np.float64], heading: float, speed: float,
    target: float | None = None, exponent: float = 4.0, delay_s: float = 1.0,
) -> None:  # fmt: skip
    """Fill CAR and DRIVER of a vehicle, whose lane is the nearest one.

    target : speed that it wants, its own by default
    exponent, delay_s : of ``IDMVehicle``: of its acceleration, and between decisions on lane changes
    """
    from lanebound.envs.batch.lanes_kernel import nearest

    x, y = position.tolist()
    car["x"], car["y"], car["heading"], car["speed"] = x, y, heading, speed
    car["lane"] = driver["target"] = nearest(table.lanes, x, y, float(heading))
    driver["target_speed"], driver["delta"] = speed if target is None else target, exponent
    driver["timer"] = (np.sum([x, y]) * np.pi) % delay_s


def put_on_lane(
    car: Any, driver: Any, table: LaneTable, lane: AbstractLane, along_m: float, speed: float, *rest: float
) -> None:
    """:func:`put` in the middle of a lane."""
    put(car, driver, table, lane.position(along_m, 0.0), float(lane.heading_at(along_m)), speed, *rest)


def close_up(cars: Records, drivers: Records, keep: NDArray[np.bool_]) -> int:
    """Let vehicles (V,) leave: the others move up, and the places behind them become empty.  -> their number"""
    from lanebound.envs.vector.drivers_kernel import clear

    count, length, width = int(keep.sum()), cars["length"][0], cars["width"][0]
    cars[:count], drivers[:count] = cars[: keep.size][keep], drivers[: keep.size][keep]
    clear(cars[count : keep.size], drivers[count : keep.size], length, width)
    return count
