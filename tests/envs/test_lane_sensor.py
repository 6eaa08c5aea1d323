"""The lane sensor: the camera keeps the car in its lane, and the position decides which road it believes to be on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2, norm

from lanebound.agents.drivers import make_agent
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.lane_sensor import LaneSensorConfig
from lanebound.integrity.core.errors import ConfigError

IDLE = 1
ALONE: dict[str, Any] = {"sky": "open", "world": {"vehicles_count": 0}, "perception": {"source": "none"}}
EXACT: dict[str, Any] = {
    "offset_sigma_m": 0.0, "offset_bias_sigma_m": 0.0, "heading_sigma_deg": 0.0, "heading_bias_sigma_deg": 0.0,
    "availability": 1.0,
}  # fmt: skip
ON_MOTORWAY, ON_COLLECTOR = 1, 0
TAIL = 5e-4  # of each side: a test of this file fails by chance once in 1000 runs


def make(offset_ct_m: float = 0.0, sensor: dict[str, Any] | None = None, **changes: Any) -> DrivingEnv:
    """Guidance with given positions, displaced to the right, alone on the roads."""
    source = {"source": "offset", "offset_ct_m": offset_ct_m} if offset_ct_m else {"source": "perfect"}
    config = {**ALONE, "navigation": source, "lane_sensor": EXACT if sensor is None else sensor, **changes}
    return DrivingEnv(make_config("lanebound/Guidance-v0", config))


def start(env: DrivingEnv, road: str) -> Any:
    """Reset with the first seed that begins on the road whose first node is ``road``; returns the observation."""
    for seed in range(20):
        seen, _ = env.reset(seed=seed)
        if env.world.vehicle.lane_index[0] == road:
            return seen
    raise AssertionError("no seed begins there")


def record(env: DrivingEnv, name: str) -> Any:
    """A record of the ego."""
    assert env.belief_loop is not None
    return env.belief_loop.episodes.ego[name][0]


def quantity(env: DrivingEnv, seen: Any, column: str) -> float:
    """An entry of an observation in its unit."""
    group, _, _ = column.partition(".")
    index = [entry for entry in env.observer.index if entry.group == group]
    place = next(i for i, entry in enumerate(index) if entry.column == column)
    return float(seen[group][place]) * index[place].scale


def true_offset(env: DrivingEnv) -> tuple[float, float]:
    """Offset and angle of the true car in its lane, by highway-env's lane."""
    car = env.world.vehicle
    s, r = car.lane.local_coordinates(car.position)
    return float(r), float(car.heading - car.lane.heading_at(s))


def looks(env: DrivingEnv, count: int) -> NDArray[np.float64]:
    """Offset, angle, and whether it is a dropout, of ``count`` looks of a car that stands."""
    env.reset(seed=5)
    env.world.vehicle.speed = 0.0
    assert env.belief_loop is not None
    episodes, row, out = env.belief_loop.episodes, np.zeros(1, dtype=np.int64), np.empty((count, 3))
    episodes.cars["speed"] = 0.0
    for n in range(count):
        episodes.carry_on(row, False)
        eye = episodes.ego["eye"][0]
        out[n] = eye["lateral_m"], eye["angle_rad"], episodes.ego["camera"][0]["out"]
    return out


def test_without_errors_it_measures_the_pose_in_the_lane() -> None:
    """Over changes of lane and the bends of a slip road."""
    env = make()
    start(env, "a")
    roads = set()
    for n in range(90):
        seen, _, terminated, *_ = env.step(2 if n in (8, 30, 36) else IDLE)
        offset, angle = true_offset(env)
        eye = record(env, "eye")
        roads.add(env.world.vehicle.lane_index[:2])
        assert eye["lateral_m"] == pytest.approx(offset, abs=1e-9)
        assert eye["angle_rad"] == pytest.approx(angle, abs=1e-9)
        assert quantity(env, seen, "ego.lateral_offset") == pytest.approx(offset, abs=1e-4)
        if terminated:
            break
    assert ("c", "t") in roads


def test_noise_and_constant_errors_are_as_declared() -> None:
    config = LaneSensorConfig(availability=1.0)
    env = make(sensor={"availability": 1.0})
    count = 4000
    found = looks(env, count)
    camera = record(env, "camera")
    for k, sigma, bias in (
        (0, config.offset_sigma_m, float(camera["offset_m"])),
        (1, math.radians(config.heading_sigma_deg), float(camera["heading_rad"])),
    ):
        values = found[:, k]
        low, high = chi2.ppf([TAIL, 1.0 - TAIL], df=count - 1)
        assert low < (count - 1) * values.var(ddof=1) / sigma**2 < high
        assert abs(values.mean() - bias) < norm.isf(TAIL) * sigma / math.sqrt(count)
    drawn = []
    for seed in range(200):
        env.reset(seed=seed)
        drawn.append(float(record(env, "camera")["offset_m"]) / config.offset_bias_sigma_m)
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], df=200)
    assert low < np.square(drawn).sum() < high


def test_dropouts_are_a_process_of_two_states() -> None:
    """Beginnings of dropouts and ends, each in as many steps as it was possible."""
    env = make(sensor={"availability": 0.8, "dropout_s": 0.5})
    out = looks(env, 20_000)[:, 2] > 0.5
    figures = LaneSensorConfig(availability=0.8, dropout_s=0.5).figures(1.0 / env.config.simulation_hz)
    for before, name in ((False, "leave"), (True, "back")):
        possible = out[:-1] == before
        changed = int((out[1:] != before)[possible].sum())
        low, high = binom.ppf([TAIL, 1.0 - TAIL], int(possible.sum()), figures[name])
        assert low <= changed <= high
    assert figures["leave"] / (figures["leave"] + figures["back"]) == pytest.approx(0.2, abs=0.01)


def test_during_a_dropout_the_heading_error_moves_the_pose_aside_within_the_bound() -> None:
    env = make(sensor=EXACT | {"heading_bias_sigma_deg": 0.2})
    start(env, "p")
    assert env.belief_loop is not None
    rules, camera = env.belief_loop.episodes.rules, record(env, "camera")
    rules["lane_sensor"]["leave"], rules["lane_sensor"]["back"] = 1.0, 0.0
    eye, before = record(env, "eye"), true_offset(env)[0]
    way = 0.0
    for _ in range(10):
        env.step(IDLE)
        way += env.world.vehicle.speed * env.dt_s
    error = float(eye["lateral_m"]) - true_offset(env)[0]
    assert camera["out"] == 1
    assert record(env, "belief")["lane_seen"] == 0
    assert before == pytest.approx(0.0, abs=1e-9)
    assert error == pytest.approx(way * math.sin(camera["heading_rad"]), rel=0.05)
    assert 0.0 < abs(error) < eye["pl_ct_m"]


def test_the_position_does_not_steer_the_car() -> None:
    """The same path, bit for bit, with an error of 9 m and of none; the errors of the camera are the same."""
    paths = []
    for offset_m in (0.0, 9.0):
        env = make(offset_m, sensor={})
        env.reset(seed=2)
        paths.append([env.step(2 if n == 5 else IDLE) and tuple(env.world.vehicle.position) for n in range(25)])
    assert paths[0] == paths[1]


@pytest.mark.parametrize(("road", "offset_m", "limit_mps"), [("a", 21.5, 13.9), ("p", -21.5, 27.8)])
def test_a_position_on_the_other_road_is_believed_and_its_level_shows_the_doubt(
    road: str, offset_m: float, limit_mps: float
) -> None:
    """18 m between the nearest lanes, 21.5 m between lanes of the same number; a level of 21.5 m reaches back."""
    env = make(offset_m)
    seen = start(env, road)
    assert quantity(env, seen, "road.speed_limit") == pytest.approx(limit_mps, abs=1e-5)
    assert quantity(env, seen, "integrity.possible_limit") == pytest.approx(13.9, abs=1e-5)
    assert quantity(env, seen, "road.offset") == pytest.approx(0.0, abs=1e-5)
    *_, info = env.step(IDLE)
    assert info["wrong_road"]
    assert info["err_ct_m"] == pytest.approx(offset_m, abs=0.01)
    assert (info["alert"], info["available"], info["hmi"]) == (True, False, False)
    assert (info["cost_lane"], info["cost_lane_integrity"]) == (0.0, 0.0)


@pytest.mark.parametrize(("offset_m", "possible"), [(7.0, False), (9.5, True), (-9.5, False)])
def test_a_road_is_possible_where_the_level_reaches_its_pavement(offset_m: float, possible: bool) -> None:
    """From the right lane of the motorway to the pavement of the collector road it is 18 m less half a lane."""
    env = make(offset_m)
    seen = start(env, "a")
    from_left = 3.5 * (1 - env.world.vehicle.lane_index[2])
    assert quantity(env, seen, "road.other_road") == pytest.approx(16.25 + from_left - offset_m, abs=0.01)
    assert not record(env, "outcome")["wrong_road"]
    reached = 16.25 + from_left - offset_m <= abs(offset_m)
    limit = 13.9 if reached else 27.8
    assert quantity(env, seen, "integrity.possible_limit") == pytest.approx(limit, abs=1e-5)
    if not from_left:
        assert reached == possible


def test_a_careful_driver_keeps_to_the_slower_of_the_possible_roads() -> None:
    speeds = {}
    for name in ("nominal", "integrity_aware"):
        env = make(9.5)
        seen, driver = start(env, "a"), make_agent(name, env)
        for _ in range(24):
            seen, *_, info = env.step(driver.predict(seen, deterministic=True)[0])
        speeds[name] = info["speed_mps"], quantity(env, seen, "integrity.possible_limit")
    assert speeds["integrity_aware"][0] == pytest.approx(speeds["integrity_aware"][1], abs=0.3)
    assert speeds["nominal"][0] > 26.0


def test_a_car_under_direct_commands_keeps_its_lane_by_the_camera_as_well() -> None:
    """An error of 1.5 m, by which it would leave its lane of 3.25 m."""
    config = {"sky": "open", "navigation": {"source": "offset", "offset_ct_m": 1.5}, "perception": {"source": "none"}}
    most = {}
    for sensor in (None, {}):
        env = DrivingEnv(make_config("lanebound/LaneKeeping-v0", {**config, "lane_sensor": sensor}))
        driver = make_agent("nominal", env)
        seen, _ = env.reset(seed=3)
        aside = []
        for _ in range(60):
            seen, *_ = env.step(driver.predict(seen, deterministic=True)[0])
            aside.append(abs(true_offset(env)[0]))
        most[sensor is not None] = max(aside[20:])
    assert most[True] < 0.6
    assert most[False] > 1.2


def test_other_ids_have_no_entries_of_roads() -> None:
    env = DrivingEnv(make_config("lanebound/LaneKeeping-v0"))
    assert not any(entry.name in ("route_shift", "possible_limit", "lane_seen") for entry in env.observer.index)
    blind = make(observation={"integrity": "blind"})
    names = {entry.name for entry in blind.observer.index}
    assert "route_shift" in names
    assert not names & {"possible_limit", "roads_agree"}


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"lane_sensor": {}, "alert_limit": "budget", "observation": {"pl_max_m": 30.0}}, "alert_limit"),
        ({"cost": {"alert_speed": "roads"}}, "cost.alert_speed"),
        ({"lane_sensor": {"availability": 0.0}}, "lane_sensor.availability"),
        ({"lane_sensor": {"ofset_sigma_m": 0.1}}, "lane_sensor.ofset_sigma_m"),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        make_config("lanebound/LaneKeeping-v0", changes)
