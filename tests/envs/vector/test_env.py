"""The vector environment keeps Gymnasium's contract: it does what Gymnasium's own vector of single ones does."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from highway_env.vehicle.behavior import IDMVehicle

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.envs.ids import META, Preset, register_id
from lanebound.envs.vector.env import (
    VectorCarFollowing,
    VectorDrivingEnv,
    VectorHighway,
    VectorLaneKeeping,
    VectorUrbanCanyon,
)
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.integrity.core.errors import ConfigError, InputError
from side_by_side import PERFECT

SHORT: dict[str, Any] = {**PERFECT, "world": {"vehicles_count": 5}, "duration_s": 2.0}
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


def _both(
    count: int, config: dict[str, Any], mode: AutoresetMode, name: str = "Highway"
) -> tuple[VectorDrivingEnv, SyncVectorEnv]:
    engine = gymnasium.make_vec(
        f"lanebound/{name}-v0",
        count,
        vectorization_mode="vector_entry_point",
        config=config,
        autoreset_mode=mode,
    )
    assert isinstance(engine, VectorDrivingEnv)
    single = [lambda: gymnasium.make(f"lanebound/{name}-v0", config=config) for _ in range(count)]
    return engine, SyncVectorEnv(single, autoreset_mode=mode)


def _same(a: Any, b: Any, where: str = "") -> None:
    """Equal nests of dicts and arrays: the same keys, kinds of numbers and, but for rounding, numbers."""
    if isinstance(b, dict):
        assert set(a) == set(b), where
        for key in b:
            _same(a[key], b[key], f"{where}.{key}")
        return
    assert a.shape == b.shape, where
    if b.dtype == object:
        for x, y in zip(a, b, strict=True):
            assert (x is None) == (y is None), where
            if y is not None:
                _same(x, y, where)
        return
    assert a.dtype == b.dtype, where
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9, err_msg=where)


@pytest.mark.parametrize("form", ["dict", "flat"])
@pytest.mark.parametrize("mode", MODES, ids=lambda m: m.value)
def test_it_does_what_a_vector_of_single_ones_does(mode: AutoresetMode, form: str) -> None:
    history = 1 if mode is AutoresetMode.SAME_STEP else 3
    config = {**SHORT, "observation": {"form": form, "history": history}}
    engine, single = _both(3, config, mode)
    assert engine.metadata["autoreset_mode"] is mode
    assert engine.observation_space == single.observation_space
    assert engine.action_space == single.action_space
    assert engine.single_observation_space == single.single_observation_space
    for ours, theirs in zip(engine.reset(seed=5), single.reset(seed=5), strict=True):
        _same(ours, theirs)
    rng, over = np.random.default_rng(1), np.zeros(3, dtype=np.bool_)
    for step in range(10):
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(InputError, match="must be reset"):
                engine.step(np.ones(3, dtype=np.int64))
            for ours, theirs in zip(
                engine.reset(options={"reset_mask": over}), single.reset(options={"reset_mask": over}), strict=True
            ):
                _same(ours, theirs, f"reset at {step}")
        actions = rng.integers(5, size=3)
        got, wanted = engine.step(actions), single.step(actions)
        for n, (ours, theirs) in enumerate(zip(got, wanted, strict=True)):
            _same(ours, theirs, f"step {step} {n}")
        assert engine.observation_space.contains(got[0])
        over = got[2] | got[3]
    single.close()


def test_the_city_does_what_a_vector_of_single_ones_does() -> None:
    config = {**PERFECT, "duration_s": 2.5, "world": {"vehicles_count": 6, "spread": [-60.0, 90.0]}}
    engine, single = _both(3, config, AutoresetMode.NEXT_STEP, "UrbanCanyon")
    assert isinstance(engine, VectorUrbanCanyon)
    for ours, theirs in zip(engine.reset(seed=5), single.reset(seed=5), strict=True):
        _same(ours, theirs)
    rng, ends = np.random.default_rng(1), 0
    for step in range(10):
        actions = rng.integers(5, size=3)
        got, wanted = engine.step(actions), single.step(actions)
        for n, (ours, theirs) in enumerate(zip(got, wanted, strict=True)):
            _same(ours, theirs, f"step {step} {n}")
        ends += int((got[2] | got[3]).sum())
    assert ends >= 3, "others start anew"
    single.close()


def test_observations_belong_to_the_caller() -> None:
    engine = VectorHighway(2, SHORT)
    first, info = engine.reset(seed=1)
    kept, cost = {g: part.copy() for g, part in first.items()}, info["speed_mps"].copy()
    engine.step(np.array([3, 4]))
    _same(first, kept)
    _same(info["speed_mps"], cost)
    over = np.array([True, False])
    _, info = engine.reset(options={"reset_mask": over})
    over[:] = False
    assert info["_cost"].tolist() == info["rewards"]["_base"].tolist() == [True, False]


def test_seeds_are_those_of_single_ones_and_repeat() -> None:
    a, b = VectorCarFollowing(3, PERFECT), VectorCarFollowing(2, PERFECT)
    first, _ = a.reset(seed=7)
    again, _ = b.reset(seed=[9, 7])
    np.testing.assert_array_equal(first["ego"][2], again["ego"][0])
    np.testing.assert_array_equal(first["road"][0], again["road"][1])
    assert not np.array_equal(a.reset()[0]["road"], first["road"])


def test_a_copy_by_pickle_drives_on() -> None:
    engine = VectorLaneKeeping(2, PERFECT)
    engine.reset(seed=1)
    actions = np.full((2, 2), 0.1, dtype=np.float32)
    engine.step(actions)
    twin = pickle.loads(pickle.dumps(engine))
    for ours, theirs in zip(engine.step(actions), twin.step(actions), strict=True):
        _same(ours, theirs)


def test_many_run_as_few() -> None:
    many, few = VectorHighway(40, SHORT), VectorHighway(3, SHORT)  # 40 are worth threads
    a, _ = many.reset(seed=1)
    b, _ = few.reset(seed=1)
    for step in range(6):
        a = many.step(np.full(40, step % 5))[0]
        b = few.step(np.full(3, step % 5))[0]
    _same({group: part[:3] for group, part in a.items()}, b)


def test_drivers_that_something_has_rewritten_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(IDMVehicle, "COMFORT_ACC_MAX", 6)
    with pytest.raises(ConfigError, match="COMFORT_ACC_MAX must be 3 in the vector engine, got 6: make the engine in"):
        VectorHighway(1, PERFECT)
    VectorUrbanCanyon(1, PERFECT)  # whose drivers have figures of their own
    monkeypatch.setattr(CityDriver, "TIME_WANTED", 1.2)
    with pytest.raises(ConfigError, match=r"CityDriver.TIME_WANTED must be 1 in the vector engine, got 1\.2"):
        VectorUrbanCanyon(1, PERFECT)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world": {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}}, "other_vehicles_type"),
        ({"base": "merge-generic-v0"}, "base"),
        ({"base": "merge-generic-v0", "world": {}}, "sync"),
        ({"slots": 3}, "slots"),
        ({"action": "continuous", "action_options": {"dynamical": True}}, "dynamical"),
        ({"action": "continuous", "action_options": {"type": "DiscreteAction"}}, "action_options.type must be Contin"),
        ({"action_options": {"type": "ContinuousAction"}}, "type must be DiscreteMetaAction with action"),
        ({"action_options": {"target_speeds": [20, 20]}}, "target_speeds must be two or more rising speeds"),
        ({"simulation_hz": 20, "policy_hz": 4, "navigation": {"source": "perfect", "rate_hz": 2.5}}, "policy_hz"),
    ],
)
def test_what_it_cannot_do_is_refused(change: dict[str, Any], message: str) -> None:
    config = {**SHORT, **change}
    if "base" in change:
        config["world"] = {}
    with pytest.raises(ConfigError, match=message):
        VectorHighway(2, config)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"world": {"neighbour_vehicles_connected_lanes": False}},
            "world.neighbour_vehicles_connected_lanes must be True",
        ),
        (
            {"slots": 3},
            "world.vehicles_count must be at most slots = 3 in the vector engine, got 10: change it, or make",
        ),
    ],
)
def test_what_the_city_cannot_do_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        VectorUrbanCanyon(2, {**PERFECT, **change})


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("LaneKeeping", 0.6), ("CarFollowing", 0.6), ("UrbanCanyon", 1.5), ("Racetrack", 0.6), ("Merge", 1.5),
     ("Roundabout", 1.5), ("Intersection", 1.5)],
)  # fmt: skip
def test_the_default_configuration_has_an_engine(name: str, seconds: float) -> None:
    engine = gymnasium.make_vec(f"lanebound/{name}-v0", 2, config={"sky": "open", "duration_s": seconds})
    assert engine.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    engine.reset(seed=3)
    ends = 0
    for _ in range(8):
        seen, rewards, _, truncated, infos = engine.step(np.zeros_like(engine.action_space.sample()))
        assert engine.observation_space.contains(seen)
        assert np.isfinite(rewards).all()
        assert (infos["pl_ct_m"] > 0.0).all()
        ends += int(truncated.sum())
    assert ends == 4, "an episode is three steps and one to start the next"


def test_an_id_without_an_engine_says_so() -> None:
    class LongMerge(Preset):
        PRESET: ClassVar[Mapping[str, Any]] = {"base": "merge-generic-v0", **META}

    register_id(LongMerge)
    with pytest.raises(gymnasium.error.Error, match="vector entry point"):
        gymnasium.make_vec("lanebound/LongMerge-v0", 2, vectorization_mode="vector_entry_point")


@pytest.mark.parametrize(
    "arguments",
    [{"num_envs": 0}, {"num_envs": 2.0}, {"autoreset_mode": "Sometimes"}, {"render_mode": "human"}],
)
def test_arguments_are_checked(arguments: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(arguments))):
        VectorHighway(**{"config": SHORT, **arguments})


def test_commands_and_options_are_checked() -> None:
    engine = VectorHighway(2, SHORT)
    with pytest.raises(InputError, match="reset must come"):
        engine.step(np.zeros(2, dtype=np.int64))
    masks = np.ones(3, dtype=np.bool_), np.zeros(2, np.bool_)
    for wrong in ({"fault": []}, {"faults": {}}, *({"reset_mask": mask} for mask in masks)):
        with pytest.raises(InputError, match="options"):
            engine.reset(options=wrong)
    seeds: tuple[Any, ...] = ([1, 2, 3], [1, -1], -5, 1.5, [1.5, 2], [True, 1], True)
    for seed in seeds:
        with pytest.raises(InputError, match="seed"):
            engine.reset(seed=seed)
    with pytest.raises(InputError, match="leaves out 1: reset all"):
        engine.reset(options={"reset_mask": np.array([True, False])})
    engine.reset(seed=1)
    for actions in (np.zeros(3, dtype=np.int64), np.array([0, 5]), np.array([0.0, 1.0])):
        with pytest.raises(InputError, match="actions"):
            engine.step(actions)
    engine.close()
    with pytest.raises(InputError, match="closed"):
        engine.step(np.zeros(2, dtype=np.int64))


def test_the_wanted_type_of_commands_is_named() -> None:
    steered, chosen = VectorLaneKeeping(2, PERFECT), VectorHighway(2, SHORT)
    steered.reset(seed=1)
    chosen.reset(seed=1)
    with pytest.raises(InputError, match=r"must be float32 numbers of shape \(2, 2\), got float64 \(2,\)"):
        steered.step(np.zeros(2))
    with pytest.raises(InputError, match=r"must be integers of shape \(2,\), got float64 \(2,\)"):
        chosen.step(np.zeros(2))


def test_a_command_that_rounding_puts_beyond_its_bound_is_one_on_the_bound() -> None:
    beyond = np.full((2, 2), 1.0000005, np.float32)
    assert (beyond > 1.0).all()
    rewards = []
    for actions in (beyond, np.ones((2, 2), np.float32), -np.ones((2, 2), np.float32), -beyond):
        engine = VectorLaneKeeping(2, PERFECT)
        engine.reset(seed=1)
        rewards.append(engine.step(actions)[1])
    np.testing.assert_array_equal(rewards[0], rewards[1])
    np.testing.assert_array_equal(rewards[2], rewards[3])
    with pytest.raises(InputError, match=r"actions\[0\] must lie in Box.* clip it"):
        engine.step(np.full((2, 2), 1.00001, np.float32))


def test_who_commands_nonsense_is_named() -> None:
    engine = VectorLaneKeeping(2, PERFECT)
    engine.reset(seed=1)
    with pytest.raises(InputError, match=r"actions\[1\] .* check the policy for NaN"):
        engine.step(np.array([[0.0, 0.0], [np.nan, 0.0]], dtype=np.float32))
    with pytest.raises(InputError, match=r"actions\[0\] .* clip it"):
        engine.step(np.array([[5.0, 0.0], [0.0, 0.0]], dtype=np.float32))
