"""Speed profiles and drivers."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.objects import Landmark

from lanebound.envs import wrap
from lanebound.envs.worlds.drivers import CityDriver, IntersectionDriver, LeadVehicle, SpeedProfileConfig, speed_profile
from lanebound.envs.worlds.networks import city_loop, long_road
from lanebound.envs.worlds.roads import StreetRoad
from lanebound.integrity.core.errors import ConfigError

DT_S = 0.05


def profiles(count: int, duration_s: float = 300.0) -> list[np.ndarray]:
    return [speed_profile(np.random.default_rng(seed), duration_s, DT_S) for seed in range(count)]


def test_a_profile_stays_within_its_limits() -> None:
    for speed in profiles(20):
        assert speed.shape == (6001,)
        assert speed.min() >= 0.0
        assert speed.max() <= 13.9
        acceleration = np.diff(speed) / DT_S
        assert acceleration.min() >= -6.0 - 1e-9
        assert acceleration.max() <= 1.7 + 1e-9
        jerk = np.diff(acceleration) / DT_S
        assert np.abs(jerk).max() <= 2 * 12.0 + 1e-6


def test_profiles_stop_and_go_as_town_traffic_does() -> None:
    # 40 drives of 5 minutes; the bands are five standard errors wide about what 200 drives of 10 minutes gave
    speed = np.array(profiles(40))
    acceleration = np.diff(speed, axis=1) / DT_S
    assert 0.15 < (speed == 0.0).mean() < 0.29
    assert 6.9 < speed[speed > 0.0].mean() < 8.7
    assert 0.012 < (acceleration < -2.5).mean() < 0.033
    stops = (np.diff((speed == 0.0).astype(int), axis=1) == 1).sum() / (40 * 5)
    assert 0.9 < stops < 1.8


def test_a_profile_is_its_generators_alone() -> None:
    first, second = (speed_profile(np.random.default_rng(3), 60.0, DT_S) for _ in range(2))
    assert np.array_equal(first, second)
    config = SpeedProfileConfig(stop_probability=0.0)
    assert speed_profile(np.random.default_rng(3), 300.0, DT_S, config).min() > 0.0
    with pytest.raises(ConfigError, match="stop_probability"):
        SpeedProfileConfig(stop_probability=1.5)
    with pytest.raises(ConfigError, match="0 < low <= high"):
        SpeedProfileConfig(stand_s=(9.0, 3.0))


def test_the_lead_vehicle_drives_its_profile() -> None:
    road = Road(long_road(0, 3.25), np_random=np.random.default_rng(0))
    lead = LeadVehicle.make_on_lane(road, ("start", "end", 0), 50.0, 7.0)
    road.vehicles.append(lead)
    profile = speed_profile(np.random.default_rng(1), 30.0, DT_S)
    lead.follow(profile)
    driven = [lead.speed]
    for _ in range(700):
        road.act()
        road.step(DT_S)
        driven.append(lead.speed)
    assert np.array(driven[:601]) == pytest.approx(profile, abs=1e-9)
    assert np.array(driven[601:]) == pytest.approx(profile[-1], abs=1e-9)
    s, r = lead.lane.local_coordinates(lead.position)
    assert s == pytest.approx(50.0 + DT_S * np.sum(driven[:-1]), abs=0.2)
    assert abs(r) < 0.1


def test_a_wrecked_lead_vehicle_comes_to_rest() -> None:
    road = Road(long_road(0, 3.25), np_random=np.random.default_rng(0))
    lead = LeadVehicle.make_on_lane(road, ("start", "end", 0), 50.0, 10.0)
    lead.follow(np.full(1000, 10.0))
    lead.crashed = True
    for _ in range(200):
        lead.act()
        lead.step(DT_S)
    assert lead.speed < 0.1


def test_a_city_driver_slows_for_a_bend_and_an_idm_driver_does_not() -> None:
    lateral = {}
    for driver in (CityDriver, IDMVehicle):
        road = Road(city_loop(3.25), np_random=np.random.default_rng(0))
        car = driver.make_on_lane(road, ("a", "b", 1), 150.0, 13.5)
        car.target_speed = 13.5
        road.vehicles.append(car)
        worst = 0.0
        for _ in range(400):
            road.act()
            road.step(DT_S)
            worst = max(worst, car.speed**2 * abs(car.lane.curvature_at(car.lane.local_coordinates(car.position)[0])))
        lateral[driver] = worst
    assert lateral[CityDriver] < 2.4
    assert lateral[IDMVehicle] > 4.0


def test_a_city_driver_stops_behind_a_standing_car_and_does_not_reverse() -> None:
    road = Road(long_road(0, 3.25), np_random=np.random.default_rng(0))
    car = CityDriver.make_on_lane(road, ("start", "end", 0), 20.0, 12.0)
    wall = LeadVehicle.make_on_lane(road, ("start", "end", 0), 120.0, 0.0)
    wall.follow(np.zeros(2))
    road.vehicles += [car, wall]
    least = 0.0
    for _ in range(800):
        road.act()
        road.step(DT_S)
        least = min(least, car.speed)
    assert least >= -1e-12
    assert car.speed < 0.05
    assert 0.5 < car.lane_distance_to(wall) - 5.0 < 3.0
    assert not car.crashed


@pytest.mark.parametrize("connected", [True, False])
def test_neighbours_are_those_of_the_plain_road(connected: bool) -> None:
    rng = np.random.default_rng(2)
    network = city_loop(3.25)
    road = StreetRoad(network, np_random=rng, neighbour_vehicles_connected_lanes=connected)
    indices = list(network.lanes_dict())
    for _ in range(40):
        index = indices[rng.integers(len(indices))]
        lane = network.get_lane(index)
        place = lane.position(rng.uniform(-4.0, lane.length + 4.0), rng.uniform(-3.0, 3.0))
        road.vehicles.append(IDMVehicle(road, place, lane.heading_at(10.0), 5.0))
    road.objects.append(Landmark(road, road.vehicles[0].position + 1.0))
    for vehicle in road.vehicles:
        for index in (None, *indices):
            assert road.neighbour_vehicles(vehicle, index) == Road.neighbour_vehicles(road, vehicle, index)


def test_our_intersection_driver_is_a_class_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """highway-env rewrites the class that drives at its crossings; everybody's own stays as it is."""
    before = IDMVehicle.COMFORT_ACC_MAX
    monkeypatch.setattr(IDMVehicle, "DISTANCE_WANTED", 10.0)
    wrap("intersection-v2", {"sky": "open", "navigation": {"source": "perfect"}})
    assert vars(IntersectionDriver)["DISTANCE_WANTED"] == 7
    assert IDMVehicle.DISTANCE_WANTED == 10.0
    assert before == IDMVehicle.COMFORT_ACC_MAX
