"""The contract of every id: checkers, spaces, copies, processes, seeds, streams, refusals and random driving."""

from __future__ import annotations

import copy
import functools
import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RescaleAction
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from lanebound.envs import IDS, DrivingEnv, make_config, wrap
from lanebound.envs.batch.streams import COMMON
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import STREAM_NAMES

HIGHWAY, LANE_KEEPING = "lanebound/Highway-v0", "lanebound/LaneKeeping-v0"
FEW: dict[str, dict[str, Any]] = {
    HIGHWAY: {"vehicles_count": 5},
    "lanebound/Intersection-v0": {"initial_vehicle_count": 3, "spawn_probability": 0.2},
    "lanebound/UrbanCanyon-v0": {"vehicles_count": 3},
}
every_id = pytest.mark.parametrize("env_id", IDS)
Step = tuple[Any, float, bool, bool, dict[str, Any]]


def light(env_id: str, **config: Any) -> dict[str, Any]:
    """A configuration with little traffic, under an open sky over one made-up city."""
    return {"sky": "open", "cities": {"count": 1}, "world": FEW.get(env_id, {}), **config}


def rough(env_id: str) -> dict[str, Any]:
    """The same under the worst sky with frequent faults, and with shorter steps to save time."""
    return light(env_id, sky="dense", faults="stress", policy_hz=10)


@functools.cache
def made(env_id: str) -> gym.Env[Any, Any]:
    """An environment that tests share; each of them resets it with a seed."""
    return gym.make(env_id, config=light(env_id))


@functools.cache
def flat(env_id: str) -> gym.Env[Any, Any]:
    """The same with a flat observation, and with shorter steps to save time."""
    return gym.make(env_id, config=light(env_id, observation={"form": "flat"}, policy_hz=10))


def commands(env: gym.Env[Any, Any], n: int, seed: int = 0) -> list[Any]:
    """Random commands."""
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(n)]


def digest(env_id: str, steps: int) -> str:
    """What comes out of a drive, starting again whenever it ends, bit for bit."""
    env = gym.make(f"lanebound.envs:{env_id}", config=rough(env_id))
    observation, info = env.reset(seed=11)
    told = hashlib.blake2b(digest_size=16)
    for action in commands(env, steps):
        for vector in observation.values():
            told.update(vector.tobytes())
        told.update(np.array([info["cost"], info["err_at_m"], info["err_ct_m"], info["pl_ct_m"]]).tobytes())
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            observation, info = env.reset()
    return told.hexdigest()


# Checkers


@pytest.mark.parametrize("making", [made, flat], ids=["dict", "flat"])
@every_id
def test_the_checkers_are_content(env_id: str, making: Any) -> None:
    env = making(env_id).unwrapped
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


def test_the_checker_is_content_with_all_ways_to_render() -> None:
    check_env(gym.make(LANE_KEEPING, render_mode="rgb_array", config=light(LANE_KEEPING)).unwrapped)


@every_id
def test_spaces_are_bounded_and_normalised(env_id: str) -> None:
    env = made(env_id)
    assert isinstance(env.observation_space, gym.spaces.Dict)
    assert set(env.observation_space) == {"ego", "integrity", "road", "traffic"}
    for box in [*env.observation_space.values(), flat(env_id).observation_space]:
        assert isinstance(box, gym.spaces.Box)
        assert box.dtype == np.float32
        assert box.is_bounded("both")
        assert len(box.shape) == 1


@every_id
def test_ways_to_make_it_agree(env_id: str) -> None:
    by_module = gym.make(f"lanebound.envs:{env_id}", config=light(env_id))
    by_class = DrivingEnv(make_config(env_id, light(env_id)))
    assert isinstance(by_module.unwrapped, DrivingEnv)
    assert by_module.unwrapped.config == by_class.config == made(env_id).unwrapped.config  # type: ignore[attr-defined]
    assert by_module.metadata["render_fps"] == by_class.config.policy_hz
    assert by_module.unwrapped.metadata is not DrivingEnv.metadata  # highway-env shares it at class level


@every_id
def test_a_specification_goes_through_json(env_id: str) -> None:
    env = made(env_id)
    spec = EnvSpec.from_json(env.spec.to_json())  # type: ignore[union-attr]
    assert spec == env.spec
    again = gym.make(spec)
    assert again.unwrapped.config == env.unwrapped.config  # type: ignore[attr-defined]
    assert again.observation_space == env.observation_space
    assert again.action_space == env.action_space


# Copies, processes, vectors


@every_id
def test_copies_go_on_as_the_original_does(env_id: str) -> None:
    env = made(env_id)
    env.reset(seed=3)
    actions = commands(env, 8)
    for action in actions[:3]:
        env.step(action)
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for action in actions[3:]:
        said = env.step(action)
        assert [data_equivalence(said, twin.step(action), exact=True) for twin in twins] == [True, True]
        if said[2] or said[3]:
            break
    start = env.reset()
    assert [data_equivalence(start, twin.reset(), exact=True) for twin in twins] == [True, True]


def test_copies_before_the_first_reset_are_possible() -> None:
    fresh = DrivingEnv(make_config(LANE_KEEPING, light(LANE_KEEPING)))
    for twin in (copy.deepcopy(fresh), pickle.loads(pickle.dumps(fresh))):
        assert data_equivalence(fresh.reset(seed=1), twin.reset(seed=1), exact=True)


CHILD = """
import sys, tests_contract as here
for env_id in sys.argv[1:]:
    print(env_id, here.digest(env_id, 20))
"""


def test_same_seed_same_bits_in_other_processes_and_orders() -> None:
    here = {env_id: digest(env_id, 20) for env_id in IDS}
    load = f"import importlib.util as u; s = u.spec_from_file_location('tests_contract', {__file__!r})\n"
    load += "import sys; m = u.module_from_spec(s); sys.modules['tests_contract'] = m; s.loader.exec_module(m)\n"
    command = [sys.executable, "-W", "error", "-c", load + CHILD]
    children = [
        subprocess.Popen(
            [*command, *order], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONHASHSEED": f"{len(order)}"}
        )
        for order in (list(IDS), list(IDS)[:0:-1])
    ]
    told = [child.communicate()[0].split() for child in children]
    assert [child.returncode for child in children] == [0, 0]
    forth, back = (dict(zip(words[::2], words[1::2], strict=True)) for words in told)
    # This process may have compiled the kernels, which rounds some last bits unlike the code that others then load.
    assert set(forth) == set(here)
    assert {env_id: forth[env_id] for env_id in back} == back


def vector_steps(env: gym.vector.VectorEnv[Any, Any, Any], steps: int) -> Iterator[Any]:
    """What a vector of environments says, infos included."""
    env.action_space.seed(2)
    yield env.reset(seed=5)
    for _ in range(steps):
        yield env.step(env.action_space.sample())


@pytest.mark.parametrize("env_id", [LANE_KEEPING, "lanebound/Merge-v0"])
def test_a_vector_says_what_each_of_its_environments_does(env_id: str) -> None:
    vector = gym.make_vec(env_id, num_envs=2, vectorization_mode="sync", config=light(env_id))
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    singles = [made(env_id), gym.make(env_id, config=light(env_id))]
    (observations, infos), *later = vector_steps(vector, 3)
    vector.action_space.seed(2)
    for row, env in enumerate(singles):
        observation, info = env.reset(seed=5 + row)
        assert data_equivalence({k: v[row] for k, v in observations.items()}, observation, exact=True)
        assert infos["cost"][row] == info["cost"]
        np.testing.assert_array_equal(infos["costs"][row], info["costs"])
        assert infos["rewards"]["progress"][row] == info["rewards"]["progress"]
    for observations, rewards, _, _, infos in later:
        for row, (env, action) in enumerate(zip(singles, vector.action_space.sample(), strict=True)):
            observation, reward, *_, info = env.step(action)
            assert data_equivalence({k: v[row] for k, v in observations.items()}, observation, exact=True)
            assert (rewards[row], infos["pl_ct_m"][row]) == (reward, info["pl_ct_m"])
            np.testing.assert_array_equal(infos["costs"][row], info["costs"])
    vector.close()


def test_spawned_processes_say_the_same_as_this_one() -> None:
    ids = [HIGHWAY, "lanebound/Merge-v0"]
    makers = [functools.partial(gym.make, f"lanebound.envs:{env_id}", config=light(env_id)) for env_id in ids]
    spawned = gym.vector.AsyncVectorEnv(makers, context="spawn", shared_memory=True)
    here = gym.vector.SyncVectorEnv(makers)
    for one, two in zip(vector_steps(spawned, 4), vector_steps(here, 4), strict=True):
        assert data_equivalence(one, two, exact=True)
    spawned.close()
    here.close()


# What info holds


def assert_plain(value: Any, path: str = "info") -> None:
    """Python's own types only, as checkers want them, but ``costs`` (C,) float64; no NaN."""
    if type(value) is dict:
        for key, inside in value.items():
            assert type(key) is str
            assert_plain(inside, f"{path}.{key}")
    elif path == "info.costs":
        assert (value.dtype, value.shape) == (np.float64, (len(CAUSES),))
        assert np.isfinite(value).all()
    else:
        assert type(value) in (bool, int, float), f"{path} is a {type(value)}"
        assert value == value, f"{path} is NaN"


def shape_of(info: dict[str, Any]) -> dict[str, Any]:
    """Keys and types."""
    return {key: shape_of(value) if isinstance(value, dict) else type(value) for key, value in info.items()}


@every_id
def test_info_has_the_same_keys_of_plain_types_at_reset_and_every_step(env_id: str) -> None:
    env = made(env_id)
    _, first = env.reset(seed=8)
    assert_plain(first)
    assert {"cost", "cost_lane", "cost_hmi", "margin_at_m", "is_success", "mode", "rewards", "tta_s"} <= set(first)
    assert first["cost"] == 0.0
    for action in commands(env, 15):
        _, reward, terminated, truncated, info = env.step(action)
        assert_plain(info)
        assert shape_of(info) == shape_of(first)
        assert list(info) == list(first)
        assert [type(x) for x in (reward, terminated, truncated)] == [float, bool, bool]
        assert info["margin_ct_m"] == info["al_ct_m"] - info["pl_ct_m"]
        assert info["cost"] >= 0.0
        assert info["costs"].tolist() == [info[cause] for cause in CAUSES]
        if terminated or truncated:
            env.reset()


# Named streams


def drive(env: DrivingEnv, actions: list[Any]) -> list[Step]:
    """Steps to the end of the actions or of the episode."""
    said = []
    for action in actions:
        said.append(env.step(action))
        if said[-1][2] or said[-1][3]:
            break
    return said


def truth_of(env: DrivingEnv) -> list[float]:
    """Where everybody really is."""
    return [x for v in env.world.road.vehicles for x in (*v.position, v.heading, v.speed)]


@pytest.fixture(scope="module")
def midway() -> DrivingEnv:
    """An environment with V2V traffic, somewhere in an episode, not to be driven but copied."""
    env = DrivingEnv(make_config(LANE_KEEPING, light(LANE_KEEPING, base="CarFollowingWorld", action="continuous")))
    env.reset(seed=4)
    drive(env, [np.array([0.0, 0.1], dtype=np.float32)] * 4)
    return env


GENTLE = [np.array([0.0, 0.05], dtype=np.float32)] * 4


def test_a_stream_that_comes_later_moves_nothing(midway: DrivingEnv) -> None:
    plain, other = copy.deepcopy(midway), copy.deepcopy(midway)
    episodes = other.belief_loop.episodes  # type: ignore[union-attr]
    episodes.perception._streams.normal("a sensor added later", 5)
    episodes.navigation._streams.normal("a sensor added later", 5)  # type: ignore[union-attr]
    assert data_equivalence(drive(plain, GENTLE), drive(other, GENTLE), exact=True)


@pytest.mark.parametrize("name", STREAM_NAMES)
def test_draws_of_the_ego_instruments_move_neither_world_nor_others(midway: DrivingEnv, name: str) -> None:
    plain, other = copy.deepcopy(midway), copy.deepcopy(midway)
    streams = other.belief_loop.episodes.navigation._streams  # type: ignore[union-attr]
    streams._drawn(streams, 1, None, name, (5,), True)  # of the ego alone
    before, after = drive(plain, GENTLE), drive(other, GENTLE)
    assert truth_of(plain) == truth_of(other)
    assert plain.world.np_random.bit_generator.state == other.world.np_random.bit_generator.state
    moved = not data_equivalence(before, after, exact=True)
    if name in COMMON:  # which all vehicles of the area share
        # these show outages to come, undifferenced observables and corrections of services alone
        assert moved or name in ("network", "broadcast", "augmentation")
        return
    fleets = [env.belief_loop.solution.position_en_m[1:] for env in (plain, other)]  # type: ignore[union-attr]
    np.testing.assert_array_equal(*fleets)
    assert moved or name not in ("gnss", "imu", "odometer")
    assert not moved or name in ("clock", "gnss", "imu", "odometer", "corrections")


def test_draws_of_the_channel_leave_the_ego_as_it_is(midway: DrivingEnv) -> None:
    plain, other = copy.deepcopy(midway), copy.deepcopy(midway)
    other.belief_loop.episodes.perception._streams.uniform("v2v", 5)  # type: ignore[union-attr]
    for (one, *_, info), (two, *_, same) in zip(drive(plain, GENTLE), drive(other, GENTLE), strict=True):
        assert (info["err_ct_m"], info["pl_ct_m"], info["mode"]) == (same["err_ct_m"], same["pl_ct_m"], same["mode"])
        for group in ("ego", "integrity", "road"):
            np.testing.assert_array_equal(one[group], two[group])


def test_the_world_goes_its_own_way_whatever_the_ego_senses() -> None:
    poses = []
    for config in (
        {},
        {"faults": "stress"},
        {"perception": {"source": "sensor"}},
        {"navigation": {"source": "perfect"}},
    ):
        env = DrivingEnv(make_config("lanebound/CarFollowing-v0", light("lanebound/CarFollowing-v0", **config)))
        env.reset(seed=6)
        drive(env, GENTLE)
        poses.append(truth_of(env))
    assert poses[1:] == poses[:1] * 3


# Refusals


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"ski": "open"}, ["ski", "sky"]),
        ({"sky": "urbn"}, ["sky", "'urbn'", "'urban'"]),
        ({"faults": "stres"}, ["faults", "'stres'", "'stress'"]),
        ({"observation": {"histori": 2}}, ["observation.histori", "'observation.history'"]),
        ({"observation": {"integrity": "oracel"}}, ["observation.integrity", "'oracel'", "'oracle'"]),
        ({"navigation": {"source": "perfct"}}, ["navigation.source", "'perfct'", "'perfect'"]),
        ({"cost": {"hmmi": 1}}, ["cost.hmmi", "'cost.hmi'"]),
        ({"reward": {"progres": 1}}, ["reward.progres", "'reward.progress'"]),
        ({"cost": {"hmi": -1}}, ["cost.hmi", ">= 0", "-1"]),
        ({"policy_hz": 3}, ["policy_hz", "20", "3", "divisor"]),
        ({"simulation_hz": 15, "policy_hz": 2}, ["policy_hz", "15", "2", "divisor"]),
        ({"navigation": {"rate_hz": 7}}, ["navigation.rate_hz", "20", "7", "divisor"]),
        ({"policy_hz": 100}, ["policy_hz", "[1, 50]", "100"]),
        ({"policy_hz": "5"}, ["policy_hz", "'5'", "quotes"]),
    ],
    ids=str,
)
def test_a_configuration_that_cannot_be_is_refused_with_advice(overrides: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as refused:
        gym.make(HIGHWAY, config=overrides)
    assert [word for word in words if word not in str(refused.value)] == []


@pytest.mark.parametrize(
    ("world", "words"),
    [
        ({"vehicle_count": 3}, ["world.vehicle_count", "'vehicles_count'"]),
        ({"policy_frequency": 3}, ["world.policy_frequency", "must not be set"]),
        ({"lanes_count": 0}, ["world.lanes_count", "1 and 20", "got 0"]),
        ({"lanes_count": 1.5}, ["world.lanes_count", "whole", "got 1.5"]),
        ({"vehicles_count": True}, ["world.vehicles_count", "got True"]),
        ({"vehicles_density": 0}, ["world.vehicles_density", "got 0"]),
        ({"vehicles_density": float("nan")}, ["world.vehicles_density", "got nan"]),
        ({"initial_lane_id": 9}, ["world.initial_lane_id", "0 to 3", "got 9"]),
        ({"reward_speed_range": [20, 20]}, ["world.reward_speed_range", "the lower one first", "[20, 20]"]),
    ],
)
def test_a_key_that_the_world_lacks_is_refused_with_advice(world: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as refused:
        gym.make(HIGHWAY, config={"world": world})
    assert [word for word in words if word not in str(refused.value)] == []


@pytest.mark.parametrize(
    ("name", "world", "words"),
    [
        ("Intersection", {"destination": "o7"}, ["world.destination", "o1, o2, o3", "'o7'"]),
        ("Intersection", {"initial_vehicle_count": 2.5}, ["world.initial_vehicle_count", "whole", "2.5"]),
        ("Intersection", {"spawn_probability": 7}, ["world.spawn_probability", "0 and 1", "7"]),
        ("Roundabout", {"incoming_vehicle_destination": 5}, ["world.incoming_vehicle_destination", "0 and 2", "5"]),
        ("CarFollowing", {"time_gap": [3, 0.1]}, ["world.time_gap", "the lower one first"]),
    ],
)
def test_figures_that_a_world_cannot_be_made_of_are_refused(name: str, world: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ConfigError) as refused:
        gym.make(f"lanebound/{name}-v0", config={"world": world})
    assert [word for word in words if word not in str(refused.value)] == []


def test_an_unknown_id_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'lanebound/Higway-v0': did you mean 'lanebound/Highway-v0'"):
        make_config("lanebound/Higway-v0")
    with pytest.raises(InputError, match=r"'LaneKeping': did you mean 'lanebound/LaneKeeping-v0'"):
        make_config("LaneKeping")
    with pytest.raises(gym.error.NameNotFound, match="Highway"):
        gym.make("lanebound/Higway-v0")
    with pytest.raises(ConfigError, match=r"^env_id must be .*'higway-v0': did you mean 'highway-v0'"):
        wrap("higway-v0")
    with pytest.raises(ConfigError, match=r"'LaneKeepngWorld': did you mean 'LaneKeepingWorld'"):
        DrivingEnv({"base": "LaneKeepngWorld"})


@pytest.mark.parametrize("env_id", ["parking-v0", "parking-ActionRepeat-v0", "parking-parked-v0"])
def test_worlds_without_lanes_to_follow_are_refused(env_id: str) -> None:
    with pytest.raises(ConfigError, match="must have lanes to drive along"):
        wrap(env_id)


@pytest.mark.parametrize("env_id", ["LaneKeeping-v0", "lanebound/LaneKeeping-v0"])
def test_ids_that_have_navigation_already_are_not_wrapped(env_id: str) -> None:
    with pytest.raises(ConfigError, match=r"make it with gymnasium\.make\('lanebound/LaneKeeping-v0'\)"):
        wrap(env_id)


def test_a_meta_action_out_of_range_is_refused_with_the_range() -> None:
    env = wrap("two-way-v0", {"sky": "open"})
    env.reset(seed=0)
    for action in (7, 1.0, np.zeros(2)):
        with pytest.raises(InputError, match="action must be an integer from 0 to 4, got"):
            env.step(action)


def test_what_belongs_into_the_configuration_is_told_where_it_goes() -> None:
    with pytest.raises(InputError, match=r"got sky='dense': pass config=\{'sky': 'dense'\}"):
        gym.make(LANE_KEEPING, sky="dense")
    with pytest.raises(InputError, match="got skyy='dense': did you mean 'sky'"):
        gym.make(LANE_KEEPING, skyy="dense")
    with pytest.raises(InputError, match="vector_kwargs"):
        gym.make_vec("lanebound/Merge-v0", 2, vectorization_mode="sync", autoreset_mode="SameStep")
    with pytest.raises(InputError, match=r"got sky='dense': pass config=\{'sky': 'dense'\}"):
        gym.make_vec(LANE_KEEPING, 2, sky="dense")
    with pytest.raises(InputError, match="duration_s"):
        gym.make_vec(LANE_KEEPING, 2, max_episode_steps=10)


def test_a_refusal_names_the_value_that_the_id_presets() -> None:
    with pytest.raises(ConfigError, match=r"cost_limit must be >= 0, got -1: .*\(unchanged it is [0-9.]+\)"):
        make_config(LANE_KEEPING, {"cost_limit": -1})


def test_unknown_options_and_commands_before_the_start_are_refused() -> None:
    env = DrivingEnv(make_config(LANE_KEEPING, light(LANE_KEEPING)))
    with pytest.raises(InputError, match="call reset"):
        env.step(env.action_space.sample())
    with pytest.raises(InputError, match="'fault'"):
        env.reset(seed=1, options={"fault": []})
    with pytest.raises(
        ConfigError, match=r"options\.faults\.0\.kind must be one of .*'spoof': did you mean 'spoofing'"
    ):
        env.reset(seed=1, options={"faults": [{"kind": "spoof"}]})
    with pytest.raises(InputError, match=r"options\.faults must be a list"):
        env.reset(seed=1, options={"faults": {"kind": "spoofing"}})


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"start_s": 60.0}, r"options\.faults\.1\.start_s must be before the end of the episode, 60 s, got 60"),
        ({"vehicle": 1}, r"options\.faults\.1\.vehicle must be below 1, .*, got 1"),
        (
            {"kind": "satellite_range", "system": 0, "prn": 99},
            r"options\.faults\.1\.prn must be .*, got 99: it has 1, ",
        ),
    ],
)
def test_faults_that_cannot_act_are_refused(fault: dict[str, Any], message: str) -> None:
    env = DrivingEnv(make_config(LANE_KEEPING, light(LANE_KEEPING)))
    good = {"kind": "spoofing", "magnitude_m": 3.0, "vehicle": 0}
    with pytest.raises(InputError, match=message):
        env.reset(seed=1, options={"faults": [good, {**good, **fault}]})


def test_faults_are_refused_where_nothing_navigates() -> None:
    env = DrivingEnv(make_config(LANE_KEEPING, light(LANE_KEEPING, navigation={"source": "perfect"})))
    with pytest.raises(InputError, match=r"options\.faults must be left out where nothing navigates"):
        env.reset(seed=1, options={"faults": [{"kind": "spoofing", "magnitude_m": 3.0}]})
    env.reset(seed=1, options={"faults": []})


def test_a_longer_duration_holds_against_that_of_the_world() -> None:
    config = light(LANE_KEEPING, policy_hz=1, navigation={"source": "perfect"}, off_road_ends=False)
    for world_s, duration_s, steps in ((2, 3.0, 3), (4, 3.0, 3), (2, None, 2)):
        env = DrivingEnv(
            make_config(LANE_KEEPING, {**config, "world": {"duration": world_s}, "duration_s": duration_s})
        )
        env.reset(seed=0)
        ends = [env.step(np.zeros(2, np.float32))[3] for _ in range(steps)]
        assert ends == [False] * (steps - 1) + [True], (world_s, duration_s)


@pytest.mark.parametrize("bad", [np.full(2, np.nan, np.float32), np.full(2, 2, np.float32), np.zeros(3, np.float32)])
def test_commands_outside_the_space_are_refused(bad: Any) -> None:
    env = made(LANE_KEEPING)
    env.reset(seed=1)
    with pytest.raises(InputError, match="action"):
        env.step(bad)


def test_a_command_that_rounding_puts_beyond_its_bound_is_one_on_the_bound() -> None:
    low, high = np.float32(1.3696169), np.float32(4.1405053)
    plain, scaled = made(LANE_KEEPING), RescaleAction(made(LANE_KEEPING), low, high)
    assert scaled.func(np.full(2, low)).min() < -1.0  # type: ignore[attr-defined]
    plain.reset(seed=1)
    wanted = plain.step(-np.ones(2, np.float32))
    scaled.reset(seed=1)
    assert data_equivalence(wanted, scaled.step(np.full(2, low)), exact=True)
    plain.step(np.full(2, 1.0000005, np.float32))
    with pytest.raises(InputError, match="clip it"):
        plain.step(np.full(2, 1.00001, np.float32))


# Random driving


def drive_at_random(env_id: str, steps: int) -> None:
    """Every observation in its space, no NaN anywhere, whatever happens."""
    env = gym.make(env_id, config=rough(env_id), disable_env_checker=True)
    observation, info = env.reset(seed=17)
    for action in commands(env, steps, seed=17):
        assert env.observation_space.contains(observation)  # false for NaN
        assert_plain(info)
        observation, reward, terminated, truncated, info = env.step(action)
        assert np.isfinite(float(reward))
        assert np.isfinite(info["cost"])
        if terminated or truncated:
            assert terminated or not info["crashed"]
            observation, info = env.reset()
    assert env.observation_space.contains(observation)


@every_id
def test_random_driving(env_id: str) -> None:
    drive_at_random(env_id, 300)


@pytest.mark.slow
@every_id
def test_random_driving_for_long(env_id: str) -> None:
    drive_at_random(env_id, 10_000)
