"""Records of one environment's vehicles, for tests of kernels that take them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.batch.records_kernel import Cars
from lanebound.envs.vector.drivers_kernel import Drivers

__all__ = ["cars_at", "empty_rows", "record_of"]


def record_of(kind: Any, **values: float) -> Any:
    """One record of a kind, of zeros but for some values."""
    out = np.zeros(1, kind)
    for name, value in values.items():
        out[name] = value
    return out[0]


def empty_rows(places: int, present: int) -> tuple[Cars, Drivers]:
    """Vehicles at rest at the origin in each of so many places, of which the first ``present`` are taken."""
    return _cars(places, present), Drivers(*[*_columns(places, 9, 5), np.zeros((1, places))])


def cars_at(
    position_m: Any, heading_rad: Any = 0.0, speed_mps: Any = 0.0, size_m: tuple[float, float] = (5.0, 2.0)
) -> Cars:
    """Vehicles at positions (V, 2), the ego first, in slots 0, 1, ..."""
    x, y = np.asarray(position_m, dtype=np.float64).T
    car = _cars(x.size, x.size)
    car.x[:], car.y[:], car.heading[:], car.speed[:] = x, y, heading_rad, speed_mps
    car.length[:], car.width[:] = size_m
    car.slot[:] = np.arange(x.size) - 1
    return car


def _cars(places: int, present: int) -> Cars:
    return Cars(present, *_columns(places, 6, 3), np.full(places, -1))  # type: ignore[arg-type]


def _columns(places: int, numbers: int, wholes: int) -> list[Any]:
    return [np.zeros(places) for _ in range(numbers)] + [np.zeros(places, dtype=np.int64) for _ in range(wholes)]
