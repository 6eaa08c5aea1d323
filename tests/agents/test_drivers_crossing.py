"""Giving way: to whoever crosses the route in time, to nobody else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.aware import AwareConfig, IntegrityAware
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.crossing import YieldConfig, _arrival_s, _decision, yield_speed
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.observation import ObservationConfig
from lanebound.envs.worlds.drivers import IntersectionDriver

C = YieldConfig()
GIVEN = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}


@pytest.fixture
def reader() -> Reader:
    return Reader(ObservationConfig(form="flat"))


def seen(reader: Reader, v: float, ahead: float, right: float, speed: float, heading_deg: float) -> Any:
    """The ego on a straight road and one other, whose heading is relative to the ego's."""
    psi = math.radians(heading_deg)
    shown = {f"road.preview_{d:g}m_ahead": d for d in reader.previews_m} | {
        "ego.speed": v,
        "traffic.v0_present": 1.0,
        "traffic.v0_ahead": ahead,
        "traffic.v0_right": right,
        "traffic.v0_velocity_ahead": speed * math.cos(psi) - v,
        "traffic.v0_velocity_right": speed * math.sin(psi),
        "traffic.v0_heading_sin": math.sin(psi),
        "traffic.v0_heading_cos": math.cos(psi),
    }
    out = np.zeros(len(reader.columns), dtype=np.float32)
    for name, value in shown.items():
        out[reader.columns.index(name)] = value / reader.scale(name)
    return out


def stop_m(speed: float) -> float:
    """Distance in which that speed ends, the response included."""
    return speed * C.response_s + speed**2 / (2.0 * C.brake_mps2)


def with_junction(reader: Reader, row: Any, distance: float) -> Any:
    row[reader.columns.index("road.junction")] = distance / reader.scale("road.junction")
    return row


def test_whoever_crosses_when_the_ego_would_be_there_is_given_way(reader):
    """Paths cross 30 m ahead, where both would be after 3 s: it stops before the other's width."""
    speed = float(yield_speed(reader, with_junction(reader, seen(reader, 10.0, 30.0, 24.0, 8.0, -90.0), 50.0), C, 10.0))
    assert 30.0 - C.width_m - C.length_m - 2.0 <= stop_m(speed) <= 30.0 - C.length_m


def test_it_waits_before_the_junction_not_inside(reader):
    speed = float(yield_speed(reader, with_junction(reader, seen(reader, 10.0, 30.0, 24.0, 8.0, -90.0), 18.0), C, 10.0))
    assert stop_m(speed) == pytest.approx(18.0 - C.line_m, abs=0.1)


@pytest.mark.parametrize(
    ("ahead", "right", "speed", "heading_deg"),
    [
        (30.0, -30.0, 8.0, -90.0),  # has crossed and drives away
        (30.0, 24.0, 0.5, -90.0),  # waits beside the route
        (30.0, 80.0, 4.0, -90.0),  # comes long after the ego has gone
        (30.0, 0.0, 5.0, 0.0),  # leads
        (-30.0, 0.0, 12.0, 0.0),  # follows
        (20.0, 3.5, 12.0, 0.0),  # drives beside it
        (40.0, -4.0, 10.0, 180.0),  # comes towards it on the other lane
        (-20.0, 10.0, 8.0, -90.0),  # crosses behind
    ],
)
def test_nobody_else_is(reader, ahead, right, speed, heading_deg):
    assert float(yield_speed(reader, seen(reader, 10.0, ahead, right, speed, heading_deg), C, 10.0)) == np.inf


def test_whoever_stands_across_the_route_is_stopped_for_however_long_it_stands(reader):
    """30 m ahead and 1 m beside the route, from where the ego's time of arrival says nothing."""
    row = with_junction(reader, seen(reader, 10.0, 30.0, 1.0, 0.0, -90.0), 50.0)
    speed = float(yield_speed(reader, row, C, 10.0))
    assert 30.0 - C.width_m - C.length_m - 2.0 <= stop_m(speed) <= 30.0 - C.length_m


def test_whoever_turns_is_followed_along_the_turn(reader):
    """Its heading is between those of the roads: a turn to the right ends across the route, straight on does not."""
    aligned, turning = (
        with_junction(reader, seen(reader, 8.0, 15.0, -10.0, 6.0, degrees), 10.0) for degrees in (0.0, 20.0)
    )
    assert float(yield_speed(reader, aligned, C, 8.0)) == np.inf
    assert float(yield_speed(reader, turning, C, 8.0)) < np.inf


def test_uncertain_positions_widen_it(reader):
    """The other vehicle stands 3.2 m beside the route and faces away: too near only with a margin of a metre."""
    row = with_junction(reader, seen(reader, 8.0, 30.0, 3.2, 0.0, 90.0), 50.0)
    assert float(yield_speed(reader, row, C, 8.0)) == np.inf
    assert float(yield_speed(reader, row, C, 8.0, 1.0)) < np.inf


def test_within_the_crossing_the_ego_goes_on(reader):
    """It can no longer stop before it, so it clears the crossing."""
    assert float(yield_speed(reader, seen(reader, 5.0, 3.0, 8.0, 8.0, -90.0), C, 10.0)) == np.inf


def test_a_batch_and_nobody_to_see():
    reader = Reader(ObservationConfig(form="flat"))
    rows = [seen(reader, 10.0, 30.0, right, 8.0, -90.0) for right in (24.0, -30.0)]
    together = yield_speed(reader, np.stack(rows), C)
    assert together.tolist() == [float(yield_speed(reader, row, C)) for row in rows]
    blind = Reader(ObservationConfig(form="flat", vehicles=0))
    assert float(yield_speed(blind, np.zeros(len(blind.columns), dtype=np.float32), C)) == np.inf


def turning_left(reader: Reader, row: Any, radius: float, entry: float) -> Any:
    """The route turns left by a right angle after so many metres."""
    for d in reader.previews_m:
        angle = min(max(d - entry, 0.0) / radius, 0.5 * math.pi)
        beyond = max(d - entry - 0.5 * math.pi * radius, 0.0)
        ahead = min(d, entry) + radius * math.sin(angle)
        right = -radius * (1.0 - math.cos(angle)) - beyond
        for name, value in (("ahead", ahead), ("right", right), ("heading", -angle)):
            column = f"road.preview_{d:g}m_{name}"
            row[reader.columns.index(column)] = value / reader.scale(column)
    return row


@pytest.mark.parametrize(("right", "heading_deg", "waits"), [(-30.0, 90.0, True), (-30.0, -90.0, False)])
def test_a_vehicle_of_the_road_into_which_the_route_turns_is_given_way(reader, right, heading_deg, waits):
    """It comes on the lane beside the exit, antiparallel to it, and crosses the turn; one that drives off does not."""
    row = turning_left(reader, seen(reader, 6.0, 19.0, right, 8.0, heading_deg), 13.0, 10.0)
    assert (float(yield_speed(reader, with_junction(reader, row, 10.0), C, 6.0)) < np.inf) == waits


def test_who_leaves_the_crossing_passes_who_waits_on_the_same_arm():
    """highway-env takes the approach for what goes on from the exit of its arm, and stops one beside the other."""
    env = DrivingEnv(make_config("lanebound/Intersection-v0", {"sky": "open", "navigation": {"source": "perfect"}}))
    env.reset(seed=1008)
    road, ego = env.world.road, env.world.vehicle
    exit_lane = road.network.get_lane(("il0", "o0", 0))
    leaving = IntersectionDriver(road, exit_lane.position(3.0, 0.0), exit_lane.heading_at(3.0), 5.0)
    ego.position = road.network.get_lane(("o0", "ir0", 0)).position(99.0, 0.0)
    assert IDMVehicle.acceleration(leaving, leaving, ego) < -5.0
    assert leaving.acceleration(leaving, ego) == pytest.approx(0.0, abs=1e-6)  # it has its target speed
    ahead = IntersectionDriver(road, exit_lane.position(11.0, 0.0), exit_lane.heading_at(11.0), 0.0)
    assert leaving.acceleration(leaving, ahead) < 0.0


def test_nobody_at_the_crossing_reverses():
    """highway-env's drivers reverse where the gap ahead is shorter than the desired one, down to -3 m/s."""
    env = DrivingEnv(make_config("lanebound/Intersection-v0", {"sky": "open", "navigation": {"source": "perfect"}}))
    env.reset(seed=1008)
    slowest = 0.0
    for _ in range(24):
        env.step(0)
        sound = [v.speed for v in env.world.road.vehicles if not v.crashed]
        slowest = min(slowest, *sound)
    assert slowest > -1e-6


@pytest.mark.parametrize(("standing_s", "stops"), [(np.inf, True), (1.0, False)])
def test_inside_it_stops_where_it_is_met_later_standing_than_going(standing_s, stops):
    """It creeps at 1.2 m/s and would meet somebody 3 m ahead after 1.5 s, too near to stop with the usual room."""
    station, when = np.arange(0.0, 45.0, 1.5), np.arange(0.0, 7.1, 0.25)
    met = (station >= 3.0) & (when >= 1.5)[:, None]
    straight = (station < 3.0) & (when >= standing_s)[:, None]
    speed = _decision(station, when, met, straight, np.array(1.2), np.array(13.0), C)
    assert speed == (0.0 if stops else np.inf)


@pytest.mark.parametrize("speed", [2.0, 4.0, 6.0])
def test_it_stops_behind_a_vehicle_that_waits_at_the_crossing(speed):
    """From each level of speed, whenever between two decisions the vehicle comes into view."""
    env = DrivingEnv(make_config("lanebound/Intersection-v0", GIVEN))
    driver = make_agent("integrity_aware", env)
    for late_m in (0.0, 1.0, 2.0):
        observation, _ = env.reset(seed=1008)
        ego, road = env.world.vehicle, env.world.road
        env.world._spawn_vehicle = lambda *given, **named: None
        ahead = IntersectionDriver(road, ego.position - np.array([0.0, 25.0 + late_m]), ego.heading, 0.0)
        ahead.plan_route_to("o2")
        ahead.act = lambda action=None: None
        ego.speed = ego.target_speed = speed
        road.vehicles = [ego, ahead]
        observation, *_ = env.step(1)
        for _ in range(30):
            observation, *_ = env.step(driver.predict(observation)[0])
        assert not ego.crashed
        assert 1.0 < ego.position[1] - ahead.position[1] - 5.0 < 7.0
        assert ego.speed < 0.1


@pytest.mark.parametrize("top", [4.0, 6.0])
def test_the_predicted_start_by_meta_actions_encloses_the_driven_one(top):
    """From rest the ego is at each place no sooner than its brisk start says, and no later than its own pace."""
    env = DrivingEnv(make_config("lanebound/Intersection-v0", GIVEN))
    giving = Nominal(env, CruiseConfig()).giving_way
    env.reset(seed=1008)
    ego = env.world.vehicle
    env.world.road.vehicles = [ego]
    env.world._spawn_vehicle = lambda *given, **named: None
    while ego.speed > 0.01:
        env.step(0)
    way, ways = 0.0, []
    for _ in range(10):
        last = ego.position.copy()
        env.step(2 if ego.target_speed < top else 1)
        way += float(np.hypot(*(ego.position - last)))
        ways.append(way)
    v, fastest = np.array(0.0), np.array(top)
    soonest = _arrival_s(np.array(ways), v, fastest, giving.brisk_mps2, 0.0)
    latest = _arrival_s(np.array(ways), v, fastest, giving.accelerate_mps2, giving.response_s)
    driven = 0.5 * np.arange(1, 11)
    assert np.all(soonest <= driven + 0.05)
    assert np.all(driven <= latest + 0.05)
    assert np.all(latest - driven < 0.5)


def test_the_top_speed_of_a_crossing_is_a_target_speed():
    """Under an alert 4.8 m/s are wanted and 4 m/s driven: the ego clears the crossing later than at 4.8 m/s."""
    plan = Nominal(DrivingEnv(make_config("lanebound/Intersection-v0", GIVEN)), CruiseConfig())
    assert plan._reached(np.array([4.8, 10.0, 1.9, 0.0])).tolist() == [4.0, 6.0, 0.0, 0.0]


def test_inside_the_crossing_it_does_not_slow_to_look(reader):
    """Another one crosses the turn long after the ego; before the crossing the ego slows to look, inside it goes on."""
    other = seen(reader, 6.0, 4.0, -43.0, 6.0, 90.0)
    before, inside = (turning_left(reader, other.copy(), 13.0, entry) for entry in (3.0, 0.0))
    look = math.sqrt(C.enter_mps**2 + 2.0 * C.brake_mps2 * 3.0)
    assert float(yield_speed(reader, with_junction(reader, before, 3.0), C, 6.0)) == pytest.approx(look, abs=0.01)
    assert float(yield_speed(reader, with_junction(reader, inside, 6.0), C, 6.0)) == np.inf


@pytest.mark.parametrize(("level_m", "right", "stops"), [(1.9, 24.0, False), (2.1, 24.0, True), (1.9, 300.0, True)])
def test_a_small_level_is_no_reason_to_stop_where_vehicles_cross(level_m, right, stops):
    """The link is out: it waits on a free road, and with a level of more than half a lane."""
    env = DrivingEnv(make_config("lanebound/Intersection-v0", {"sky": "open", "observation": {"form": "flat"}}))
    plan = IntegrityAware(env, AwareConfig())
    row = seen(plan.reader, 4.0, 20.0, right, 6.0, -90.0)
    shown = {"integrity.alert": 1.0, "integrity.corrections_age": 5.0, "integrity.since_rtk": 5.0}
    shown |= {"integrity.pl_ct": level_m, "road.speed_limit": 10.0, "traffic.v0_present": float(right < 100.0)}
    shown |= {f"road.sky_{d:g}m_own": 30.0 for d in plan.reader.config.satellites_m}
    for name, value in shown.items():
        row[plan.reader.columns.index(name)] = value / plan.reader.scale(name)
    assert (float(plan.free_speed(row)) == 0.0) == stops
