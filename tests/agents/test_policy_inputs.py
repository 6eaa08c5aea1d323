"""Policies select their observation entries by name: new entries, another order or another form change no action."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from stable_baselines3 import PPO

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.foreign import SelectingDriver
from lanebound.agents.drivers.inputs import INPUTS, PolicyInputs
from lanebound.agents.drivers.learnt import policies
from lanebound.agents.drivers.origin import name_inputs
from lanebound.agents.episodes import open_env
from lanebound.envs.core import DrivingEnv
from lanebound.envs.observation import Entry, ObservationConfig, entries, register_entry, withdraw_entry
from lanebound.envs.registration import IDS
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.errors import InputError

GIVEN = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
MIDDLE = Entry("plugin_speed", "ego", "m/s", 7.0, -1.0, 1.0, "speed", "belief.speed_mps")
END = Entry("plugin_lane", "traffic", "m", 3.0, 0.0, 1.0, "width of the lane", "belief.lane_width_m")
FORMS: Any = ({"observation": {"form": "flat"}}, {})


@pytest.fixture
def more_entries() -> None:
    """One entry more in the middle of the index and one at its end."""
    for entry in (MIDDLE, END):
        register_entry(entry)
    columns = [entry.column for entry in entries(ObservationConfig())]
    assert 0 < columns.index(MIDDLE.column) < len(columns) - 1 == columns.index(END.column)


def drive(env: DrivingEnv, agent: str, steps: int) -> list[Any]:
    """Actions of an agent in the first steps of an episode."""
    driver = make_agent(agent, env)
    observation, _ = env.reset(seed=7)
    actions, state = [], None
    for _ in range(steps):
        action, state = driver.predict(observation, state, deterministic=True)
        actions.append(np.asarray(action).tolist())
        observation, *_ = env.step(action)
    env.close()
    return actions


@pytest.fixture(scope="module")
def before() -> dict[str, list[Any]]:
    """Actions of every policy of the package, with the entries of the package alone."""
    return {base: drive(open_env(_id_of(base), {}), "ppo", 3) for base in policies()}


def _id_of(base: str) -> str:
    return next(name for name, preset in IDS.items() if preset["base"] == base)


@pytest.mark.parametrize("form", FORMS, ids=["flat", "dict"])
@pytest.mark.parametrize("base", sorted(policies()))
def test_new_entries_change_no_action_of_a_policy_of_the_package(before, more_entries, base, form):
    env = open_env(_id_of(base), form)
    assert {MIDDLE.column, END.column} < {entry.column for entry in env.observer.index}
    assert drive(env, "ppo", 3) == before[base]


def _ppo(path: Path, env: DrivingEnv, policy: str) -> None:
    torch.manual_seed(1)
    PPO(policy, env, policy_kwargs={"net_arch": [8]}, device="cpu").save(path)


@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize(("form", "policy"), [(FORMS[0], "MlpPolicy"), (FORMS[1], "MultiInputPolicy")])
def test_new_entries_change_no_action_of_a_checkpoint_that_names_its_entries(tmp_path, history, form, policy):
    given = deep_merge(GIVEN, {"observation": {"history": history}})
    env, path = open_env("LaneKeeping", deep_merge(given, form)), tmp_path / "model.zip"
    _ppo(path, env, policy)
    with_names = tmp_path / "named.zip"
    with_names.write_bytes(path.read_bytes())
    name_inputs(with_names, env.config.observation, "lanebound/LaneKeeping-v0")
    wanted = drive(env, str(path), 4)
    assert not isinstance(make_agent(str(with_names), env), SelectingDriver)
    register_entry(MIDDLE)
    for other in FORMS:
        assert drive(open_env("LaneKeeping", deep_merge(given, other)), str(with_names), 4) == wanted
    with pytest.raises(InputError, match="must be trained on these observations"):
        make_agent(str(path), open_env("LaneKeeping", deep_merge(given, form)))


def _network(path: Path, inputs: PolicyInputs, groups: dict[str, int]) -> None:
    """A network ``action = W [inputs]`` with an input for each group."""
    weight = np.random.default_rng(1).normal(size=(inputs.size, 2)).astype(np.float32)
    nodes = [helper.make_node("Concat", list(groups), ["all"], axis=1), helper.make_node("MatMul", ["all", "w"], ["a"])]
    given = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [None, size]) for name, size in groups.items()]
    out = [helper.make_tensor_value_info("a", TensorProto.FLOAT, [None, 2])]
    graph = helper.make_graph(nodes, "policy", given, out, [onnx.numpy_helper.from_array(weight, "w")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 9
    helper.set_model_props(model, {INPUTS: inputs.to_json()})
    onnx.save(model, path)


@pytest.mark.parametrize("named", [True, False])
def test_new_entries_change_no_action_of_a_network(tmp_path, named):
    inputs, path = PolicyInputs.of(ObservationConfig()), str(tmp_path / "net.onnx")
    sizes = inputs.select_from(ObservationConfig(), "it").sizes
    _network(Path(path), inputs, sizes if named else {"observation": inputs.size})
    wanted = drive(open_env("LaneKeeping", GIVEN), path, 3)
    register_entry(MIDDLE)
    for form in FORMS:
        assert drive(open_env("LaneKeeping", deep_merge(GIVEN, form)), path, 3) == wanted


def test_an_order_of_its_own_is_kept_in_batches_and_with_a_history():
    config = ObservationConfig(history=2, vehicles=1)
    columns = [entry.column for entry in entries(config)]
    scales = {entry.column: entry.scale for entry in entries(config)}
    picked = ("traffic.v0_ahead", "ego.speed", "traffic.v0_present")
    inputs = PolicyInputs(picked, tuple(scales[column] for column in picked), 2)
    selection = inputs.select_from(config, "it")
    seen = np.arange(3 * 2 * len(columns), dtype=np.float32).reshape(3, -1)
    places = [columns.index(column) for column in picked]
    np.testing.assert_array_equal(selection.flat(seen), seen[:, [*places, *(len(columns) + p for p in places)]])
    grouped = selection.grouped(seen)
    np.testing.assert_array_equal(grouped["ego"], selection.flat(seen)[:, [1, 4]])
    np.testing.assert_array_equal(grouped["traffic"], selection.flat(seen)[:, [0, 2, 3, 5]])
    assert PolicyInputs.from_json(inputs.to_json(), "it") == inputs


def test_a_missing_entry_is_named(more_entries):
    inputs = PolicyInputs.of(ObservationConfig())
    with pytest.raises(
        InputError,
        match=r"must show the entries that agent a was trained with, got one without 'traffic.v5_present' and 18 more: "
        r"configure 'observation' as in its training, or register the entry$",
    ):
        inputs.select_from(ObservationConfig(vehicles=5), "agent a")
    withdraw_entry(END.column)
    with pytest.raises(InputError, match=r"got one without 'traffic\.plugin_lane': configure"):
        inputs.select_from(ObservationConfig(), "agent a")
    register_entry(END)
    with pytest.raises(InputError, match=r"the scale of 'ego.speed' must be 40, with which agent a was .*, got 20: "):
        inputs.select_from(ObservationConfig(speed_max_mps=20), "agent a")
    with pytest.raises(InputError, match=r"observation\.history must be 1, with which agent a was trained, got 2: "):
        inputs.select_from(ObservationConfig(history=2), "agent a")
