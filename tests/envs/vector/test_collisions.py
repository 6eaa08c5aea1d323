"""Crashes of boxes are highway-env's."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.vector.collisions_kernel import collide_all, collide_sorted
from lanebound.envs.vector.drivers_kernel import clear, seat, store
from lanebound.integrity.core.accel import jit
from vehicles import driving, empty_rows

DT_S = 0.05


@jit
def _all(v):  # type: ignore[no-untyped-def]
    collide_all(v, v.x.size, 0, DT_S)


@jit
def _sorted(v, pairs):  # type: ignore[no-untyped-def]
    collide_sorted(v, DT_S, pairs)


def _crowd(seed: int, count: int) -> Road:
    """Vehicles so close that many of them overlap or are about to."""
    rng = np.random.default_rng(seed)
    road = Road(RoadNetwork.straight_road_network(4))
    for _ in range(count):
        place = rng.uniform([100.0, -2.0], [100.0 + 5.0 * count, 14.0])
        road.vehicles.append(Vehicle(road, place, float(rng.normal(0.0, 0.4)), float(rng.uniform(-5.0, 39.0))))
    return road


@pytest.mark.parametrize("in_order", [True, False])
def test_who_crashes_and_where_to_is_the_same(in_order: bool) -> None:
    thrown = crashed = 0
    for seed in range(12):
        road = _crowd(seed, 9)
        car, drv = empty_rows(len(road.vehicles))
        clear(car, drv, Vehicle.LENGTH, Vehicle.WIDTH)
        for i, v in enumerate(road.vehicles):
            (car["x"][i], car["y"][i]), car["heading"][i], car["speed"][i] = v.position, v.heading, v.speed
        seat(car, drv, 9)
        drv["order"][:] = np.argsort(car["x"])
        driven = driving(car, drv)
        if in_order:
            _sorted(driven, np.empty(60, dtype=np.int64))
        else:
            _all(driven)
        store(driven, car, drv)
        for i, vehicle in enumerate(road.vehicles):
            for other in road.vehicles[i + 1 :]:
                vehicle.handle_collisions(other, DT_S)
        for i, v in enumerate(road.vehicles):
            assert bool(car["crashed"][i]) == v.crashed
            assert bool(drv["struck"][i]) == (v.impact is not None)
            if v.impact is not None:
                np.testing.assert_allclose([drv["impact_x"][i], drv["impact_y"][i]], v.impact, atol=1e-9)
        thrown, crashed = thrown + int(drv["struck"].sum()), crashed + int(car["crashed"].sum())
    assert thrown > crashed > 20
