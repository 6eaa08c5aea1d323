"""A work zone: where a lane closes is known by a message alone, and by the pose that the car believes to have."""

from __future__ import annotations

import math
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.objects import Obstacle

import lanebound.envs
from lanebound.agents.drivers import make_agent
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.alert_limits import AlertLimit
from lanebound.envs.batch.closure_kernel import NOT_BESIDE, closed_ahead, left_along_m, place_closure, receive
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.perception_kernel import RADIO
from lanebound.envs.batch.records_kernel import BELIEF, CAR, CLOSURE, RULES
from lanebound.envs.batch.rules import cost_figures
from lanebound.envs.costs import CostConfig
from lanebound.envs.worlds.closures import BARRIER_STEP_M, Closure, announce, barriers
from lanebound.envs.worlds.networks import long_road
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import one_record
from lanebound.integrity.sensors.v2v import V2vConfig
from side_by_side import PERFECT, Pairs, Tally, drive, pair, require_equal
from vehicles import record_of

ID = "lanebound/WorkZone-v0"
GIVEN: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
ALONE: dict[str, Any] = {**GIVEN, "world": {"vehicles_count": 0}}
IDLE = 1
NETWORK = long_road(0, 2.8, 2)
CLOSED = Closure(("start", "end", 1), 600.0, 700.0, 8.0)
CLEAR = V2vConfig(latency_s=0.0, jitter_s=0.0, loss=0.0)


def closing(closure: Closure = CLOSED, radio: V2vConfig = CLEAR, seed: int = 1, **changes: Any) -> Any:
    """The record of a closure on the road."""
    record = np.zeros(1, CLOSURE)[0]
    announce(record, lane_table(NETWORK), NETWORK, closure, radio, seed)
    for name, value in changes.items():
        record[name] = value
    return record


def radio_of(config: V2vConfig) -> Any:
    figures: dict[str, Any] = {name: getattr(config, name) for name in RADIO.names or () if hasattr(config, name)}
    return one_record(RADIO, epoch_s=0.1, cam=config.messages == "cam", level_sigmas=1.0, **figures)[0]


def car_at(side: int, station: float) -> Any:
    lane = NETWORK.get_lane(("start", "end", side))
    x, y = lane.position(station, 0.0)
    return record_of(CAR, x=x, y=y, heading=lane.heading_at(station), lane=side, length=5.0, width=2.0)


def named(env: DrivingEnv, observation: Any) -> dict[str, float]:
    """Entries in their units."""
    frame = np.concatenate(list(observation.values()))
    return {e.name: float(v) * e.scale for e, v in zip(env.observer.index, frame, strict=True) if e.group == "road"}


def test_obstacles_stand_in_the_middle_of_the_closed_lane_from_end_to_end() -> None:
    lane, half = NETWORK.get_lane(CLOSED.lane_index), 0.5 * Obstacle.LENGTH
    places = np.array([lane.local_coordinates(place) for place, _ in barriers(NETWORK, CLOSED)])
    assert places[0, 0] == pytest.approx(CLOSED.start_m + half)
    assert places[-1, 0] == pytest.approx(CLOSED.end_m - half)
    assert np.abs(places[:, 1]).max() < 1e-6
    assert np.diff(places[:, 0]).max() <= BARRIER_STEP_M + 1e-9
    assert BARRIER_STEP_M - Obstacle.LENGTH < 2 * 5.0  # two cars do not fit between


@pytest.mark.parametrize("distance_m", [0.0, 150.0, 290.0])
def test_messages_arrive_as_often_as_the_channel_says(distance_m: float) -> None:
    """Of evenly spread draws the share without a message after k epochs is ``(1 - P)^k``."""
    radio = V2vConfig(latency_s=0.0, jitter_s=0.0, loss=0.3)
    arrives = 0.7 * (1.0 - (distance_m / radio.range_m) ** 4)
    lane = NETWORK.get_lane(CLOSED.lane_index)
    start = lane.position(CLOSED.start_m, 0.0)
    car, figures = record_of(CAR, x=start[0] - distance_m, y=start[1], length=5.0, width=2.0), radio_of(radio)
    lucks = (np.arange(1000) + 0.5) / 1000
    records = [closing(radio=radio, luck=luck) for luck in lucks]
    for k in range(1, 6):
        for record in records:
            receive(record, car, figures, 0.1 * k)
        unknown = sum(int(record["known"]) == 0 for record in records)
        assert unknown == pytest.approx(1000 * (1.0 - arrives) ** k, abs=1.0)


def test_nothing_is_heard_beyond_the_range_and_a_late_message_comes_late() -> None:
    far, near = car_at(1, CLOSED.start_m - 400.0), car_at(1, CLOSED.start_m - 10.0)
    record = closing(luck=0.5)
    for k in range(1, 50):
        receive(record, far, radio_of(CLEAR), 0.1 * k)
    assert not record["known"]
    slow = V2vConfig(latency_s=0.25, jitter_s=0.0, loss=0.0)
    record = closing(radio=slow, luck=0.5)
    heard = []
    for k in range(1, 6):
        receive(record, near, radio_of(slow), 0.1 * k)
        heard.append(int(record["known"]))
    assert heard == [0, 0, 0, 1, 1]  # sent at 0.1 s, due at 0.35 s
    never = V2vConfig(latency_s=0.6, latency_max_s=0.5)
    assert closing(radio=never)["share"] == 0.0


def test_the_closure_lies_where_the_believed_pose_puts_it() -> None:
    lanes, record = lane_table(NETWORK).lanes, closing(known=1)
    for side, beside in ((0, 1), (1, 0)):
        lane = NETWORK.get_lane(("start", "end", side))
        b = record_of(BELIEF, lane=side, longitudinal_m=500.0)
        place_closure(record, b, lanes)
        start = NETWORK.get_lane(CLOSED.lane_index).position(CLOSED.start_m, 0.0)
        assert b["closure"] == 1
        assert b["closure_side"] == beside
        assert b["closure_start_m"] == pytest.approx(lane.local_coordinates(start)[0] - 500.0)
        assert b["closure_limit_mps"] == 8.0
    record["known"] = 0
    place_closure(record, b, lanes)
    assert (b["closure"], b["closure_side"]) == (0, NOT_BESIDE)
    assert math.isinf(b["closure_start_m"])


def test_the_limit_along_is_what_braking_leaves_of_the_way_to_the_closure() -> None:
    figures: dict[str, Any] = dict.fromkeys(RULES.names or (), 0)
    figures |= {name: np.zeros(1, RULES[name]) for name in ("rewards", "budget")}
    rules = one_record(RULES, **figures | {"policy_s": 0.5, "costs": cost_figures(CostConfig())})[0]
    b = record_of(BELIEF, closure=1, closure_side=0, closure_start_m=50.0, closure_end_m=150.0)
    assert left_along_m(b, 10.0, 5.0, rules) == pytest.approx(50.0 - 2.5 - 10.0 * 1.0 - 100.0 / 8.0)
    assert left_along_m(b, 0.0, 5.0, rules) == pytest.approx(47.5)
    for name, value in (("closure", 0), ("closure_side", 1), ("closure_end_m", -3.0)):
        other = b.copy()
        other[name] = value
        assert math.isinf(left_along_m(other, 10.0, 5.0, rules))


def test_beside_the_closure_its_limit_counts_and_before_it_the_way_to_it() -> None:
    lanes, record = lane_table(NETWORK).lanes, closing()
    assert closed_ahead(record, car_at(1, 560.0), lanes, 13.9) == pytest.approx((13.9, 37.5))
    assert closed_ahead(record, car_at(0, 560.0), lanes, 13.9) == (13.9, math.inf)
    assert closed_ahead(record, car_at(0, 640.0), lanes, 13.9) == (8.0, math.inf)
    assert closed_ahead(record, car_at(1, 640.0), lanes, 13.9) == (8.0, 0.0)
    assert closed_ahead(record, car_at(1, 760.0), lanes, 13.9) == (13.9, math.inf)


def test_nothing_shows_the_closure_before_its_message() -> None:
    env = DrivingEnv(make_config(ID, {**ALONE, "perception": {"source": "truth", "v2v": {"range_m": 60.0, "loss": 0}}}))
    observation, _ = env.reset(seed=2)
    known, gaps = [], []
    for _ in range(100):
        closure, car = env.world.closure, env.world.vehicle
        start = env.world.road.network.get_lane(closure.lane_index).position(closure.start_m, 0.0)
        gap = float(np.hypot(*(start - car.position)))
        road = named(env, observation)
        if gap > 60.0 and road["closure_known"] < 0.5:
            assert road["closure_start"] == road["closure_end"] == env.config.observation.range_m
            assert road["closure_left"] == road["closure_own"] == road["closure_right"] == 0.0
            assert road["closure_limit"] == env.config.observation.speed_max_mps
        known.append(road["closure_known"] > 0.5)
        gaps.append(gap)
        if known[-1]:
            s = car.lane.local_coordinates(start)[0] - car.lane.local_coordinates(car.position)[0]
            assert road["closure_start"] == pytest.approx(s, abs=1e-3)
            break
        observation, _, terminated, truncated, _ = env.step(IDLE)
        assert not terminated
        assert not truncated
    assert known[-1]
    assert not any(known[:-1])
    assert min(gaps[:-1]) > 45.0  # within 60 m nearly every message arrives


def test_without_the_entries_there_is_no_message() -> None:
    env = DrivingEnv(make_config(ID, {**ALONE, "observation": {"closure": False}}))
    env.reset(seed=2)
    for _ in range(20):
        env.step(IDLE)
    assert not any("closure" in entry.name for entry in env.observer.index)
    assert env.belief_loop is not None
    assert env.belief_loop.episodes.ego["closure"]["known"][0] == 0


def test_a_car_that_stays_in_the_closed_lane_strikes_the_first_obstacle() -> None:
    env = DrivingEnv(make_config(ID, ALONE))
    struck = 0
    for seed in range(6):
        env.reset(seed=seed)
        closure, terminated, truncated, info = env.world.closure, False, False, {}
        index = env.world.vehicle.lane_index
        while not (terminated or truncated):
            _, _, terminated, truncated, info = env.step(IDLE)
        assert info["crashed"] == (index == closure.lane_index)
        assert not (info["crashed"] and info["is_success"])
        if info["crashed"]:
            struck += 1
            front = env.world.vehicle.lane.local_coordinates(env.world.vehicle.position)[0] + 2.5
            assert front == pytest.approx(closure.start_m, abs=6.0)  # it is thrown back, within a decision
    assert 0 < struck < 6


def test_a_seed_gives_the_same_closure_and_three_of_four_egos_start_on_it() -> None:
    env, again = (DrivingEnv(make_config(ID, GIVEN)) for _ in range(2))
    own = 0
    for seed in range(60):
        for one in (env, again):
            one.reset(seed=seed)
        assert env.world.closure == again.world.closure
        start = env.world.vehicle.lane.local_coordinates(env.world.vehicle.position)[0]
        assert 195.0 < env.world.closure.start_m - start < 405.0
        own += env.world.vehicle.lane_index == env.world.closure.lane_index
    assert 34 <= own <= 54  # 45, 3.35 sigma: fails by chance once in 1000 runs


@pytest.mark.parametrize("seeds", [range(3)])
def test_the_engine_drives_it_as_the_single_environment(seeds: range) -> None:
    single, engine = pair("WorkZone", PERFECT)
    tally = Tally()
    for seed in seeds:
        drive(single, engine, seed, tally, 60)
    require_equal(tally, parted=1)  # drivers wait before obstacles, and so crawl
    assert tally.lane_changes > 0


def test_with_navigation_and_waiting_episodes_too() -> None:
    pairs = Pairs("WorkZone", {"sky": "open", "cities": {"count": 1}, "extent_m": 300.0}, 2, 5)
    pairs.step(8)
    pairs.reset(np.arange(2), None)  # episodes that have waited bring their closures with them
    pairs.step(8)
    require_equal(pairs.tally)


@pytest.mark.parametrize("error_m", [0.0, 4.0, -3.0])
def test_an_error_along_the_track_moves_the_closure(error_m: float) -> None:
    offset = {"navigation": {"source": "offset", "offset_at_m": error_m}}
    env = DrivingEnv(make_config(ID, {**ALONE, **offset}))
    observation, _ = env.reset(seed=3)
    while named(env, observation)["closure_start"] > 140.0:
        observation, *_ = env.step(IDLE)
    closure, car = env.world.closure, env.world.vehicle
    start = env.world.road.network.get_lane(closure.lane_index).position(closure.start_m, 0.0)
    truly = car.lane.local_coordinates(start)[0] - car.lane.local_coordinates(car.position)[0]
    assert named(env, observation)["closure_start"] == pytest.approx(truly - error_m, abs=0.1)


@pytest.mark.parametrize(
    ("world", "name"),
    [
        ({"closed_length": 1.0}, "world.closed_length"),
        ({"closed_limit": 0.5}, "world.closed_limit"),
        ({"ahead": [300.0, 200.0]}, "world.ahead"),
    ],
)
def test_a_closure_that_cannot_be_is_refused(world: dict[str, Any], name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        DrivingEnv(make_config(ID, {"world": world}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation": {"closure": True}}, r"observation\.closure must be false .*KeepingWorld, got True: .*Zone"),
        ({"cost": {"route": 1.0}}, r"cost\.route must be 0 .* LaneKeepingWorld, got 1\.0: .*GuidanceWorld"),
        ({"cost": {"gore": 1.0}}, r"cost\.gore must be 0 .* LaneKeepingWorld, got 1\.0: .*exit-v0"),
    ],
)
def test_what_a_world_does_not_have_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DrivingEnv(make_config("lanebound/LaneKeeping-v0", changes))


def test_a_fork_of_highway_env_has_a_gore() -> None:
    assert DrivingEnv({"base": "exit-v0", "cost": {"gore": 1.0}}).config.cost.gore == 1.0


def test_beside_the_closure_the_announced_limit_costs_to_break() -> None:
    """At 12 m/s, within the limit of the road; the closure's of 8.3 m/s is exceeded, on either lane."""
    env = DrivingEnv(make_config(ID, ALONE))
    env.reset(seed=2)
    closure, car, network = env.world.closure, env.world.vehicle, env.world.road.network
    for station, excess in ((closure.start_m - 50.0, 0.0), (closure.start_m + 20.0, 12.0 - 3.0 / 3.6 - 8.3)):
        index = (*closure.lane_index[:2], 1 - closure.lane_index[2])
        lane = network.get_lane(index)
        car.position, car.heading, car.speed = lane.position(station, 0.0), lane.heading_at(station), 12.0
        car.lane_index = car.target_lane_index = index
        car.lane, car.target_speed = lane, 12.0
        *_, info = env.step(IDLE)
        assert info["cost_speeding"] == pytest.approx(excess / 8.3 * env.dt_s, rel=0.1)
    assert env.config.cost.speeding == 2.0


def test_other_ids_keep_their_observations() -> None:
    for env_id in lanebound.envs.IDS:
        assert not make_config(env_id).observation.closure


def test_it_is_an_environment_as_the_others() -> None:
    env = gymnasium.make(ID, config=ALONE)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    assert ID not in lanebound.envs.IDS  # suites and pages of results do not drive it
    assert make_config(ID).alert_limit is AlertLimit.BUDGET
    frames = []
    for form in ("dict", "flat"):
        single = DrivingEnv(make_config(ID, {**ALONE, "observation": {"form": form}}))
        seen, _ = pickle.loads(pickle.dumps(single)).reset(seed=1)
        frames.append(np.concatenate(list(seen.values())) if form == "dict" else seen)
    assert np.array_equal(*frames)


@pytest.mark.parametrize("name", ["nominal", "integrity_aware"])
def test_drivers_leave_a_lane_that_closes(name: str) -> None:
    env = DrivingEnv(make_config(ID, ALONE))
    agent = make_agent(name, env)
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        over, info = False, {}
        while not over:
            action, _ = agent.predict(observation)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        assert info["is_success"]


def test_constant_speed_and_standing_are_no_success() -> None:
    env = DrivingEnv(make_config(ID, ALONE))
    for figures in ({"share": 0.0}, {"share": 0.25}, {"share": 0.5}):
        agent = make_agent("constant", env, figures)
        for seed in range(3):
            observation, _ = env.reset(seed=seed)
            over, info = False, {}
            while not over:
                observation, _, terminated, truncated, info = env.step(agent.predict(observation)[0])
                over = terminated or truncated
            assert not info["is_success"]


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"lanes_count": 1}, "world.lanes_count must be >= 2"),
        ({"ahead": [3000.0, 4000.0]}, r"must fit on a road of 32\d\d m"),
    ],
)
def test_a_road_that_closes_altogether_or_behind_its_end_is_refused(world: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gymnasium.make("lanebound/WorkZone-v0", config={"world": world}).reset(seed=1)
