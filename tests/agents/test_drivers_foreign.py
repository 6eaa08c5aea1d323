"""Agents from elsewhere: checkpoints, networks, callables; and what is said where they do not fit."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import bad_agents
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.wrappers import NormalizeObservation, RescaleAction
from stable_baselines3 import A2C, DQN, PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from typer.testing import CliRunner

from lanebound.agents.benchmark import SuiteConfig
from lanebound.agents.benchmark.work import BenchmarkPlan
from lanebound.agents.cli import app
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import in_a_row
from lanebound.agents.drivers.foreign import require_foreign
from lanebound.agents.drivers.importing import require_importable
from lanebound.agents.drivers.normalization import NORMALIZATION
from lanebound.agents.drivers.origin import add_text, name_inputs
from lanebound.agents.episodes import open_env
from lanebound.agents.learning.training import one_thread
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.errors import InputError

GIVEN = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
FLAT = {"observation": {"form": "flat"}}


@pytest.fixture(scope="module")
def steered() -> DrivingEnv:
    return open_env("LaneKeeping", GIVEN)


@pytest.fixture(scope="module")
def meta() -> DrivingEnv:
    return open_env("UrbanCanyon", GIVEN | FLAT)


@pytest.mark.parametrize(
    ("kind", "policy"), [(PPO, "MultiInputPolicy"), (A2C, "MultiInputPolicy"), (SAC, "MultiInputPolicy")]
)
def test_checkpoints_of_stable_baselines_drive(steered, tmp_path, kind, policy):
    torch.manual_seed(1)
    small: dict[str, Any] = {"policy_kwargs": {"net_arch": [8]}, "device": "cpu"}
    model = kind(policy, steered, **small | ({"buffer_size": 10} if kind is SAC else {}))
    model.save(tmp_path / "model.zip")
    agent = make_agent(str(tmp_path / "model.zip"), steered)
    observation = steered.observation_space.sample()
    assert type(agent) is kind
    np.testing.assert_array_equal(
        agent.predict(observation, deterministic=True)[0], model.predict(observation, deterministic=True)[0]
    )


def test_a_checkpoint_whose_actions_were_rescaled_is_refused(steered, tmp_path):
    path = str(tmp_path / "half.zip")
    rescaled = RescaleAction(steered, np.float32(0.0), np.float32(1.0))
    PPO("MultiInputPolicy", rescaled, policy_kwargs={"net_arch": [8]}, device="cpu").save(path)
    with pytest.raises(InputError, match=r"half\.zip must give actions in \[-1, 1\], got a policy for \[0, 1\]: "):
        make_agent(path, steered)


def test_a_checkpoint_for_meta_actions_and_flat_observations(meta, steered, tmp_path):
    path = str(tmp_path / "model.zip")
    DQN("MlpPolicy", meta, policy_kwargs={"net_arch": [8]}, buffer_size=10, device="cpu").save(path)
    assert make_agent(path, meta).predict(meta.observation_space.sample())[0] in range(5)
    other = open_env("LaneKeeping", GIVEN | {"action": "meta", "observation": {"vehicles": 3}})
    with pytest.raises(InputError, match=r"must be trained on these observations, Box .*, got Box .*: choose the"):
        make_agent(path, other)
    with pytest.raises(InputError, match=r"must be trained on these actions, Box .* got Discrete\(5\): choose the"):
        make_agent(path, steered)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.zip", "agent must be a file that exists, got nowhere.zip: correct the path"),
        ("broken.zip", "agent must be a checkpoint of stable-baselines3, got broken.zip"),
        ("net.onnx", "an ONNX agent needs the package onnxruntime, got none: pip install onnxruntime"),
        ("nowhere_at_all:make", "agent 'nowhere_at_all:make' must name a module that can be imported"),
        (
            "bad_agents:np",
            "must name a callable of bad_agents, got 'np', which is not there: known are AFTER, Any, Bad",
        ),
        ("bad_agents:nobody", "must name a callable of bad_agents, got 'nobody', which is not there: "),
        ("bad_agents:not_callable", "must name a callable of bad_agents, got 5"),
        ("bad_agents:nothing", "must return an object with predict or a function, got 5"),
        ("bad_agents:takes_nothing", "must be callable with the environment, got takes_nothing() -> 'Any' (too many "),
    ],
)
def test_what_cannot_drive_is_refused(steered, tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    (tmp_path / "broken.zip").write_bytes(b"no archive")
    (tmp_path / "net.onnx").touch()
    with pytest.raises(InputError) as refusal:
        make_agent(name, steered)
    assert message in str(refusal.value)


@pytest.mark.parametrize("keep", [0.5, 1.0])
def test_a_damaged_checkpoint_is_refused_before_anything_drives(meta, tmp_path, keep):
    """Cut short, or with one byte changed in its largest part."""
    path = tmp_path / "model.zip"
    DQN("MlpPolicy", meta, policy_kwargs={"net_arch": [8]}, buffer_size=10, device="cpu").save(str(path))
    require_foreign(str(path))
    data = bytearray(path.read_bytes())
    data[int(0.4 * len(data))] ^= 255
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(InputError, match=r"must be a checkpoint of stable-baselines3, got .*model\.zip \(.*\): save"):
        require_foreign(str(path))


@pytest.mark.parametrize(("policy", "trained"), [("MlpPolicy", 0), ("MultiInputPolicy", 1)])
@pytest.mark.parametrize("history", [1, 3])
def test_a_policy_of_one_form_of_observation_drives_where_it_is_the_other(tmp_path, history, policy, trained):
    given = GIVEN | {"observation": {"history": history}}
    flat, groups = open_env("UrbanCanyon", deep_merge(given, FLAT)), open_env("UrbanCanyon", given)
    path = str(tmp_path / "model.zip")
    PPO(policy, (flat, groups)[trained], policy_kwargs={"net_arch": [8]}, device="cpu").save(path)
    drivers, seen = (make_agent(path, flat), make_agent(path, groups)), (flat.reset(seed=5)[0], groups.reset(seed=5)[0])
    for _ in range(4):
        np.testing.assert_array_equal(in_a_row(seen[1], history), seen[0])
        actions = [int(driver.predict(part, deterministic=True)[0]) for driver, part in zip(drivers, seen, strict=True)]
        assert actions[0] == actions[1]
        seen = (flat.step(actions[0])[0], groups.step(actions[0])[0])
    for form in (FLAT, {}):
        other = open_env("UrbanCanyon", deep_merge(GIVEN | {"observation": {"vehicles": 3}}, form))
        with pytest.raises(InputError, match="must be trained on these observations"):
            make_agent(path, other)


def _trained(path: Path, form: dict[str, Any], policy: str, **normal: Any) -> tuple[Any, VecNormalize, DrivingEnv]:
    """A PPO after some steps under ``VecNormalize``, its checkpoint at a path."""
    single = open_env("LaneKeeping", deep_merge(GIVEN, form))
    envs = VecNormalize(DummyVecEnv([lambda: single]), **normal)
    with one_thread():
        small: dict[str, Any] = {"policy_kwargs": {"net_arch": [8]}, "n_steps": 8, "batch_size": 8, "n_epochs": 1}
        model = PPO(policy, envs, seed=1, device="cpu", **small)  # its last observation lies outside the bounds
        model.learn(16)
    model.save(path)
    return model, envs, single


@pytest.mark.parametrize(("form", "policy"), [(FLAT, "MlpPolicy"), ({}, "MultiInputPolicy")])
@pytest.mark.parametrize("keys", [None, ["ego"]], ids=["all", "one group"])
def test_a_policy_of_normalized_observations_drives_with_their_statistics_alone(tmp_path, form, policy, keys):
    if keys and form:
        return  # flat observations have no groups
    path = tmp_path / "model.zip"
    model, envs, single = _trained(path, form, policy, norm_obs_keys=keys)
    with pytest.raises(InputError, match=r"must hold the statistics of its normalized .*: call .*name_inputs"):
        make_agent(str(path), single)
    config = single.config.observation
    with pytest.raises(InputError, match="normalize must be the VecNormalize of the training, got <"):
        name_inputs(path, config, "lanebound/LaneKeeping-v0", normalize=envs.venv)
    name_inputs(path, config, "lanebound/LaneKeeping-v0", normalize=envs)
    other = open_env("LaneKeeping", deep_merge(GIVEN, {} if form else FLAT))
    here, there = make_agent(str(path), single), make_agent(str(path), other)
    seen, elsewhere = single.reset(seed=5)[0], other.reset(seed=5)[0]
    raw = 0
    for _ in range(5):
        wanted = model.predict(envs.normalize_obs(seen), deterministic=True)[0]
        np.testing.assert_array_equal(here.predict(seen)[0], wanted)
        np.testing.assert_array_equal(there.predict(elsewhere)[0], wanted)
        raw += not np.array_equal(model.predict(seen, deterministic=True)[0], wanted)
        seen, elsewhere = single.step(wanted)[0], other.step(wanted)[0]
    assert raw == 5


def test_rewards_alone_may_be_normalized_and_statistics_of_others_are_refused(tmp_path):
    path = tmp_path / "model.zip"
    _, envs, single = _trained(path, FLAT, "MlpPolicy", norm_obs=False)
    assert type(make_agent(str(path), single)) is PPO
    name_inputs(path, single.config.observation, "lanebound/LaneKeeping-v0", normalize=envs)
    assert type(make_agent(str(path), single)) is PPO
    for text in ("{}", '{"mean": {"": [1]}, "variance": {"": [1]}, "epsilon": 0, "limit": 1}', "[]"):
        damaged = tmp_path / f"{len(text)}.zip"
        damaged.write_bytes(path.read_bytes())
        add_text(damaged, NORMALIZATION, text)
        with pytest.raises(InputError, match=r"lanebound\.normalization of agent .* must be statistics of its obs"):
            make_agent(str(damaged), single)


def test_normalization_is_not_seen_where_the_last_observation_was_not_saved(tmp_path):
    """A limit that docs/training.md names."""
    path, again = tmp_path / "model.zip", tmp_path / "again.zip"
    model, envs, single = _trained(path, FLAT, "MlpPolicy")
    PPO.load(path).save(again)
    with pytest.raises(InputError, match="must hold the statistics"):
        make_agent(str(again), single)
    PPO.load(path, env=envs).save(again)
    assert type(make_agent(str(again), single)) is PPO
    model.save(again, exclude=["_last_obs"])
    assert type(make_agent(str(again), single)) is PPO


def test_a_policy_of_observations_without_bounds_is_refused(tmp_path):
    single = open_env("LaneKeeping", GIVEN | FLAT)
    model = PPO("MlpPolicy", NormalizeObservation(single), policy_kwargs={"net_arch": [8]}, device="cpu")
    model.save(tmp_path / "model.zip")
    with pytest.raises(InputError, match="must hold the statistics of its normalized observations, got none"):
        make_agent(str(tmp_path / "model.zip"), single)


class Session:
    """Stands for a network."""

    def __init__(self, inputs: list[str], answer: Any, wide: int | None = None) -> None:
        self.inputs, self.answer, self.wide = inputs, answer, wide
        self.given: dict[str, Any] = {}
        self.metadata: dict[str, str] = {}

    def get_inputs(self) -> list[Any]:
        return [type("Input", (), {"name": name, "shape": [None, self.wide]}) for name in self.inputs]

    def get_outputs(self) -> list[Any]:
        shape = [None, *np.shape(self.answer)[1:]]
        kind = "int64" if np.asarray(self.answer).dtype.kind == "i" else "float"
        return [type("Output", (), {"name": "action", "shape": shape, "type": f"tensor({kind})"})]

    def get_modelmeta(self) -> Any:
        return type("Metadata", (), {"custom_metadata_map": self.metadata})

    def run(self, outputs: Any, given: dict[str, Any]) -> list[Any]:
        self.given = given
        return [self.answer]


def onnx(monkeypatch, tmp_path, env: DrivingEnv, session: Session) -> Any:
    """The agent of a network in a file."""
    runtime: Any = ModuleType("onnxruntime")
    runtime.SessionOptions = lambda: type("Options", (), {})()
    runtime.InferenceSession = lambda path, options, providers: session
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    path = tmp_path / "net.onnx"
    path.touch()
    return make_agent(str(path), env)


def test_networks_take_the_groups_and_their_actions_are_clipped(monkeypatch, tmp_path, steered):
    assert isinstance(steered.observation_space, spaces.Dict)
    session = Session(list(steered.observation_space), np.array([[0.5, 7.0]], np.float32))
    agent = onnx(monkeypatch, tmp_path, steered, session)
    observation = steered.observation_space.sample()
    np.testing.assert_array_equal(agent.predict(observation)[0], np.array([0.5, 1.0], np.float32))
    assert all(session.given[name].shape == (1, *observation[name].shape) for name in observation)


def test_of_the_values_of_actions_the_largest_counts(monkeypatch, tmp_path, meta):
    agent = onnx(monkeypatch, tmp_path, meta, Session(["obs"], np.array([[0.0, 1.0, 3.0, 2.0, 1.0]], np.float32)))
    assert agent.predict(meta.observation_space.sample())[0] == 2


def test_a_code_of_an_action_counts_as_it_is(monkeypatch, tmp_path, meta):
    agent = onnx(monkeypatch, tmp_path, meta, Session(["obs"], np.array([3])))
    assert agent.predict(meta.observation_space.sample())[0] == 3


def test_networks_with_other_inputs_are_refused(monkeypatch, tmp_path, steered):
    with pytest.raises(InputError, match=r"an ONNX agent must take ego, .*, or one, got obs, obs2: rename its inputs"):
        onnx(monkeypatch, tmp_path, steered, Session(["obs", "obs2"], None))
    with pytest.raises(InputError, match=r"an ONNX agent must take \d+ numbers here, got 7: choose the environment"):
        onnx(monkeypatch, tmp_path, steered, Session(["obs"], None, 7))


@pytest.mark.parametrize("told", ["{}", "not json", "[1]", '{"columns": 1, "scales": 2, "history": 3}'])
def test_a_network_with_damaged_metadata_is_refused(monkeypatch, tmp_path, steered, told):
    session = Session(["obs"], np.zeros((1, 2), np.float32))
    session.metadata["lanebound.observation"] = told
    with pytest.raises(InputError, match=r"lanebound\.observation of the ONNX agent must be JSON of columns"):
        onnx(monkeypatch, tmp_path, steered, session)


def test_networks_for_other_actions_are_refused(monkeypatch, tmp_path, meta, steered):
    with pytest.raises(InputError, match=r"an ONNX agent must answer with 5 numbers here, got 2: choose the environ"):
        onnx(monkeypatch, tmp_path, meta, Session(["obs"], np.zeros((1, 2), np.float32)))
    with pytest.raises(InputError, match=r"an ONNX agent must answer with 2 numbers here, got 5: choose the environ"):
        onnx(monkeypatch, tmp_path, steered, Session(["obs"], np.zeros((1, 5), np.float32)))


def test_a_network_of_one_input_takes_the_groups_in_a_row(monkeypatch, tmp_path):
    session = Session(["obs"], np.zeros((1, 2), np.float32))
    stacked = GIVEN | {"observation": {"history": 2}}
    flat, groups = open_env("LaneKeeping", deep_merge(stacked, FLAT)), open_env("LaneKeeping", stacked)
    wanted, observation = flat.reset(seed=4)[0], groups.reset(seed=4)[0]
    for _ in range(3):
        onnx(monkeypatch, tmp_path, groups, session).predict(observation)
        np.testing.assert_array_equal(session.given["obs"][0], wanted)
        wanted, observation = (env.step(np.array([0.5, 0.1], np.float32))[0] for env in (flat, groups))


def test_functions_and_objects_from_modules(steered):
    assert isinstance(make_agent("bad_agents:raises", steered), bad_agents.Bad)
    action, state = make_agent("bad_agents:draws", steered).predict(None, state=None)
    assert action.shape == (2,)
    assert state is None


def test_modules_of_the_present_folder_can_be_driven_from_the_command_line(tmp_path, monkeypatch):
    (tmp_path / "my_agent.py").write_text(
        "import numpy as np\ndef make(env):\n    return lambda observation: np.zeros(2, np.float32)\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    told = CliRunner().invoke(
        app,
        ["drive", "LaneKeeping", "--sky", "open", "--set", "navigation.source=perfect", "--set", "duration_s=1",
         "--agent", "my_agent:make", "--json"],
    )  # fmt: skip
    assert told.exit_code == 0, told.output


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """Modules that cannot be imported, and one that can."""
    (tmp_path / "spelt_wrong.py").write_text("def make(env)\n    return None\n", encoding="utf-8")
    (tmp_path / "lacking.py").write_text("import no_such_module_here\ndef make(env): ...\n", encoding="utf-8")
    (tmp_path / "leaving.py").write_text("import os\nos._exit(3)\ndef make(env): ...\n", encoding="utf-8")
    (tmp_path / "sound_agent.py").write_text("print('hello')\ndef make(env): ...\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("broken")
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("spelt_wrong", r"SyntaxError: .*spelt_wrong\.py, line 1"),
        ("lacking", r"ModuleNotFoundError: No module named 'no_such_module_here' \(.*lacking\.py, line 1\)"),
        ("leaving", "a process that ends with code 3"),
    ],
)
def test_modules_that_cannot_be_imported_are_refused_before_a_benchmark(name, why, tmp_path):
    suite = SuiteConfig.load({"envs": ["Merge"], "agents": ["nominal", {"mine": f"{name}:make"}]})
    with pytest.raises(InputError, match=rf"^agent '{name}:make' must be in a module that can be imported, got {why}"):
        BenchmarkPlan.of(suite, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("broken")
def test_modules_are_tried_in_another_process(tmp_path, capfd):
    require_importable("sound_agent:make")
    assert "sound_agent" not in sys.modules
    assert capfd.readouterr().out == ""


def test_a_dot_in_place_of_a_colon_is_told():
    with pytest.raises(InputError, match=r"agent 'my_agent\.make' is unknown: write 'my_agent:make' for a callable"):
        make_agent("my_agent.make", open_env("Merge"))
