"""Networks that are exported answer as the policies do, in a car too; what cannot stand alone is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from experiments import experiment
from gymnasium import spaces
from typer.testing import CliRunner

from lanebound.agents.checkpointing.folder import ResultFolder
from lanebound.agents.cli import app
from lanebound.agents.drivers import learnt, make_agent
from lanebound.agents.episodes import open_env
from lanebound.agents.learning.experiment import Algorithm, ExperimentConfig
from lanebound.agents.learning.export import export_arrays, export_onnx
from lanebound.agents.learning.training import load_model, train
from lanebound.integrity.core.errors import InputError

STILL = {"navigation": {"source": "perfect"}, "duration_s": 4.0}
SETTINGS: dict[str, dict[str, Any]] = {
    "ppo_lagrangian": {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "policy_kwargs": {"log_std_init": 1.0}},
    "sac": {"learning_starts": 20, "buffer_size": 100, "batch_size": 16, "train_freq": 16},
}


@pytest.mark.parametrize(
    ("algorithm", "env"), [("ppo_lagrangian", "LaneKeeping"), ("sac", "LaneKeeping"), ("ppo", "UrbanCanyon")]
)
def test_a_network_answers_as_its_policy_does(tmp_path: Path, algorithm: str, env: str) -> None:
    settings = SETTINGS.get(algorithm, SETTINGS["ppo_lagrangian"] | {"policy_kwargs": {}})
    planned = experiment(algorithm=algorithm, env=env, steps=64, settings=settings, overrides=STILL)
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
    with pytest.raises(
        InputError, match=r"the ONNX agent was learnt with an observation of its own .* \(scales differ\)"
    ):
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
        with pytest.raises(InputError, match="leave 'observation' as it was there"):
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


def test_policies_that_cannot_stand_alone_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"with best\.zip, got .*: train first"):
        export_onnx(tmp_path, tmp_path / "net.onnx")

    def claim(planned: ExperimentConfig) -> None:
        for name in ("run.json", "best.zip"):
            (tmp_path / name).unlink(missing_ok=True)
        ResultFolder(tmp_path, "training", planned.to_dict()).claim()
        (tmp_path / "best.zip").touch()

    for changes, message in (
        ({"algorithm": "recurrent_ppo"}, "must have no memory, got recurrent_ppo"),
        ({"env": "CarFollowing", "shield": "cbf"}, "must stand alone, got one under the filter cbf"),
    ):
        claim(experiment(**changes))
        with pytest.raises(InputError, match=message):
            export_onnx(tmp_path, tmp_path / "net.onnx")
    claim(experiment())
    monkeypatch.setattr("lanebound.agents.learning.export.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs the package onnx, got none: pip install onnx$"):
        export_onnx(tmp_path, tmp_path / "net.onnx")


def test_the_command_says_what_is_missing(tmp_path: Path) -> None:
    told = CliRunner().invoke(app, ["export", str(tmp_path)])
    assert told.exit_code == 2
    assert "train first" in told.stderr
