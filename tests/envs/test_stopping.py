"""Stopping has a price where it is wrong: beyond the lane, and slower than the flow; none where a stop is right."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.rules import RuleBook
from lanebound.agents.episodes import full_id
from lanebound.envs import IDS, DrivingEnv, make_config
from lanebound.envs.ids import PRICED, id_of
from lanebound.integrity.core.errors import ConfigError

GIVEN: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}}
PRICES: dict[str, Any] = {"cost": {"blocking": 1.0, "standing_speed_mps": 2.0, "alert_speed": "level"}}
STAND, SLOWER, IDLE = np.zeros(2, dtype=np.float32), 0, 1


def make(env_id: str, **changes: Any) -> DrivingEnv:
    """An environment with given positions."""
    env = DrivingEnv(make_config(f"lanebound/{env_id}-v0", {**GIVEN, **PRICES, **changes}))
    env.reset(seed=2)
    return env


@pytest.mark.parametrize(("speed_mps", "counts_mps"), [(0.0, 2.0), (1.0, 2.0), (5.0, 5.0)])
def test_a_body_beyond_its_lane_costs_at_rest_as_well(speed_mps: float, counts_mps: float) -> None:
    """1 m aside of the middle of a lane of 3.25 m the body of 2 m is out by 0.375 m."""
    env = make("LaneKeeping")
    car = env.world.vehicle
    s = 40.0  # on the first straight
    car.position, car.heading, car.speed = car.lane.position(s, 1.0), car.lane.heading_at(s), speed_mps
    *_, info = env.step(STAND)
    assert info["cost_lane"] == pytest.approx(0.375 * counts_mps * env.dt_s, rel=0.05)
    assert info["cost_lane_integrity"] == pytest.approx(info["cost_lane"], rel=0.05)  # by a level of 0


@pytest.mark.parametrize(("share", "lacks"), [(0.0, 1.0), (0.35, 0.5), (0.7, 0.0), (1.0, 0.0), (-0.2, 1.0)])
def test_a_car_that_is_slower_than_a_share_of_the_flow_blocks(share: float, lacks: float) -> None:
    env = make("Highway", action="continuous", policy_hz=5, actuators=None, world={"vehicles_count": 0})
    env.world.vehicle.speed = share * 30.0 + 1e-9
    *_, info = env.step(STAND)
    assert info["cost_blocking"] == pytest.approx(lacks * env.dt_s)
    assert info["cost"] == pytest.approx(info["cost_blocking"])


def test_behind_a_vehicle_that_stands_a_stop_is_right() -> None:
    """13.9 m/s for 4 s are 55.6 m, from middle to middle; also behind a wreck."""
    env = make("CarFollowing", perception={"source": "none"}, world={"lead": {"cruise_mps": [0.001, 0.001]}})
    ego = env.world.vehicle
    lead = env.world.lead  # type: ignore[attr-defined]
    for gap_m, crashed, lacks in ((55.0, False, 0.0), (55.0, True, 0.0), (57.0, False, 1.0)):
        s = ego.lane.local_coordinates(ego.position)[0]
        lead.position, lead.speed, lead.crashed, ego.speed = ego.lane.position(s + gap_m, 0.0), 0.0, crashed, 0.0
        *_, info = env.step(STAND)
        assert info["cost_blocking"] == pytest.approx(lacks * env.dt_s)


def test_to_let_a_vehicle_pass_that_crosses_is_right() -> None:
    """A car that waits at the line of a crossing, for one that comes from the left; not once that one has passed."""
    env = make("Intersection", world={"initial_vehicle_count": 1, "spawn_probability": 0.0})
    ego, network = env.world.vehicle, env.world.road.network
    other = next(v for v in env.world.road.vehicles if v is not ego)
    env.world.road.vehicles = [other, ego]
    approach, across = ego.lane, network.get_lane(("o1", "ir1", 0))

    def waits(station_m: float, other_m: float, speed_mps: float) -> float:
        ego.position, ego.speed, ego.target_speed = approach.position(approach.length - station_m, 0.0), 0.0, 0.0
        ego.heading = approach.heading_at(0.0)
        other.position, other.heading = across.position(across.length - other_m, 0.0), across.heading_at(0.0)
        other.speed, other.lane_index, other.target_lane_index = speed_mps, ("o1", "ir1", 0), ("o1", "ir1", 0)
        other.plan_route_to("o3")
        return float(env.step(SLOWER)[-1]["cost_blocking"])

    assert waits(3.0, 30.0, 8.0) == 0.0
    assert waits(60.0, 30.0, 8.0) == pytest.approx(env.dt_s)
    assert waits(3.0, 95.0, 5.0) == pytest.approx(env.dt_s)
    other.position = network.get_lane(("il3", "o3", 0)).position(40.0, 0.0)
    env.world.road.vehicles = [ego]
    assert float(env.step(SLOWER)[-1]["cost_blocking"]) == pytest.approx(env.dt_s)


def test_half_the_rate_of_decisions_leaves_the_cost_of_an_episode() -> None:
    found = []
    for hz in (5, 10):
        env = make("LaneKeeping", policy_hz=hz, world={"duration": 10.0})
        env.reset(seed=5)
        total, over = 0.0, False
        while not over:
            *_, terminated, truncated, info = env.step(np.array([-0.5, 0.0], dtype=np.float32))
            total, over = total + info["cost_blocking"], terminated or truncated
        found.append(total)
    assert found[0] == pytest.approx(found[1], rel=0.05)
    assert found[0] > 5.0


@pytest.mark.parametrize("env_id", ["LaneKeeping", "Roundabout", "UrbanCanyon"])
def test_the_engine_prices_as_single_environments_do(env_id: str) -> None:
    """And shows the same permitted speed, under alerts of a dense sky."""
    config = {**PRICES, "sky": "dense", "alert_limit": "budget", "observation": {"form": "flat"}}
    env = gymnasium.make(f"lanebound/{env_id}-v0", config=config).unwrapped
    engine = gymnasium.make_vec(f"lanebound/{env_id}-v0", num_envs=2, config=config)
    assert isinstance(env, DrivingEnv)
    driver, paid, alerted = make_agent("integrity_aware", env), dict[str, float](), 0
    one, _ = env.reset(seed=5)
    many, _ = engine.reset(seed=5)
    stop = make_agent("constant", env, {"share": 0.0})
    for n in range(40):
        action = (driver if n < 20 else stop).predict(one, deterministic=True)[0]
        one, _, terminated, truncated, info = env.step(action)
        many, *_, infos = engine.step(np.stack([action, action]))
        np.testing.assert_allclose(many[0], one, atol=1e-5)
        for name in ("cost_lane", "cost_lane_integrity", "cost_alert", "cost_blocking", "cost"):
            assert infos[name][0] == pytest.approx(info[name], abs=1e-6)
            paid[name] = paid.get(name, 0.0) + info[name]
        alerted += info["alert"]
        if terminated or truncated:
            break
    engine.close()
    assert paid["cost_blocking"] > 0.0
    assert alerted


def test_drivers_keep_to_the_speed_that_the_level_permits() -> None:
    """A constant error of twice the room: half of the half that is permitted where a level equals its limit."""
    offset = {"navigation": {"source": "offset", "offset_ct_m": 1.25}, "perception": {"source": "none"}}
    env = make("LaneKeeping", **offset)
    seen, _ = env.reset(seed=2)
    book, driver = RuleBook(env), make_agent("integrity_aware", env)
    permitted = float(seen["integrity"][-1]) * env.config.observation.speed_max_mps
    assert permitted == pytest.approx(0.25 * 13.9, abs=0.05)
    assert float(book.speeds(seen)["level"]) == pytest.approx(permitted, abs=0.01)
    late = 0.0
    for _ in range(60):
        seen, *_, info = env.step(driver.predict(seen, deterministic=True)[0])
        late += info["cost_alert"]
    assert info["speed_mps"] <= permitted
    assert info["speed_mps"] > 0.8 * permitted
    assert late < 2.5


@pytest.mark.parametrize(("share", "lacks"), [(0.0, 1.0), (0.125, 0.5), (0.25, 0.0)])
def test_who_obeys_an_alert_does_not_block_and_who_stands_does(share: float, lacks: float) -> None:
    """An error of twice the room permits a quarter of the limit."""
    offset = {"navigation": {"source": "offset", "offset_ct_m": 1.25}, "perception": {"source": "none"}}
    env = make("LaneKeeping", **offset)
    env.world.vehicle.speed = share * 13.9 + 0.01
    *_, info = env.step(STAND)
    assert info["cost_blocking"] == pytest.approx(lacks * env.dt_s, abs=0.02)


@pytest.mark.parametrize("env_id", [id_of(kind) for kind in PRICED])
def test_a_priced_id_is_the_other_one_with_prices(env_id: str) -> None:
    """Made by Gymnasium alone and in the engine; what it changes beside them is the limit and followers."""
    light = {"sky": "open", "cities": {"count": 1}}
    env = gymnasium.make(env_id, config=light).unwrapped
    engine = gymnasium.make_vec(env_id, num_envs=1, config=light)
    assert isinstance(env, DrivingEnv)
    assert env.config == make_config(env_id, light)
    assert engine.single_observation_space == env.observation_space
    before = make_config(env_id.replace("Priced", ""), light)
    left = {"alert_limit", "cost", "cost_limit", "traffic", "observation"}
    assert env.config.to_dict().keys() == before.to_dict().keys()
    for name, value in env.config.to_dict().items():
        assert name in left or value == before.to_dict()[name]
    changed = {name for name, value in env.config.cost.to_dict().items() if value != before.cost.to_dict()[name]}
    assert changed == {"alert_speed", "blocking", "standing_speed_mps"}
    assert full_id(env_id.partition("/")[2].lower().removesuffix("-v0")) == env_id
    engine.close()


@pytest.mark.parametrize("env_id", IDS)
def test_by_default_nothing_of_this_counts(env_id: str) -> None:
    cost = make_config(env_id).cost
    assert (cost.blocking, cost.standing_speed_mps, cost.alert_speed.value) == (0.0, 0.0, "share")


def test_figures_beyond_their_bounds_are_refused() -> None:
    for changes, message in (
        ({"blocking": -1.0}, "cost.blocking must be >= 0"),
        ({"blocking_share": 0.0}, "cost.blocking_share must lie in"),
        ({"alert_speed": "half"}, "cost.alert_speed must be one of 'share', 'level' or 'roads'"),
    ):
        with pytest.raises(ConfigError, match=message):
            DrivingEnv(make_config("lanebound/LaneKeeping-v0", {"cost": changes}))
