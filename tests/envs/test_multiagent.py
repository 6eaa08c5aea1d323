"""The platoon with several agents: PettingZoo's own tests, and that one agent alone is Platoon-v0 to the bit."""

from __future__ import annotations

import subprocess
import sys
import warnings
from typing import Any

import numpy as np
import pytest

from lanebound.agents.drivers import make_agent
from lanebound.envs import DrivingEnv, make_config
from lanebound.integrity.core.errors import ConfigError, InputError

pettingzoo = pytest.importorskip("pettingzoo")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # its tests import worlds of its own the old way
    from pettingzoo.test import parallel_api_test, parallel_seed_test

from lanebound.envs.multiagent import PlatoonAgents, parallel_env  # noqa: E402

ID = "lanebound/Platoon-v0"
OPEN: dict[str, Any] = {"sky": "open"}
SURE = {"v2v": {"loss": 0.0, "latency_s": 0.0, "jitter_s": 0.0}}


def loop_of(env: PlatoonAgents) -> Any:
    return env._cars.belief_loop


def commands(env: PlatoonAgents, value: Any) -> dict[str, Any]:
    return {agent: np.array(value, np.float32) for agent in env.agents}


def flat(observation: dict[str, Any]) -> Any:
    return np.concatenate(list(observation.values()))


@pytest.mark.parametrize("config", [{**OPEN, "duration_s": 6.0}, {"duration_s": 3.0, "world": {"vehicles": 8}}])
def test_it_passes_the_tests_of_pettingzoo(config: dict[str, Any]) -> None:
    parallel_api_test(parallel_env(config), num_cycles=60)
    parallel_seed_test(lambda: parallel_env(config), num_cycles=20)


@pytest.mark.parametrize(
    "config",
    [
        {},
        {"sky": "urban", "faults": "stress", "perception": {"source": "both"}, "world": {"vehicles": 4, "place": 2}},
        {**OPEN, "perception": {"source": "both"}, "observation": {"form": "flat", "history": 2}},
        {**OPEN, "navigation": {"source": "perfect"}, "world": {"vehicles": 8, "place": 8}},
        {**OPEN, "perception": {"wrong_share": 0.5}, "faults": "nominal"},
    ],
)
def test_the_ego_alone_as_agent_is_platoon_to_the_bit(config: dict[str, Any]) -> None:
    single = DrivingEnv(make_config(ID, config))
    env, agent = parallel_env(config, agents=[single.world.place]), f"vehicle_{single.world.place}"
    driver = make_agent("nominal", single)
    for seed in (3, None):  # the second episode goes on from where the generators are
        observation, info = single.reset(seed=seed)
        observations, infos = env.reset(seed=seed)
        start, state = np.ones(1, dtype=np.bool_), None
        for _ in range(25):
            assert repr(observation) == repr(observations[agent])
            assert repr(info) == repr(infos[agent])
            action, state = driver.predict(observation, state=state, episode_start=start)
            observation, *told, info = single.step(action)
            observations, *of_all, infos = env.step({agent: action})
            assert told == [each[agent] for each in of_all]
            start = np.zeros(1, dtype=np.bool_)
            if told[1] or told[2]:
                break
        assert repr(observation) == repr(observations[agent])
        assert env.agents == ([] if told[1] or told[2] else [agent])


def test_the_same_seed_gives_the_same_bits_and_another_one_others() -> None:
    frames = []
    for seed in (5, 5, 6):
        env = parallel_env()
        env.reset(seed=seed)
        rng, seen = np.random.default_rng(0), []
        for _ in range(15):
            steering = 0.05 * rng.standard_normal()
            observations, rewards, *_, infos = env.step(commands(env, [0.1, steering]))
            seen.append([*map(flat, observations.values()), [*rewards.values(), *(i["cost"] for i in infos.values())]])
        frames.append(np.concatenate([np.concatenate(one) for one in seen]))
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


def test_each_agent_sees_itself_where_it_is_and_broadcasts_what_it_believes() -> None:
    env = parallel_env({**OPEN, "perception": SURE})
    _, infos = env.reset(seed=1)
    for _ in range(5):
        *_, infos = env.step(commands(env, [0.0, 0.0]))
    loop, episodes = loop_of(env), loop_of(env).episodes
    spoken = episodes.perception.pictures.spoken
    position = loop.solution.position_en_m
    shifts = []
    for row, car in enumerate(loop.cars):
        own = episodes.cars[row]
        assert (own["x"][0], own["y"][0]) == tuple(car.position)
        assert {(x, y) for x, y in zip(own["x"], own["y"], strict=True)} == {tuple(c.position) for c in loop.cars}
        others = [k for k in range(5) if k != row]
        for slot, other in enumerate(others):
            said = spoken[row, slot]
            assert (said["x_m"], -said["y_m"]) == (position[other, 0], position[other, 1])
        belief = episodes.ego["belief"][row]
        shifts.append((belief["x_m"] - position[row, 0], belief["y_m"] + position[row, 1]))
        error = np.hypot(belief["x_m"] - car.position[0], belief["y_m"] - car.position[1])
        agent = env.possible_agents[[*env._rows.values()].index(row)]
        assert np.hypot(infos[agent]["err_at_m"], infos[agent]["err_ct_m"]) == pytest.approx(error, abs=0.02)
    assert np.abs(shifts).max() < 0.03 * 5.0  # 5 sigma of the map of each
    assert len({shift for shift in shifts}) == 5


def test_agents_that_crash_leave_and_the_others_go_on() -> None:
    env = parallel_env({**OPEN, "duration_s": 12.0})
    env.reset(seed=2)
    ended: dict[str, bool] = {}
    while env.agents:
        before = list(env.agents)
        actions = commands(env, [0.0, 0.0])
        for agent in env.agents:
            if agent == "vehicle_4":
                actions[agent] = np.array([1.0, 0.0], np.float32)
        observations, rewards, terminations, truncations, infos = env.step(actions)
        for found in (observations, rewards, terminations, truncations, infos):
            assert list(found) == before
        ended |= {agent: infos[agent]["crashed"] for agent in before if terminations[agent]}
        assert env.agents == [a for a in before if not (terminations[a] or truncations[a])]
        if {"vehicle_3", "vehicle_4"} <= set(ended):
            break
    assert ended["vehicle_3"]
    assert ended["vehicle_4"]
    assert "vehicle_1" in env.agents
    wreck = loop_of(env).cars[env._rows["vehicle_4"]]
    speed = abs(wreck.speed)
    for _ in range(10):
        env.step(commands(env, [0.0, 0.0]))
    assert abs(wreck.speed) < 0.2 * speed  # a wreck brakes with 1 / s of its speed: e^-2


def test_the_first_drives_at_the_commanded_speed_whatever_its_agent_commands() -> None:
    env = parallel_env({**OPEN})
    env.reset(seed=7)
    loop = loop_of(env)
    first, speeds = loop.cars[1], loop._speeds_mps[1]
    off = []
    for n in range(1, 12):
        env.step(commands(env, [1.0 if n % 2 else -1.0, 0.0]))
        if "vehicle_1" not in env.agents:
            break
        off.append(first.speed - speeds[4 * n])
    assert len(off) > 4
    assert np.abs(off).max() < 1.5  # 0.25 s of 6 m/s2


def test_without_the_first_as_agent_it_is_the_leader_of_platoon() -> None:
    env = parallel_env({**OPEN}, agents=[2, 3, 4, 5])
    env.reset(seed=7)
    first = loop_of(env).cars[1]
    assert env.agents == ["vehicle_2", "vehicle_3", "vehicle_4", "vehicle_5"]
    for n in range(1, 4):
        env.step(commands(env, [0.0, 0.0]))
        assert first.speed == pytest.approx(first.profile_mps[4 * n], abs=1e-12)


def test_one_fault_is_told_to_all_and_faults_may_be_given() -> None:
    env = parallel_env({**OPEN, "faults": "one"})
    _, infos = env.reset(seed=1)
    assert len({(info["fault_kind"], info["fault_onset_s"]) for info in infos.values()}) == 1
    env = parallel_env({**OPEN, "perception": SURE})
    lie = {"kind": "v2v_lie", "vehicle": 1, "duration_s": 60.0, "magnitude_m": 10.0, "azimuth_deg": 90.0}
    env.reset(seed=1, options={"faults": [lie], "another": 1})
    env.step(commands(env, [0.0, 0.0]))
    loop = loop_of(env)
    navigation = loop.episodes.navigation
    assert navigation.lies.shape == (5, 4, 4)
    told = np.hypot(*np.moveaxis(navigation.lies[..., :2], -1, 0))
    liar = np.array([[other == 1 for other in range(5) if other != row] for row in range(5)])
    assert np.array_equal(told > 1.0, liar)


def test_drivers_of_their_own_bring_all_through() -> None:
    config = {**OPEN, "duration_s": 40.0}
    env, single = parallel_env(config), DrivingEnv(make_config(ID, config))
    observations, infos = env.reset(seed=11)
    drivers = {agent: make_agent("nominal", single) for agent in env.agents}
    states: dict[str, Any] = dict.fromkeys(drivers)
    start, over = np.ones(1, dtype=np.bool_), {}
    while env.agents:
        actions = {}
        for agent in env.agents:
            actions[agent], states[agent] = drivers[agent].predict(
                observations[agent], state=states[agent], episode_start=start
            )
        start = np.zeros(1, dtype=np.bool_)
        observations, _, terminations, over, infos = env.step(actions)
        assert not any(terminations.values())
    assert all(over.values())
    assert all(infos[f"vehicle_{place}"]["is_success"] for place in (2, 3, 4, 5))


def test_pictures_are_of_the_ego_of_platoon() -> None:
    env = parallel_env({**OPEN}, render_mode="rgb_array")
    env.reset(seed=1)
    env.step(commands(env, [0.0, 0.0]))
    assert env.render().shape == (540, 960, 3)
    env.close()


@pytest.mark.parametrize("agents", [[1, 2], [3, 6], [], [0, 3]])
def test_places_that_do_not_exist_or_leave_out_the_ego_are_refused(agents: list[int]) -> None:
    with pytest.raises(InputError, match="agents must be places from 1 to 5, 3 among them"):
        parallel_env(OPEN, agents=agents)


@pytest.mark.parametrize(
    ("config", "name"),
    [
        ({"action": "meta"}, "action must be 'continuous'"),
        ({"perception": {"others": "surrogate"}}, r"perception\.others must be 'full'"),
        ({"slots": 3}, "slots must be 4 or more"),
    ],
)
def test_what_several_agents_cannot_have_is_refused(config: dict[str, Any], name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        parallel_env({**OPEN, **config})


def test_commands_are_needed_of_all_and_in_their_space() -> None:
    env = parallel_env({**OPEN}, agents=[2, 3])
    with pytest.raises(InputError, match="reset"):
        env.step({})
    env.reset(seed=1)
    with pytest.raises(InputError, match="actions must have one of each agent, got none of vehicle_2"):
        env.step({"vehicle_3": np.zeros(2, np.float32)})
    with pytest.raises(InputError, match="action must"):
        env.step(commands(env, [2.0, 0.0]))


def test_the_environments_do_not_import_pettingzoo() -> None:
    code = "import sys, lanebound.envs, lanebound.envs.fleet; sys.exit('pettingzoo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_without_pettingzoo_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "lanebound.envs.multiagent")
    with pytest.raises(InputError, match=r"pip install 'lanebound\[multiagent\]'"):
        import lanebound.envs.multiagent  # noqa: F401
