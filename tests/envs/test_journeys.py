"""Journeys: where the answer is known, under equal seeds, with masks, without leaks, and by their statistics."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from scipy.stats import binom
from stable_baselines3.common.env_checker import check_env as check_sb3
from two_routes import EAST, OPEN_M, TUNNEL_M, WEST, place_at, two_routes

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.drivers.journeys import JOURNEY_DRIVERS
from lanebound.agents.learning.journeys import JourneyVecEnv
from lanebound.agents.learning.ppo_lagrangian import PPOLagrangian
from lanebound.envs.journeys import engine, full
from lanebound.envs.journeys import town as towns
from lanebound.envs.journeys.config import JourneyConfig
from lanebound.envs.journeys.engine import Journeys, columns
from lanebound.envs.journeys.env import Journey, VectorJourney
from lanebound.envs.journeys.full import FullDrive
from lanebound.envs.journeys.records import MOST_STREETS
from lanebound.envs.journeys.town import TownHour
from lanebound.envs.registration import JOURNEY_ID
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.journeys.planner import GAPS_S, WEIGHT
from lanebound.integrity.sky.journeys.realised import GAP_EDGES_S, RUN_EDGES, packaged_law

CONFIG: dict[str, Any] = {"cities": {"count": 1}, "hours": [3.0, 15.0]}


@pytest.fixture(autouse=True)
def small_city(monkeypatch: pytest.MonkeyPatch) -> None:
    """The city of two routes in place of generated ones."""
    monkeypatch.setattr(
        engine, "city_hours", lambda sky, errors, seed, hours: two_routes(dark=True) if seed else two_routes()
    )


def entry(config: JourneyConfig, observation: Any, name: str) -> Any:
    """An entry of observations by its name."""
    return observation[..., columns(config).index(name)]


def from_west_to_east(count: int, config: dict[str, Any] | None = None) -> Journeys:
    """Journeys across the city, at the first hour."""
    journeys = Journeys(JourneyConfig.load(CONFIG | (config or {})), count)
    for row in range(count):
        journeys.seed(row, row)
    journeys.begin(range(count))
    town = two_routes()[0].town
    journeys.state["origin"], journeys.state["goal"] = place_at(town, WEST), place_at(town, EAST)
    journeys.state["hour"] = np.minimum(journeys.state["hour"], 0)
    return journeys


def driven(journeys: Journeys, name: str) -> Any:
    """The state after a journey under a driver."""
    driver = JOURNEY_DRIVERS[name](journeys, journeys.config)
    while journeys.running.any():
        journeys.step(driver.act(journeys.observe()), journeys.running)
    return journeys.state


# Where the answer is known


@pytest.mark.parametrize(
    ("name", "length_m"),
    [("shortest", TUNNEL_M), ("fastest", TUNNEL_M), ("integrity_aware", OPEN_M), ("chance_constrained", OPEN_M),
     ("oracle", OPEN_M)],
)  # fmt: skip
def test_drivers_take_the_way_that_is_known_to_be_best(name: str, length_m: float) -> None:
    state = driven(from_west_to_east(3), name)
    assert state["arrived"].all()
    if name == "chance_constrained":  # it may go on by the other side of a block
        assert (state["length_m"] > OPEN_M + 298.0).all()
    else:
        np.testing.assert_allclose(state["length_m"], length_m + 300.0, atol=2.0)  # with half a block at both ends
    lost = state["unusable_s"].mean()
    assert lost > 25.0 if length_m == TUNNEL_M else lost < 25.0


def test_an_oracle_knows_the_true_city_and_the_map_does_not() -> None:
    mapped, true = two_routes(dark=True)[0].mapped, two_routes(dark=True)[0].oracle
    light = mapped.ahead["lost_s"][:, 0] < 5.0
    assert light.sum() > 30
    assert (true.ahead["lost_s"][light, 0] > mapped.ahead["lost_s"][light, 0]).all()


def test_a_tunnel_has_no_rtk_and_time_and_energy_are_those_of_its_length() -> None:
    journeys = from_west_to_east(1)
    state = driven(journeys, "shortest")
    speed, length = 10.0, float(state["length_m"][0])
    turns = 2 * 1.0127  # bends of a right angle
    assert state["time_s"][0] == pytest.approx(length / speed + turns + 0.5 * speed / 1.5 + 0.5 * speed / 2.0, abs=0.1)
    force = 1500.0 * 9.81 * 0.01 + 0.5 * 1.2 * 0.65 * speed**2
    assert state["energy_kwh"][0] == pytest.approx(length * force / 0.9 / 3.6e6)


def ways(at: TownHour, edge: int, goals: Sequence[int], seen: frozenset[int] = frozenset()) -> Iterator[list[int]]:
    """All ways from an edge to one of some, which use no edge twice."""
    if edge in goals:
        yield [edge]
        return
    for onward in at.town.edges["options"][edge]:
        if onward >= 0 and onward not in seen:
            for rest in ways(at, int(onward), goals, seen | {int(onward)}):
                yield [edge, *rest]


def cost_of(at: TownHour, way: Sequence[int], g: int) -> tuple[float, float, float]:
    """Time, expected time without a position and length after the first edge, left with a class of gaps."""
    edges, ahead = at.town.edges, at.mapped.ahead
    time = lost = length = 0.0
    for a, b in pairwise(way):
        turn = float(edges["turn_s"][a][list(edges["options"][a]).index(b)])
        time += turn + edges["length_m"][b] / edges["limit_mps"][b]
        lost += turn * ahead["risk"][b, g] + ahead["lost_s"][b, g]
        length += edges["length_m"][b]
        g = int(ahead["leaves"][b, g])
    return time, lost, length


def test_the_rest_of_the_routes_is_the_best_of_all_ways() -> None:
    at, journeys = two_routes()[0], from_west_to_east(1)
    seen = journeys.observe()[0]
    goals = at.town.goals[journeys.state["goal"][0]].tolist()
    for k, edge in enumerate(at.town.origins[journeys.state["origin"][0]].tolist()):
        if edge < 0:
            continue
        g = int(at.mapped.ahead["leaves"][edge, 0])
        every = [cost_of(at, way, g) for way in ways(at, edge, goals)]
        assert len(every) > 3
        for name, weights in (("aware", (1.0, WEIGHT, 0.0)), ("fast", (1.0, 0.0, 0.0)), ("short", (0.0, 0.0, 1.0))):
            best = min(np.dot(weights, one) for one in every)
            scales = {"time": 600.0, "unusable": 600.0, "length": 5000.0}
            own = [scales[n] * entry(journeys.config, seen, f"street{k}_{name}_{n}") for n in scales]
            assert np.dot(weights, own) == pytest.approx(best, rel=1e-5)


# The realised course


def test_the_course_is_that_of_a_plain_chain_with_the_same_draws() -> None:
    at, journeys = two_routes()[0], from_west_to_east(20)
    begun = journeys.state.copy()
    action = np.flatnonzero(journeys.masks()[0])[0]
    options = at.town.origins[begun["origin"][0]]
    streets, goals = [int(options[action])], at.town.goals[begun["goal"][0]].tolist()
    while streets[-1] not in goals and (at.town.edges["options"][streets[-1]] >= 0).sum() == 1:
        streets.append(int(at.town.edges["options"][streets[-1]].max()))
    journeys.step(np.full(20, action), np.ones(20, dtype=np.bool_))
    table = packaged_law().bridged_table()
    for row in range(20):
        rng = named_generator(row, "realised")
        free, held = at.stations["rtk_after"][at.town.edges["first"][streets[0]], :, -1]
        rtk, usable, runs = int(rng.random() * (1.0 + free - held) < free), 1, [9, 9]
        gap = lost = time = 0.0
        for n, street in enumerate(streets):
            edge = at.town.edges[street]
            before = at.town.edges[streets[n - 1]]
            turn = 0.5 * 10.0 / 1.5 if n == 0 else before["turn_s"][list(before["options"]).index(street)]
            for s in range(edge["first"], edge["last"]):
                station = at.stations[s]
                stay = station["part_m"] / 10.0 + (turn if s == edge["first"] else 0.0)
                gap += 0.5 * stay
                now = int(rng.random() < station["rtk_after"][rtk, np.searchsorted(RUN_EDGES, runs[0])])
                runs[0] = runs[0] + 1 if now == rtk else 1
                rtk, run = now, np.searchsorted(RUN_EDGES, runs[1])
                gap = 0.0 if rtk else gap
                bridged = table[usable, run, station["satellites"], np.searchsorted(GAP_EDGES_S, gap)]
                now = int(rng.random() < (station["usable_after"][usable, run] if rtk else bridged))
                runs[1] = runs[1] + 1 if now == usable else 1
                usable = now
                lost, time, gap = lost + (0.0 if usable else stay), time + stay, gap + 0.5 * stay
        own = journeys.state[row]
        assert (own["rtk"], own["usable"]) == (rtk, usable)
        np.testing.assert_allclose([own["unusable_s"], own["time_s"], own["gap_s"]], [lost, time, gap], rtol=1e-12)


def test_shares_of_a_chain_without_memory_are_binomial() -> None:
    at, count, chance = two_routes()[0], 500, 0.3
    kept = at.stations.copy()
    try:
        at.stations["rtk_after"], at.stations["usable_after"] = 1.0, chance
        state = driven(from_west_to_east(count), "fastest")
    finally:
        at.stations[:] = kept
    stations = TUNNEL_M / 10.0 + 300.0 / 10.0
    low, high = binom.ppf([5e-4, 1.0 - 5e-4], int(count * stations), 1.0 - chance)  # fails by chance once in 1000 runs
    share = state["unusable_s"].sum() / state["time_s"].sum()
    assert 0.98 * low < share * count * stations < 1.02 * high  # turns make the time of a station uneven
    assert np.unique(state["unusable_s"]).size > 50


def test_levels_lie_in_the_quantiles_of_their_state() -> None:
    state = driven(from_west_to_east(300), "fastest")
    law = packaged_law()
    for own in state:
        assert own["level_m"] in law.levels[own["rtk"], own["usable"]]


def observed(count: int, hours: tuple[TownHour, ...], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any, set[int]]:
    """All observations under the fastest driver in a city, those with its true sky, and the streets driven."""
    with monkeypatch.context() as patch:
        patch.setattr(engine, "city_hours", lambda sky, errors, seed, of: hours)
        journeys = from_west_to_east(count)
    journeys.traced = True
    driver, seen, true = JOURNEY_DRIVERS["fastest"](journeys, journeys.config), [], []
    while journeys.running.any():
        seen.append(journeys.observe())
        true.append(journeys.oracle_observation())
        journeys.step(driver.act(seen[-1]), journeys.running)
    return np.array([*seen, journeys.observe()]), np.array(true), {k for way in journeys.ways for k in way}


def test_the_truth_of_streets_that_are_not_driven_is_in_no_observation(monkeypatch: pytest.MonkeyPatch) -> None:
    light, dark = two_routes()[0], two_routes(dark=True)[0]
    seen, true, driven_streets = observed(20, (light,) * 2, monkeypatch)
    edges, of_way = light.town.edges, np.zeros(light.stations.size, dtype=np.bool_)
    for k in driven_streets:
        of_way[edges["first"][k] : edges["last"][k]] = True
    assert of_way.any()
    assert not of_way.all()
    other = replace(dark, stations=np.where(of_way, light.stations, dark.stations))
    assert (other.stations != light.stations).any()
    again, dark_true, _ = observed(20, (other,) * 2, monkeypatch)
    np.testing.assert_array_equal(again, seen)
    assert (dark_true != true).any()
    of_dark = observed(20, (dark,) * 2, monkeypatch)[0]  # the truth of streets that are driven is met
    assert of_dark.shape != seen.shape or (of_dark != seen).any()


def test_the_truth_is_not_in_the_observation_before_the_first_street() -> None:
    light, dark = (Journeys(JourneyConfig.load(CONFIG | {"cities": {"count": 2}}), 8) for _ in range(2))
    for journeys, city in ((light, 0), (dark, 1)):
        for row in range(8):
            journeys.seed(row, row)
        journeys.begin(range(8), city)
    np.testing.assert_array_equal(light.observe(), dark.observe())
    assert (light.oracle_observation() != dark.oracle_observation()).any()
    for name, none in (("rtk", 0.0), ("usable", 0.0), ("level", 1.0)):  # the navigator has not started
        assert (entry(light.config, light.observe(), name) == none).all()
    first = light.masks().argmax(1)
    met = [one.step(first, np.ones(8, dtype=np.bool_)) for one in (light, dark)]
    assert met[1].unusable_s.sum() > met[0].unusable_s.sum()


def test_the_first_level_is_drawn_without_what_was_before() -> None:
    both = [from_west_to_east(20) for _ in range(2)]
    both[1].state["score"] = 1e9
    for journeys in both:
        journeys.step(journeys.masks().argmax(1), journeys.running)
    np.testing.assert_array_equal(both[0].state, both[1].state)
    both[1].state["score"] = 1e9  # from then on it is correlated
    for journeys in both:
        journeys.step(journeys.masks().argmax(1), journeys.running)
    assert (both[0].state["score"] != both[1].state["score"]).all()


# Cities


def test_a_city_is_built_once_while_it_is_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[int] = []

    def counted(sky: str, errors: Any, seed: int, hours: Any) -> tuple[TownHour, ...]:
        built.append(seed)
        return two_routes()

    monkeypatch.setattr(engine, "city_hours", counted)
    journeys = Journeys(JourneyConfig.load(CONFIG | {"cities": {"count": 100}}), 200)
    for row in range(200):
        journeys.seed(row, row)
    journeys.begin(range(200))
    cities = set(journeys.state["host"].tolist())
    assert len(cities) > 64
    assert sorted(built) == sorted(cities)
    for _ in range(3):
        journeys.step(journeys.masks().argmax(1), journeys.running)
        journeys.observe()
    assert len(built) == len(cities)
    journeys.begin(range(200), 3)
    assert list(journeys._cities) == [3]  # what is not in use is not held


def test_a_true_sky_is_made_once_while_a_journey_holds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    of = full.SkyMask.of_stations

    def counted(*of_sky: Any) -> Any:
        made.append(1)
        return of(*of_sky)

    monkeypatch.setattr(full.SkyMask, "of_stations", staticmethod(counted))
    own = replace(two_routes()[0], town=replace(two_routes()[0].town))
    first = FullDrive(own, 0, 60.0, engine.MOVES)
    full._sky_of.cache_clear()  # as if others had been in use since
    second = FullDrive(own, 1, 60.0, engine.MOVES)
    assert first._mask is second._mask
    del first, second
    full._sky_of.cache_clear()
    gc.collect()
    FullDrive(own, 2, 60.0, engine.MOVES)
    assert len(made) == 2


def test_rays_on_disk_are_those_of_the_same_stations_and_solids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cast: list[int] = []
    of = towns.SkyAlong.of

    def counted(stations: Any, city: Any) -> Any:
        cast.append(len(city))
        return of(stations, city)

    monkeypatch.setattr(towns, "folder", lambda name: tmp_path)
    monkeypatch.setattr(towns.SkyAlong, "of", staticmethod(counted))
    own, other = two_routes()[0].town, two_routes(dark=True)[0].town
    first = own.hours(own.true, (3.0,), kept=True)[0]
    assert len(cast) == 2
    again = own.hours(own.true, (3.0,), kept=True)[0]
    assert len(cast) == 2
    np.testing.assert_array_equal(again.stations, first.stations)
    other.hours(own.true, (3.0,), kept=True)  # the same map, another truth
    moved = replace(own.stations, place_en_m=own.stations.place_en_m + 1.0)
    replace(own, stations=moved).hours(own.true, (3.0,), kept=True)
    assert len(cast) == 6
    for file in tmp_path.glob("*.npz"):
        with np.load(file) as data:
            np.savez(file, **{**data, "shape": data["shape"] - [1, 0, 0]})
    own.hours(own.true, (3.0,), kept=True)
    assert len(cast) == 8


# Gymnasium


def test_a_learner_takes_the_limit_of_the_environment() -> None:
    env = JourneyVecEnv(2, CONFIG | {"cost_limit": 12.5})
    model = PPOLagrangian("MlpPolicy", env, device="cpu", n_steps=8, batch_size=16, n_epochs=1)
    model.learn(16)
    assert model.constraints.limits == [12.5]


def test_checkers_of_gymnasium_and_stable_baselines_accept_it() -> None:
    for config in (CONFIG, CONFIG | {"departure": "choose"}, CONFIG | {"speed_classes": [0.6, 1.0]}):
        env = gymnasium.make(JOURNEY_ID, config=config, render_mode="rgb_array")
        check_env(env.unwrapped)
        check_sb3(env)
    assert env.render().shape == (600, 600, 3)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("more", [{}, {"departure": "choose", "speed_classes": [0.5, 1.0]}])
def test_single_and_vector_environments_have_the_same_bits(mode: AutoresetMode, more: dict[str, Any]) -> None:
    envs, singles = VectorJourney(3, CONFIG | more, mode), [Journey(CONFIG | more) for _ in range(3)]
    observed, infos = envs.reset(seed=7)
    over = np.zeros(3, dtype=np.bool_)
    for row, env in enumerate(singles):
        np.testing.assert_array_equal(env.reset(seed=7 + row)[0], observed[row])
    envs.action_space.seed(1)
    ended = 0
    for _ in range(80):
        actions = envs.action_space.sample()
        observed, rewards, terminated, truncated, infos = envs.step(actions)
        for row, env in enumerate(singles):
            if over[row] and mode is AutoresetMode.NEXT_STEP:
                own, reward, done, info = env.reset()[0], 0.0, False, {}
            else:
                own, reward, done, cut, info = env.step(actions[row])
                done |= cut
                if done and mode is AutoresetMode.SAME_STEP:
                    np.testing.assert_array_equal(infos["final_obs"][row], own)
                    for name in ("time_s", "cost", "is_success", "unusable_s", "invalid_action"):
                        assert infos["final_info"][name][row] == info[name]
                        assert infos["final_info"][f"_{name}"][row]
                    assert infos["final_info"]["rewards"]["time"][row] == info["rewards"]["time"]
                    own, info = env.reset()
                    for name in ("time_s", "cost", "is_success", "unusable_s", "invalid_action", "city"):
                        assert infos[name][row] == info[name]
                    assert infos["rewards"]["time"][row] == 0.0
                elif not done:
                    assert infos["unusable_s"][row] == info["unusable_s"]
                    assert infos["cost"][row] == info["cost"]
                    if "final_info" in infos:
                        assert not infos["_final_info"][row]
                        assert not infos["final_info"]["_cost"][row]
            np.testing.assert_array_equal(own, observed[row])
            assert rewards[row] == reward
            assert done == (terminated[row] | truncated[row])
            over[row] = done
            ended += done
    assert ended > 5


def test_gymnasium_makes_the_vector_environment() -> None:
    envs = gymnasium.make_vec(JOURNEY_ID, 2, config=CONFIG)
    assert isinstance(envs, VectorJourney)
    observations, infos = envs.reset(seed=np.int64(3))
    assert observations.shape == envs.observation_space.shape
    assert infos["cost"].shape == infos["_cost"].shape == (2,)
    envs.close()


def test_rewards_and_costs_are_sums_of_what_is_met() -> None:
    env = Journey(CONFIG | {"reward": {"unusable": 3.0}})
    driver = JOURNEY_DRIVERS["integrity_aware"](env, env.config)
    observation, _ = env.reset(seed=3)
    total = cost = 0.0
    over = False
    while not over:
        observation, reward, over, cut, info = env.step(driver.act(observation))
        total, cost = total + reward, cost + info["cost"]
        assert not cut
    assert info["is_success"]
    assert cost == pytest.approx(info["unusable_s"])
    assert total == pytest.approx(-(info["time_s"] + 3.0 * cost) / 60.0 - 1.2 * info["energy_kwh"])


def test_masks_lead_into_streets_and_other_actions_take_the_nearest_one() -> None:
    env, twin = Journey(CONFIG), Journey(CONFIG)
    _, info = env.reset(seed=5)
    twin.reset(seed=5)
    rng, replaced, ended = np.random.default_rng(0), 0, 0
    while ended < 3:
        mask = info["action_mask"]
        np.testing.assert_array_equal(mask, env.action_masks())
        exists = [entry(env.config, env.journeys.observe()[0], f"street{k}_exists") for k in range(MOST_STREETS)]
        np.testing.assert_array_equal(mask, np.array(exists) == 1.0)
        action = int(rng.integers(MOST_STREETS))
        nearest = min(np.flatnonzero(mask).tolist(), key=lambda k: (abs(k - action), k))
        observation, reward, over, cut, info = env.step(action)
        assert info["invalid_action"] == (action != nearest)
        replaced += action != nearest
        expected, own, *_ = twin.step(nearest)
        np.testing.assert_array_equal(observation, expected)
        assert reward == own
        if over or cut:
            ended += 1
            if ended < 3:
                _, info = env.reset()
                twin.reset()
    assert replaced > 5
    with pytest.raises(InputError, match="reset"):
        env.step(0)


def test_turns_are_numbered_from_left_to_right() -> None:
    edges = two_routes()[0].town.edges
    for own in edges:
        there = [k for k in own["options"].tolist() if k >= 0]
        turned = (edges["away_rad"][there] - own["azimuth_rad"] + np.pi) % (2.0 * np.pi)
        assert (np.diff(turned) > 0.0).all()


def test_the_first_action_chooses_the_hour_of_departure() -> None:
    env = Journey(CONFIG | {"departure": "choose"})
    observation, info = env.reset(seed=2)
    assert info["action_mask"].tolist() == [False] * MOST_STREETS + [True, True]
    assert np.isnan(info["hour"])
    assert entry(env.config, observation, "departing") == 1.0
    times = [entry(env.config, observation, f"hour{k}_time") for k in range(2)]
    assert min(times) > 0.0
    observation, reward, _, _, info = env.step(MOST_STREETS + 1)
    assert (info["hour"], reward, info["cost"]) == (15.0, 0.0, 0.0)
    assert entry(env.config, observation, "departing") == 0.0
    assert info["action_mask"][:MOST_STREETS].any()
    assert not info["action_mask"][MOST_STREETS:].any()


def test_a_slower_class_takes_longer_and_less_energy() -> None:
    both = [from_west_to_east(1, {"speed_classes": [0.5, 1.0]}) for _ in range(2)]
    for pace, journeys in enumerate(both):
        first = int(journeys.masks()[0].argmax())
        journeys.step(np.array([[first, pace]]), np.ones(1, dtype=np.bool_))
    slow, fast = (journeys.state[0] for journeys in both)
    assert slow["length_m"] == fast["length_m"]
    assert slow["time_s"] > 1.5 * fast["time_s"]
    assert slow["energy_kwh"] < fast["energy_kwh"]


def test_a_journey_without_an_end_is_cut() -> None:
    env = Journey(CONFIG | {"duration_s": 60.0})
    env.reset(seed=0)
    rng, cut, over = np.random.default_rng(0), False, False
    ends = []
    while len(ends) < 20:
        _, _, over, cut, info = env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
        if over or cut:
            ends.append(cut)
            assert cut == (not info["is_success"])
            env.reset()
    assert any(ends)


@pytest.mark.parametrize(
    ("config", "match"),
    [({"hours": []}, "hours"), ({"hours": [24.0]}, "hours"), ({"hours": [1.0, 1.0]}, "hours"),
     ({"speed_classes": [1.5]}, "speed_classes"), ({"cities": {"vary": True}}, "vary"), ({"hour": 3}, "hour"),
     ({"realised": "slow"}, "realised"), ({"cities": {"split": "test", "count": 101}}, "count")],
)  # fmt: skip
def test_a_configuration_that_is_wrong_is_refused(config: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        Journey(config)


def test_input_that_is_wrong_is_refused() -> None:
    env = Journey(CONFIG)
    for options in ({"town": 1}, {"city": 1}, {"city": "0"}):
        with pytest.raises(InputError, match="options"):
            env.reset(seed=0, options=options)
    env.reset(seed=0)
    for action in (4, -1, 1.5, [0]):
        with pytest.raises(InputError, match="actions"):
            env.step(action)
    with pytest.raises(InputError, match="render_mode"):
        Journey(CONFIG, render_mode="human")
    with pytest.raises(InputError, match="config"):
        Journey(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="num_envs"):
        VectorJourney(0)
    with pytest.raises(InputError, match="reset"):
        VectorJourney(2, CONFIG).step(np.zeros(2, dtype=np.int64))
    envs = VectorJourney(2, CONFIG, AutoresetMode.DISABLED)
    with pytest.raises(InputError, match="seed"):
        envs.reset(seed=[1, 2, 3])
    envs.reset(seed=0)
    envs.journeys._running[0] = False
    with pytest.raises(InputError, match="reset_mask"):
        envs.step(np.zeros(2, dtype=np.int64))
    envs.reset(options={"reset_mask": np.array([True, False])})
    envs.step(np.zeros(2, dtype=np.int64))


# The whole navigator


def test_the_navigator_drives_the_same_decisions() -> None:
    found = {}
    for name in ("shortest", "integrity_aware"):
        journeys = from_west_to_east(1, {"realised": "full"})
        state = driven(journeys, name)
        assert state["arrived"][0] == 1
        found[name] = state[0]
    short, aware = found["shortest"], found["integrity_aware"]
    assert short["length_m"] == pytest.approx(TUNNEL_M + 300.0, abs=2.0)
    assert aware["length_m"] == pytest.approx(OPEN_M + 300.0, abs=2.0)
    assert short["unusable_s"] > aware["unusable_s"] + 15.0
    for own in found.values():
        planned = own["length_m"] / 10.0
        assert planned < own["time_s"] < planned + 25.0


def test_the_car_does_not_jump_where_a_street_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[Any] = []
    step = FullDrive._step

    def spied(self: FullDrive, way: Any, a: int, b: int, epoch: int) -> Any:
        places.append((way.place_en_m[a], way.place_en_m[b], way.speed_mps[a], way.speed_mps[b]))
        return step(self, way, a, b, epoch)

    monkeypatch.setattr(FullDrive, "_step", spied)
    state = driven(from_west_to_east(1, {"realised": "full"}), "integrity_aware")
    before, after, v0, v1 = map(np.array, zip(*places, strict=True))
    np.testing.assert_allclose(before[1:], after[:-1], atol=0.05)  # the way that is longer goes through the same places
    np.testing.assert_allclose(v0[1:], v1[:-1], atol=0.1)
    assert len(places) == 200 + round(float(state["time_s"][0]) / 0.1)
    np.testing.assert_allclose(np.linalg.norm(after - before, axis=1), 0.05 * (v0 + v1), atol=0.05)


def test_both_engines_count_a_street_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    entered: list[Any] = []
    enter = FullDrive._enter

    def spied(self: FullDrive, journey: Any) -> None:
        before, last = journey.copy(), self._edges[self._entered - 1] if self._entered else -1
        enter(self, journey)
        entered.append((before, last, self._edges[self._entered - 1], journey.copy()))

    monkeypatch.setattr(FullDrive, "_enter", spied)
    state = driven(from_west_to_east(1, {"realised": "full"}), "shortest")
    at, fast = two_routes()[0], from_west_to_east(1)
    assert entered[-1][3]["predicted_s"] == state["predicted_s"][0]
    alone = 0
    for before, last, street, after in entered[1:]:
        fast.state[0] = before
        fast.state["edge"], fast.state["arrived"], fast._running[:] = last, 0, True
        choice = at.town.edges["options"][last].tolist().index(street)
        if fast._streets(0, at, choice) != [street]:
            continue
        fast.step(np.array([choice]), np.ones(1, dtype=np.bool_))
        for name in ("predicted_s", "length_m", "energy_kwh"):
            assert fast.state[name][0] == pytest.approx(after[name], rel=1e-12)
        alone += before["gap_s"] > 0.0
    assert alone > 0


def test_a_slow_journey_of_the_navigator_is_cut_before_its_sky_ends() -> None:
    journeys = from_west_to_east(1, {"realised": "full", "speed_classes": [0.2], "duration_s": 80.0})
    driver = JOURNEY_DRIVERS["shortest"](journeys, journeys.config)
    while journeys.running.any():
        found = journeys.step(driver.act(journeys.observe()), journeys.running)
    assert found.late[0]
    assert not found.arrived[0]
    assert journeys.state["time_s"][0] == pytest.approx(200.0, abs=0.15)  # in the tunnel of 400 m, at 2 m/s
    assert journeys.state["length_m"][0] < TUNNEL_M + 300.0


def test_journeys_of_the_navigator_are_the_same_again() -> None:
    runs = [driven(from_west_to_east(2, {"realised": "full"}), "shortest").copy() for _ in range(2)]
    np.testing.assert_array_equal(runs[0], runs[1])


def test_classes_of_gaps_and_of_the_table_are_ascending() -> None:
    assert np.all(np.diff(GAPS_S) > 0.0)
    assert np.all(np.diff(GAP_EDGES_S) > 0.0)
