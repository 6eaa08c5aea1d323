"""Records of one environment's vehicles, for tests of kernels that take them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.records_kernel import CAR
from lanebound.envs.vector.drivers_kernel import DRIVER, NUMBERS, WHOLES, Vehicles, load, vehicles_in
from lanebound.integrity.core.records import Records

__all__ = ["cars_at", "driving", "empty_rows", "record_of"]


def record_of(kind: Any, **values: float) -> Any:
    """One record of a kind, of zeros but for some values."""
    out = np.zeros(1, kind)
    for name, value in values.items():
        out[name] = value
    return out[0]


def empty_rows(present: int) -> tuple[Records, Records]:
    """So many vehicles at rest at the origin: (V,) CAR and DRIVER."""
    return np.zeros(present, CAR), np.zeros(present, DRIVER)


def driving(cars: Records, drivers: Records) -> Vehicles:
    """The vehicles as kernels of traffic take them."""
    numbers, wholes = np.zeros((NUMBERS, len(cars))), np.zeros((WHOLES, len(cars)), dtype=np.int64)
    found: Vehicles = vehicles_in.py_func(numbers, wholes, len(cars))
    load(cars, drivers, found)
    return found


def cars_at(
    position_m: Any, heading_rad: Any = 0.0, speed_mps: Any = 0.0, size_m: tuple[float, float] = (5.0, 2.0)
) -> Records:
    """Vehicles (V,) CAR at positions (V, 2), the ego first, in slots 0, 1, ..."""
    x, y = np.asarray(position_m, dtype=np.float64).T
    cars = np.zeros(x.size, CAR)
    cars["x"], cars["y"], cars["heading"], cars["speed"] = x, y, heading_rad, speed_mps
    cars["length"], cars["width"] = size_m
    cars["slot"], cars["onward"] = np.arange(x.size) - 1, NONE
    return cars
