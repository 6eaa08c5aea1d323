"""Tolling: geo-objects on roads that look alike, what is claimed of them, and what a wrong charge costs."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import pytest
from drives import drives
from gymnasium.utils.env_checker import check_env
from sb3_contrib import MaskablePPO
from tolling_table import decided

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.charging import claim
from lanebound.agents.drivers.keyboard import Key, KeyboardDriver
from lanebound.agents.drivers.rules import RuleBook
from lanebound.agents.episodes import full_id
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.toll_kernel import CHARGE, DEFER, SPARE, WINDOW_S
from lanebound.envs.worlds.tolling import GAP_M, ROADS, SECTION_M, SIDES, tolled_roads
from lanebound.integrity.core.errors import ConfigError, InputError
from side_by_side import Tally, drive, pair, require_equal

OBJECTS = len(SIDES) + 1
GIVEN: dict[str, Any] = {"sky": "open", "navigation": {"source": "perfect"}}


def roads_apart(layout: int, k: int) -> list[float]:
    """Distances between the neighbouring roads of a geo-object."""
    graph = tolled_roads(layout, 3.5).graph
    y = [graph[f"{road}{k}"][f"{road}{k}x"][0].position(0.0, 0.0)[1] for road in ROADS]
    return np.diff(y).tolist()


def driven(env: DrivingEnv, claims: Any) -> dict[str, Any]:
    """Drive an episode with claims of each decision, a function of the record TOLL: sums, and what was driven."""
    loop = env.belief_loop
    assert loop is not None
    tolls, found = loop.episodes.ego["toll"], {"over": 0.0, "under": 0.0, "reward": 0.0, "at": [], "roads": {}}
    over = False
    while not over:
        start, end, _ = env.world.vehicle.lane_index
        if end == f"{start}x":
            found["roads"][int(start[1:])] = start[0]
        _, reward, terminated, truncated, info = env.step(claims(tolls[0]))
        over = terminated or truncated
        found["over"] += info["cost_overcharge"]
        found["under"] += info["cost_undercharge"]
        found["reward"] += reward
        if reward or info["cost"]:
            found["at"].append(loop.time_s)
    return found | {"success": info["is_success"], "truncated": truncated}


@pytest.mark.parametrize("layout", [0, 1, 7])
def test_the_roads_of_a_geo_object_look_alike_and_lie_apart_as_stated(layout: int) -> None:
    network = tolled_roads(layout, 3.5)
    gaps = sorted(gap for k in range(OBJECTS) for gap in roads_apart(layout, k))
    np.testing.assert_allclose(gaps, np.geomspace(*GAP_M, 2 * OBJECTS))
    for k in range(OBJECTS):
        lanes = [network.graph[f"{road}{k}"][f"{road}{k}x"] for road in ROADS]
        assert {(lane.line_types[0], lane.length, lane.speed_limit) for road in lanes for lane in road[:1]} == {
            (lanes[0][0].line_types[0], SECTION_M, lanes[0][0].speed_limit)
        }
        assert [len(road) for road in lanes] == [2, 2, 2]
    assert roads_apart(0, 0) != roads_apart(1, 0)


def test_a_lane_goes_on_without_a_step_to_a_lane_of_the_other_number() -> None:
    """From each lane on which a car may come, to the last section."""
    network = tolled_roads(0, 3.5)
    for road in ROADS[:2]:
        for lane in range(2):
            index, seen = (f"{road}0", f"{road}0x", lane), []
            for _ in range(2 * OBJECTS - 2):
                here = network.get_lane(index)
                end = here.position(here.length, 0.0)
                seen.append(index)
                index = network.next_lane(index, None, end, np.random.default_rng(0))
                np.testing.assert_allclose(network.get_lane(index).position(0.0, 0.0), end, atol=1e-6)
            lanes = [place[2] for place in (*seen, index) if place[:2] in network.geo_objects]
            assert all(one != other for one, other in pairwise(lanes))
            assert network.geo_objects[index[:2]] == OBJECTS - 1


def test_the_table_of_lanes_knows_the_geo_objects() -> None:
    network = tolled_roads(2, 3.5)
    table = lane_table(network)
    for index, lane in zip(table.index, table.lanes.table, strict=True):
        assert lane["geo_object"] == network.geo_objects.get(index[:2], -1)
    with closing(DrivingEnv(make_config("lanebound/Guidance-v0", {"sky": "open"}))) as env:
        assert set(lane_table(env.world.road.network).lanes.table["geo_object"]) == {-1}


@pytest.mark.parametrize("code", [DEFER, CHARGE, SPARE])
def test_what_is_always_claimed_costs_what_was_driven(code: int) -> None:
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", GIVEN))) as env:
        env.reset(seed=5)
        found = driven(env, lambda toll: code)
        assert sorted(found["roads"]) == list(range(OBJECTS))
        due = sum(env.world.tolled[k][0][0] == road for k, road in found["roads"].items())
        assert 0 < due < OBJECTS
        assert found["over"] == (OBJECTS - due if code == CHARGE else 0)
        assert found["under"] == (0 if code == CHARGE else due)
        assert found["reward"] == {DEFER: 0, CHARGE: due, SPARE: OBJECTS - due}[code]
        assert not found["success"]
        assert found["truncated"]


def test_right_claims_are_a_success_and_the_first_one_counts() -> None:
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", GIVEN))) as env:
        env.reset(seed=5)

        def right_then_wrong(toll: Any) -> int:
            k = int(toll["open"])
            if k < 0 or toll["driven"][k] < 0:
                return DEFER
            right = CHARGE if toll["driven"][k] == toll["tolled"][k] else SPARE
            return right if toll["claims"][k] == DEFER else CHARGE + SPARE - right

        found = driven(env, right_then_wrong)
        assert (found["over"], found["under"], found["reward"], found["success"]) == (0, 0, OBJECTS, True)
        ends = [k * (SECTION_M + 240.0) + SECTION_M for k in range(OBJECTS)]
        assert len(found["at"]) == OBJECTS
        passed_s = np.diff(found["at"]) * 20.0 / np.diff(ends)
        np.testing.assert_allclose(passed_s, 1.0, atol=0.1)  # closed as long after the end of each, the way is longer
        assert WINDOW_S == 5.0


def test_distances_follow_from_the_position_and_the_camera() -> None:
    """A given position, ``shift`` to the right of the car: |shift| and |gap - shift| but for the camera."""
    shift = 6.0
    config = {"sky": "open", "navigation": {"source": "offset", "offset_ct_m": shift}, "lane_sensor": {
        "offset_sigma_m": 0.0, "offset_bias_sigma_m": 0.0, "heading_sigma_deg": 0.0, "heading_bias_sigma_deg": 0.0,
        "availability": 1.0}}  # fmt: skip
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", config))) as env:
        reader, checked = Reader(env.config.observation), set()
        for seed in range(1, 9):
            observation, _ = env.reset(seed=seed)
            for _ in range(4):
                observation, *_ = env.step(DEFER)
            place = ROADS.index(env.world.vehicle.lane_index[0][0])
            tolled = ROADS.index(env.world.tolled[0][0][0])
            y = np.cumsum([0.0, *roads_apart(0, 0)])
            away = np.abs(y - y[place] - shift)
            found = [float(reader.value(observation, f"road.toll_{name}")) for name in ("distance", "free_distance")]
            wanted = [away[tolled], np.delete(away, tolled).min()]
            np.testing.assert_allclose(found, np.minimum(wanted, 50.0), atol=0.02)
            checked.add((place, tolled))
        assert len(checked) > 2


@pytest.mark.parametrize(
    ("inside", "tolled_m", "free_m", "share", "margin_m", "wanted"),
    [
        (True, 1.0, 16.0, 1.0, 9.0, CHARGE),
        (True, 16.0, 1.0, 0.0, 9.0, SPARE),
        (True, 1.0, 16.0, 1.0, 17.0, DEFER),  # both are possible
        (True, 12.0, 10.0, 0.0, 9.0, SPARE),  # the nearest one is always possible
        (True, 10.0, 12.0, 0.0, 9.0, CHARGE),
        (False, 1.0, 16.0, 1.0, 17.0, SPARE),  # not sure: no charge
        (True, 1.0, 16.0, 1.0, 0.0, DEFER),  # without a margin: all positions
        (False, 16.0, 1.0, 0.6, 0.0, CHARGE),
        (False, 1.0, 16.0, 0.5, 0.0, SPARE),
    ],
)
def test_a_claim_follows_from_the_links_that_are_possible(
    inside: bool, tolled_m: float, free_m: float, share: float, margin_m: float, wanted: int
) -> None:
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", GIVEN))) as env:
        reader = Reader(env.config.observation)
        observation, _ = env.reset(seed=1)
        names = list(reader.columns)
        road = np.array(observation["road"])
        first = next(k for k, name in enumerate(names) if name.startswith("road."))
        values = {"open": 1.0, "inside": inside, "distance": tolled_m, "free_distance": free_m, "share": share}
        for name, value in values.items():
            column = f"road.toll_{name}"
            road[names.index(column) - first] = value / reader.scale(column)
        seen = {**observation, "road": np.stack([road, road])}
        assert claim(reader, seen, np.array([margin_m, margin_m])).tolist() == [wanted, wanted]
        road[names.index("road.toll_open") - first] = 0.0
        assert int(claim(reader, {**observation, "road": road}, margin_m)) == DEFER


def test_a_position_on_the_other_road_charges_wrongly() -> None:
    """Displaced by the distance of the roads, the nearest link is the wrong one; levels of 0 do not say so."""
    gap = roads_apart(0, 0)[0]
    config = {"sky": "open", "navigation": {"source": "offset", "offset_ct_m": gap}, "world": {"duration": 18.0}}
    outcomes = set()
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", config))) as env:
        act = make_agent("nominal", env)
        for seed in range(1, 12):
            observation, _ = env.reset(seed=seed)
            if env.world.vehicle.lane_index[0] != "a0":
                continue
            over, costs = False, np.zeros(2)
            while not over:
                observation, _, terminated, over, info = env.step(int(act.predict(observation)[0]))
                costs += info["cost_overcharge"], info["cost_undercharge"]
                over = over or terminated
            tolled = env.world.tolled[0][0][0]
            assert costs.tolist() == [float(tolled == "b"), float(tolled == "a")]
            outcomes.add(tolled)
    assert len(outcomes) > 1


@pytest.mark.parametrize(
    "config",
    [
        {"navigator": "services/spp", "lane_sensor": {"availability": 0.7, "dropout_s": 0.5}},
        {"navigation": {"source": "offset", "offset_ct_m": 21.5}, "observation": {"integrity": "oracle"}},
    ],
    ids=["sensed", "given"],
)
def test_the_engine_decides_as_single_environments_do(config: dict[str, Any]) -> None:
    tally = Tally()
    single, engine = pair("Tolling", {**config, "world": {"duration": 40.0}}, 2)
    for seed in (3, 4):
        drive(single, engine, seed, tally, row=seed % 2)
    require_equal(tally, 1)
    assert tally.steps > 80


def test_only_an_open_object_can_be_decided() -> None:
    """Masks of a single environment, and the same of the engine."""
    env = gymnasium.make("lanebound/Tolling-v0", config=GIVEN)
    envs = gymnasium.make_vec("lanebound/Tolling-v0", 2, config=GIVEN)
    env.reset(seed=5)
    envs.reset(seed=5)
    undecided = decided = 0
    for step in range(40):
        mask = env.unwrapped.action_masks()  # type: ignore[attr-defined]
        np.testing.assert_array_equal(envs.unwrapped.action_masks()[0], mask)  # type: ignore[attr-defined]
        assert mask.tolist() in ([True, True, True], [True, False, False])
        undecided, decided = undecided + mask[1], decided + ~mask[1]
        code = CHARGE if step == 6 else DEFER
        env.step(code)
        envs.step(np.full(2, code))
    assert undecided > 5
    assert decided > 5
    env.close()
    envs.close()


def test_all_drivers_may_decide_on_one_drive() -> None:
    """The table of results has what a drive with the claims of the driver costs and earns."""
    config, episodes = {"sky": "open", "navigator": "services/spp"}, 4
    row = decided("Tolling", config, {"aware": ("integrity_aware", None)}, episodes, 1000)["aware"]
    costs, returns = np.zeros(episodes), np.zeros(episodes)
    for d in drives("Tolling", config, "integrity_aware", None, episodes, 1000):
        np.add.at(costs, d.episode, d.infos["cost"])
        np.add.at(returns, d.episode, d.rewards)
    assert row.costs == costs.tolist()
    assert row.returns == returns.tolist()
    assert 0.0 < costs.sum() < row.due


@pytest.mark.slow
def test_who_claims_without_looking_does_not_keep_the_limits() -> None:
    agents = {"sound": ("integrity_aware", None)}
    agents |= {f"always_{code}": ("constant", {"claim": code}) for code in (DEFER, CHARGE, SPARE)}  # type: ignore[dict-item]
    sound, *others = decided("Tolling", {}, agents, 24, 10_000).values()
    assert all(row.kept <= 0.5 * sound.kept for row in others)
    assert all(np.mean(row.returns) < np.mean(sound.returns) for row in others)
    assert sound.over == 0


def test_several_processes_decide_as_one() -> None:
    make = partial(gymnasium.make_vec, "lanebound/Tolling-v0", 3, config=GIVEN)
    one, two = make(), make(processes=2)
    with closing(one), closing(two):
        seen = [envs.reset(seed=5)[0] for envs in (one, two)]
        one.action_space.seed(6)
        for _ in range(30):
            action = one.action_space.sample()
            steps = [envs.step(action) for envs in (one, two)]
            seen = [step[0] for step in steps]
            assert all(np.array_equal(seen[0][group], seen[1][group]) for group in seen[0])
            np.testing.assert_array_equal(steps[0][1], steps[1][1])
            masks = [envs.unwrapped.action_masks() for envs in (one, two)]  # type: ignore[attr-defined]
            np.testing.assert_array_equal(*masks)


def test_a_learner_takes_the_masks() -> None:
    env = EngineVecEnv("lanebound/Tolling-v0", 2, {**GIVEN, "observation": {"form": "flat"}})
    model = MaskablePPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu")
    assert model.learn(32).num_timesteps == 32
    env.close()


def test_keys_charge() -> None:
    with closing(DrivingEnv(make_config("lanebound/Tolling-v0", GIVEN))) as env:
        keys = KeyboardDriver(env)
        found = []
        for key in (None, Key.UP, Key.DOWN, Key.LEFT):
            if key is not None:
                keys.press(key)
            found.append(keys.act(None))
            keys.reset()
        assert found == [DEFER, CHARGE, SPARE, DEFER]


def test_it_is_an_id_as_the_others() -> None:
    assert full_id("tolling") == "lanebound/Tolling-v0"
    env = gymnasium.make("lanebound/Tolling-v0", config=GIVEN, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=True)
    first, _ = env.reset(seed=7)
    again, _ = env.reset(seed=7)
    assert all(np.array_equal(first[group], again[group]) for group in first)
    assert env.action_space.n == 3  # type: ignore[attr-defined]
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.std() > 0.0
    env.close()


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"observation\.tolls"):
        make_config("lanebound/Tolling-v0", {"lane_sensor": None})
    with (
        closing(DrivingEnv(make_config("lanebound/Tolling-v0", GIVEN))) as env,
        pytest.raises(InputError, match="claims"),
    ):
        RuleBook(env)
