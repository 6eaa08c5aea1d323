"""Crashes of boxes are highway-env's."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.collisions_kernel import LENGTH_M, WIDTH_M, collide_all

DT_S = 0.05


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
        cars, whole = np.zeros((k.CAR, 9)), np.zeros((k.WHOLE, 9), dtype=np.int64)
        for i, v in enumerate(road.vehicles):
            cars[[k.X, k.Y, k.HEADING, k.SPEED], i] = *v.position, v.heading, v.speed
        cars[k.COS], cars[k.SIN] = np.cos(cars[k.HEADING]), np.sin(cars[k.HEADING])
        whole[k.ORDER], whole[k.PRESENT] = np.argsort(cars[k.X]), 1
        collide_all(cars, whole, in_order, DT_S, np.empty(60, dtype=np.int64))
        for i, vehicle in enumerate(road.vehicles):
            for other in road.vehicles[i + 1 :]:
                vehicle.handle_collisions(other, DT_S)
        for i, v in enumerate(road.vehicles):
            assert bool(whole[k.CRASHED, i]) == v.crashed
            assert bool(whole[k.STRUCK, i]) == (v.impact is not None)
            if v.impact is not None:
                np.testing.assert_allclose(cars[[k.IMPACT_X, k.IMPACT_Y], i], v.impact, atol=1e-9)
        thrown, crashed = thrown + int(whole[k.STRUCK].sum()), crashed + int(whole[k.CRASHED].sum())
    assert thrown > crashed > 20
    assert (LENGTH_M, WIDTH_M) == (Vehicle.LENGTH, Vehicle.WIDTH)
