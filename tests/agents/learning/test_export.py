"""Networks that are exported answer as the policies do, in a car too; what cannot stand alone is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from experiments import experiment
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize
from typer.testing import CliRunner

from lanebound.agents.benchmark.suite import SuiteConfig
from lanebound.agents.benchmark.work import strangers
from lanebound.agents.cli import app
from lanebound.agents.drivers import learnt, make_agent
from lanebound.agents.drivers.foreign import load_checkpoint
from lanebound.agents.drivers.inputs import PolicyInputs
from lanebound.agents.drivers.origin import elsewhere, experiment_in, inputs_in, name_inputs
from lanebound.agents.episodes import open_env
from lanebound.agents.learning.evaluation import trained
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig
from lanebound.agents.learning.export import export_arrays, export_onnx
from lanebound.agents.learning.training import load_model, train
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.integrity.core.errors import InputError

STILL = {"navigation": {"source": "perfect"}, "duration_s": 4.0}
SETTINGS: dict[str, dict[str, Any]] = {
    "ppo_lagrangian": {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "policy_kwargs": {"log_std_init": 1.0}},
    "sac": {"learning_starts": 20, "buffer_size": 100, "batch_size": 16, "train_freq": 16},
}


def test_a_network_of_a_policy_under_normalization_takes_plain_observations(tmp_path: Path) -> None:
    planned = experiment(env="LaneKeeping", overrides=STILL)
    envs, path = VecNormalize(EngineVecEnv("lanebound/LaneKeeping-v0", 2, planned.env_overrides)), tmp_path / "m.zip"
    model = PPO("MlpPolicy", envs, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs={"net_arch": [8]}, device="cpu")
    model.learn(16).save(path)
    with pytest.raises(InputError, match="must hold the statistics of its normalized observations"):
        export_onnx(path, tmp_path / "net.onnx", "LaneKeeping", {"overrides": STILL})
    name_inputs(path, envs.config.observation, "lanebound/LaneKeeping-v0", normalize=envs)
    network = make_agent(str(export_onnx(path, tmp_path / "net.onnx", changes={"overrides": STILL})), planned.open())
    rng = np.random.default_rng(1)
    for _ in range(20):
        seen = rng.uniform(-1.0, 1.0, model.observation_space.shape).astype(np.float32)
        wanted, _ = model.predict(envs.normalize_obs(seen), deterministic=True)
        np.testing.assert_allclose(network.predict(seen)[0], wanted, atol=2e-5)
    with pytest.raises(InputError, match=r"must see plain observations, got .*: use \.onnx"):
        export_arrays(path, tmp_path / "net.npz", changes={"overrides": STILL})


@pytest.mark.parametrize(
    ("algorithm", "env"), [("ppo_lagrangian", "LaneKeeping"), ("sac", "LaneKeeping"), ("ppo", "UrbanCanyon")]
)
def test_a_network_answers_as_its_policy_does(tmp_path: Path, algorithm: str, env: str) -> None:
    settings = SETTINGS.get(algorithm, SETTINGS["ppo_lagrangian"] | {"policy_kwargs": {}})
    others = "full" if env == "UrbanCanyon" else None
    planned = experiment(algorithm=algorithm, env=env, steps=64, settings=settings, overrides=STILL, others=others)
    train(planned, tmp_path)
    path = export_onnx(tmp_path, tmp_path / "deep" / "net.onnx")
    assert [p.name for p in path.parent.iterdir()] == ["net.onnx"]
    world = planned.open()
    network, policy = make_agent(str(path), world), load_model(tmp_path / "best.zip", Algorithm(algorithm))
    rng = np.random.default_rng(1)
    for _ in range(20):
        seen = rng.uniform(-2.0, 2.0, world.observation_space.shape).astype(np.float32)
        wanted, _ = policy.predict(seen, deterministic=True)
        found, _ = network.predict(seen)
        if isinstance(world.action_space, spaces.Discrete):
            assert int(found) == int(wanted)
        else:
            np.testing.assert_allclose(found, wanted, atol=2e-5)
    with pytest.raises(InputError, match=r"the scale of 'integrity.pl_at' must be 10, with which the ONNX agent was"):
        make_agent(str(path), open_env(env, {"observation": {"form": "flat", "pl_max_m": 5.0}}))
    told = onnx.load(path).metadata_props
    assert {item.key for item in told} == {"lanebound.experiment", "lanebound.observation"}
    assert ExperimentConfig.from_json(next(item.value for item in told if "experiment" in item.key)) == planned


def test_arrays_answer_as_the_policy_does_for_one_and_for_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train(experiment(algorithm="ppo_lagrangian", steps=64, overrides=STILL), tmp_path)
    path = export_arrays(tmp_path, tmp_path / "LaneKeepingWorld.npz")
    monkeypatch.setattr(learnt, "policies", lambda: {"LaneKeepingWorld": path})
    flat, split = (open_env("LaneKeeping", {"observation": {"form": form}}) for form in ("flat", "dict"))
    network, policy = make_agent("ppo", flat), load_model(tmp_path / "best.zip", Algorithm.PPO_LAGRANGIAN)
    seen, same = flat.reset(seed=1)[0], split.reset(seed=1)[0]
    wanted, _ = policy.predict(seen, deterministic=True)
    np.testing.assert_allclose(network.predict(seen)[0], wanted, atol=2e-6)
    np.testing.assert_array_equal(make_agent("ppo", split).predict(same)[0], network.predict(seen)[0])
    many = np.stack([seen, 0.5 * seen])
    np.testing.assert_array_equal(network.predict(many)[0][1], network.predict(0.5 * seen)[0])
    with pytest.raises(InputError, match="was learnt in LaneKeepingWorld, got CarFollowingWorld"):
        make_agent("ppo", open_env("CarFollowing"))
    for other in ({"integrity": "blind"}, {"history": 2}):
        with pytest.raises(InputError, match="configure 'observation' as in its training"):
            make_agent("ppo", open_env("LaneKeeping", {"observation": other}))
    result = CliRunner().invoke(app, ["export", str(tmp_path), "--out", str(tmp_path / "again.npz")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "again.npz").stat().st_size < 200_000


def test_a_squashed_output_is_exported_squashed_and_no_arrays_hold_it(tmp_path: Path) -> None:
    settings = SETTINGS["ppo_lagrangian"] | {"use_sde": True, "policy_kwargs": {"squash_output": True}}
    planned = experiment(algorithm="ppo", steps=64, settings=settings, overrides=STILL)
    train(planned, tmp_path)
    policy: Any = load_model(tmp_path / "best.zip", Algorithm.PPO)
    policy.policy.action_net.bias.data.fill_(0.8)  # where tanh is far from what it is of
    policy.save(tmp_path / "best.zip")
    world = planned.open()
    network = make_agent(str(export_onnx(tmp_path, tmp_path / "net.onnx")), world)
    seen = world.reset(seed=1)[0]
    np.testing.assert_allclose(network.predict(seen)[0], policy.predict(seen, deterministic=True)[0], atol=2e-5)
    with pytest.raises(InputError, match=r"must not squash its output, got squash_output: true: use \.onnx"):
        export_arrays(tmp_path, tmp_path / "net.npz")


def test_arrays_of_a_policy_with_a_history_are_refused_when_they_are_written(tmp_path: Path) -> None:
    train(experiment(steps=64, overrides={**STILL, "observation": {"history": 2}}), tmp_path)
    with pytest.raises(InputError, match=r"must see one observation, got a history of 2: use \.onnx"):
        export_arrays(tmp_path, tmp_path / "net.npz")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoints as users of Stable-Baselines3 save them, without a word of where they were learnt."""
    folder = tmp_path_factory.mktemp("saved")
    env = EngineVecEnv("lanebound/LaneKeeping-v0", 2, {**STILL, "observation": {"form": "flat"}})
    for name, kind in (("PPO", PPO), ("A2C", A2C), ("SAC", SAC), ("TD3", TD3)):
        kind("MlpPolicy", env, seed=1).save(folder / f"{name}.zip")
    RecurrentPPO("MlpLstmPolicy", env, seed=1).save(folder / "RecurrentPPO.zip")
    return folder


@pytest.mark.parametrize("algorithm", ["PPO", "A2C", "SAC"])
def test_a_checkpoint_of_ones_own_is_exported_once_its_environment_is_named(
    saved: Path, tmp_path: Path, algorithm: str
) -> None:
    source = saved / f"{algorithm}.zip"
    with pytest.raises(InputError, match=rf"{algorithm}\.zip must say where it was learnt, .*: add --env ID$"):
        export_onnx(source, tmp_path / "net.onnx")
    arguments = ["export", str(source), "--out", str(tmp_path / "net.onnx"), "--env", "LaneKeeping"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    world = open_env("LaneKeeping", {"observation": {"form": "flat"}})
    network, policy = make_agent(str(tmp_path / "net.onnx"), world), load_checkpoint(source)
    seen = world.reset(seed=1)[0]
    np.testing.assert_allclose(network.predict(seen)[0], policy.predict(seen, deterministic=True)[0], atol=2e-5)
    with pytest.raises(
        InputError, match=r"must be learnt on flat observations of LaneKeeping-v0, .* got \(216,\): name"
    ):
        export_onnx(source, tmp_path / "b.onnx", "LaneKeeping", {"overrides": {"observation": {"vehicles": 3}}})


def test_policies_that_cannot_stand_alone_are_refused(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"with best\.zip or a checkpoint \.zip, got .*: train first"):
        export_onnx(tmp_path, tmp_path / "net.onnx")
    for algorithm, message in (
        ("RecurrentPPO", "must have no memory, got RecurrentPPO: drive with its checkpoint instead"),
        ("TD3", "must be of PPO, A2C or SAC, got TD3: drive with its checkpoint instead"),
    ):
        with pytest.raises(InputError, match=message):
            export_onnx(saved / f"{algorithm}.zip", tmp_path / "net.onnx", "LaneKeeping")
    with pytest.raises(InputError, match="must stand alone, got one under the filter cbf"):
        export_onnx(saved / "PPO.zip", tmp_path / "net.onnx", "CarFollowing", {"shield": "cbf"})
    with pytest.raises(InputError, match=r"must be PPO's with tanh, got SACPolicy: use \.onnx"):
        export_arrays(saved / "SAC.zip", tmp_path / "net.npz", "LaneKeeping")
    monkeypatch.setattr("lanebound.agents.learning.export.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs the package onnx, got none: pip install onnx$"):
        export_onnx(saved / "PPO.zip", tmp_path / "net.onnx", "LaneKeeping")


def test_a_checkpoint_of_ones_own_is_evaluated(saved: Path, tmp_path: Path) -> None:
    arguments = ["evaluate", str(saved / "PPO.zip"), "--out", str(tmp_path), "--seeds", "1", "--jobs", "1"]
    told = CliRunner().invoke(app, arguments)
    assert (told.exit_code, "add --env ID" in told.stderr) == (2, True)
    more = ["--env", "LaneKeeping", "--sky", "open", "--agents", "nominal", "--set", "duration_s=2", "--json"]
    told = CliRunner().invoke(app, [*arguments, *more])
    assert told.exit_code == 0, told.output
    assert [(one["agent"], one["status"]) for one in json.loads(told.stdout)["outcomes"]] == [
        ("learnt", "ok"), ("nominal", "ok"),
    ]  # fmt: skip


def test_a_checkpoint_of_groups_is_evaluated_and_its_export_refused_with_a_remedy(tmp_path: Path) -> None:
    """The default form of observation, dict, as users of Stable-Baselines3 train it."""
    source = tmp_path / "groups.zip"
    PPO("MultiInputPolicy", open_env("LaneKeeping", STILL), policy_kwargs={"net_arch": [8]}, seed=1).save(source)
    arguments = ["evaluate", str(source), "--out", str(tmp_path / "out"), "--seeds", "1", "--jobs", "1", "--json"]
    more = ["--env", "LaneKeeping", "--sky", "open", "--agents", "nominal", "--set", "duration_s=2"]
    told = CliRunner().invoke(app, [*arguments, *more])
    assert told.exit_code == 0, told.output
    assert [one["status"] for one in json.loads(told.stdout)["outcomes"]] == ["ok", "ok"]
    refusal = r"must take flat observations, got one .* \(ego, .*\): learn it with observation\.form=flat, or drive"
    for export in (export_onnx, export_arrays):
        with pytest.raises(InputError, match=refusal):
            export(source, tmp_path / "net", "LaneKeeping")


def test_a_checkpoint_of_ones_own_that_names_no_environment_is_reported(
    saved: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """And once it names one, it is reported elsewhere alone, and evaluated without --env."""
    plain, named = (tmp_path / f"{name}.zip" for name in ("plain", "named"))
    for file in (plain, named):
        file.write_bytes((saved / "PPO.zip").read_bytes())
    flat = {"observation": {"form": "flat"}}
    home, other = open_env("LaneKeeping", flat), open_env("CarFollowing", flat)
    name_inputs(named, home.config.observation, "lanebound/LaneKeeping-v0")
    for _ in range(2):
        make_agent(str(plain), home)
    assert caplog.messages == [
        f"lanebound: policy {plain} does not say where it was learnt and drives LaneKeepingWorld here"
    ]
    caplog.clear()
    make_agent(str(named), home)
    assert caplog.messages == []
    make_agent(str(named), other)
    assert [
        f"{named} was learnt in lanebound/LaneKeeping-v0 and drives CarFollowingWorld" in m for m in caplog.messages
    ] == [True]
    assert trained(named)[0].env == "LaneKeeping-v0"


def test_policies_know_where_they_were_learnt(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    planned = experiment(steps=64, overrides=STILL)
    train(planned, tmp_path / "run")
    best = tmp_path / "run" / "best.zip"
    assert inputs_in(best) == PolicyInputs.of(planned.open().config.observation)
    files = [best, export_onnx(best, tmp_path / "net.onnx"), export_arrays(best, tmp_path / "net.npz")]
    flat = {"observation": {"form": "flat"}}
    home, other = open_env("LaneKeeping", flat), open_env("CarFollowing", flat)
    for file in files:
        assert experiment_in(file) == planned.to_dict()
        caplog.clear()
        make_agent(str(file), home)
        assert caplog.messages == []
        make_agent(str(file), other)
        assert caplog.messages == [
            f"lanebound: policy {file} was learnt in LaneKeeping-v0 and drives CarFollowingWorld here: its results say "
            "nothing of what it learnt"
        ]
    suite = SuiteConfig.load(
        {"envs": ["LaneKeeping", "CarFollowing"], "agents": {"mine": str(best), "safe": {"agent": "cbf", "figures":
         {"over": str(files[2])}}, "nominal": "nominal"}, "seeds": {"count": 1}}
    )  # fmt: skip
    assert strangers(suite) == [elsewhere(str(file), "CarFollowingWorld") for file in (best, files[2])]
    assert trained(best)[0] == planned
    (tmp_path / "damaged.npz").write_bytes(b"PK")
    assert experiment_in(tmp_path / "damaged.npz") is None


def test_the_command_says_what_is_missing(tmp_path: Path) -> None:
    told = CliRunner().invoke(app, ["export", str(tmp_path)])
    assert told.exit_code == 2
    assert "train first" in told.stderr


def test_a_checkpoint_with_other_actions_is_not_evaluated(saved: Path, tmp_path: Path) -> None:
    told = CliRunner().invoke(
        app, ["evaluate", str(saved / "PPO.zip"), "--env", "Merge", "--out", str(tmp_path / "out"), "--seeds", "1"]
    )
    assert told.exit_code == 2
    assert "Discrete(5)" in told.stderr
    assert told.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
