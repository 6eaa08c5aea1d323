"""Training keeps checkpoints, goes on from the last, refuses another experiment, and chooses by cost before return."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from experiments import experiment
from stable_baselines3.common.base_class import BaseAlgorithm
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from lanebound.agents.benchmark import run
from lanebound.agents.cli import app
from lanebound.agents.learning.algorithms import class_of
from lanebound.agents.learning.evaluation import evaluate, evaluation_suite
from lanebound.agents.learning.experiment import load_experiment
from lanebound.agents.learning.opening import for_judging, for_learning
from lanebound.agents.learning.training import REPLAY, Checkpoint, is_best, load_model, train
from lanebound.envs.costs import CAUSES
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.presets import preset_names


class StoppedError(Exception):
    pass


def test_an_experiment_leaves_checkpoints_a_card_and_its_progress(tmp_path: Path) -> None:
    told: list[Checkpoint] = []
    rows = train(experiment(algorithm="ppo_lagrangian"), tmp_path, on_checkpoint=told.append)
    assert [row["steps"] for row in rows] == [64, 128] == [checkpoint.steps for checkpoint in told]
    assert json.loads((tmp_path / "progress.json").read_text()) == rows
    assert told[0].best
    card = (tmp_path / "best.md").read_text()
    assert "ppo_lagrangian in LaneKeeping-v0" in card
    assert load_model(tmp_path / "last.zip", experiment(algorithm="ppo_lagrangian").algorithm).num_timesteps == 128


@pytest.mark.parametrize("algorithm", ["ppo_lagrangian", "sac_lagrangian"])
def test_each_limit_is_learnt_under_logged_and_judged(algorithm: str, tmp_path: Path) -> None:
    settings = {"learning_starts": 20, "batch_size": 32} if algorithm == "sac_lagrangian" else experiment().settings
    overrides = {**experiment().overrides, "cost_limits": {"lane": 1e-6, "hmi": 3.0}}
    planned = experiment(
        algorithm=algorithm, settings=settings, overrides=overrides, steps=256, checkpoint_steps=128
    )  # two updates a checkpoint, as a log is written before the next one
    assert planned.limits() == {"cost": 15.0, "group_cost_lane": 1e-6, "group_cost_hmi": 3.0}
    rows = train(planned.replace(steps=128), tmp_path)
    last = train(planned, tmp_path)[-1]  # which goes on with all multipliers
    assert len(rows) == 1
    assert last["within_all_limits"] == float(last["group_cost_lane"] <= 1e-6 and last["cost"] <= 15.0)
    assert last["over_lane_limit"] == float(last["group_cost_lane"] > 1e-6)
    assert last["over_hmi_limit"] == last["group_cost_hmi"] == last["group_cost_hmi_se"] == 0.0
    logs = [EventAccumulator(str(folder)) for folder in (tmp_path / "logs").iterdir()]
    tags = {tag for log in logs for tag in log.Reload().Tags()["scalars"]}
    for name in ("multiplier", "episode_mean"):
        assert {f"cost/{name}{suffix}" for suffix in ("", "_lane", "_hmi")} <= tags
    loaded = load_model(tmp_path / "last.zip", planned.algorithm)
    assert loaded.constraints.limits == [15.0, 1e-6, 3.0]  # type: ignore[attr-defined]


def test_a_training_of_one_multiplier_is_judged_but_not_resumed(tmp_path: Path) -> None:
    """As files of versions before ``cost_limits`` are, which hold ``multiplier`` in the place of ``constraints``."""
    planned = experiment(algorithm="ppo_lagrangian", steps=64)
    train(planned, tmp_path)
    model = load_model(tmp_path / "last.zip", planned.algorithm)
    model.multiplier = vars(model).pop("constraints").multipliers[0]  # type: ignore[attr-defined]
    model.save(tmp_path / "last.zip")
    with pytest.raises(InputError, match="out must hold a training of this version"):
        train(planned.replace(steps=128), tmp_path)
    assert evaluate(planned, load_model(tmp_path / "last.zip", planned.algorithm))["length"] > 0


def test_a_stop_loses_no_checkpoint_and_the_same_call_goes_on(tmp_path: Path) -> None:
    def stop(checkpoint: Checkpoint) -> None:
        raise StoppedError

    with pytest.raises(StoppedError):
        train(experiment(), tmp_path, on_checkpoint=stop)
    told: list[Checkpoint] = []
    rows = train(experiment(), tmp_path, on_checkpoint=told.append)
    assert [row["steps"] for row in rows] == [64, 128]
    assert [checkpoint.steps for checkpoint in told] == [128]
    assert train(experiment(), tmp_path) == rows
    assert [row["steps"] for row in train(experiment(steps=192), tmp_path)] == [64, 128, 192]


@pytest.mark.parametrize("algorithm", ["ppo", "sac_lagrangian"])
def test_who_goes_on_after_a_stop_does_not_draw_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str
) -> None:
    drawn: list[tuple[float, float]] = []

    def stop(model: BaseAlgorithm, *_: Any, **__: Any) -> None:
        drawn.append((float(torch.rand(1)), float(np.random.rand())))  # noqa: NPY002 - the streams that SB3 draws from
        raise StoppedError

    settings = {} if algorithm == "ppo" else {"buffer_size": 500, "learning_starts": 20, "train_freq": 16}
    planned = experiment(algorithm=algorithm, **({"settings": settings} if settings else {}))
    train(planned.replace(steps=64), tmp_path)
    for steps in (64, 128):
        more = planned.replace(steps=steps + 64)
        with monkeypatch.context() as patched:
            patched.setattr(class_of(planned.algorithm), "learn", stop)
            with pytest.raises(StoppedError):
                train(more, tmp_path)
        train(more, tmp_path)
    assert drawn[0][0] != drawn[1][0]
    assert drawn[0][1] != drawn[1][1]


def test_the_best_is_measured_on_test_seeds_beside_others(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"with best\.zip or a checkpoint \.zip, got .*: train first"):
        evaluation_suite(tmp_path, "nominal", 1)
    train(experiment(steps=64, algorithm="ppo_lagrangian"), tmp_path / "learnt")
    suite = evaluation_suite(tmp_path / "learnt", "nominal", 2)
    results = run(suite, tmp_path / "out", jobs=1)
    assert [(o.agent, o.seed, o.failed) for o in results.outcomes] == [
        (agent, seed, False) for seed in (10000, 10001) for agent in ("learnt", "nominal")
    ]


def test_the_engine_and_single_environments_judge_alike(tmp_path: Path) -> None:
    overrides = {"duration_s": 4.0}
    engine = experiment(sky="urban", overrides=overrides, steps=64, evaluation_episodes=3)
    train(engine, tmp_path)
    model = load_model(tmp_path / "last.zip", engine.algorithm)
    assert for_judging(engine, 3).num_envs == 3
    assert for_judging(engine.replace(engine=False), 3).num_envs == 1
    dynamical = {"action_options": {"dynamical": True}}
    assert for_judging(engine.replace(overrides={**overrides, **dynamical}), 3).num_envs == 1
    assert evaluate(engine, model) == pytest.approx(evaluate(engine.replace(engine=False), model), rel=1e-5)
    with pytest.raises(
        ConfigError, match=r"engine must be left out here, got true: action_options\.dynamical must be False"
    ):
        for_judging(engine.replace(overrides=dynamical, engine=True), 3)


def test_another_experiment_is_refused_with_what_differs(tmp_path: Path) -> None:
    train(experiment(steps=64), tmp_path)
    message = (
        r"hold the same training, got .* which differs in seed \(0 there, now 3\), sky \(.*\): choose a new folder$"
    )
    with pytest.raises(InputError, match=message):
        train(experiment(seed=3, sky="urban"), tmp_path)


def test_what_is_refused_does_not_mark_its_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"settings.n_stepz must be one"):
        train(experiment(settings={"n_stepz": 3}), tmp_path)
    assert not list(tmp_path.iterdir())
    train(experiment(steps=64), tmp_path)


def test_files_of_others_and_half_trainings_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "best.zip").write_text("mine", encoding="utf-8")
    message = r"with files of other origin \(best\.zip\): choose a new folder$"
    with pytest.raises(InputError, match=message):
        train(experiment(steps=64), tmp_path)
    assert (tmp_path / "best.zip").read_text(encoding="utf-8") == "mine"
    train(experiment(steps=64), tmp_path / "half")
    (tmp_path / "half" / "last.zip").unlink()
    with pytest.raises(InputError, match=r"with best\.zip, best\.md, progress\.json but without last\.zip: choose"):
        train(experiment(), tmp_path / "half")


def test_sac_keeps_its_transitions(tmp_path: Path) -> None:
    settings = {"learning_starts": 20, "buffer_size": 500, "batch_size": 16, "train_freq": 16}
    train(experiment(algorithm="sac", settings=settings), tmp_path)
    assert (tmp_path / "last-replay.pkl").exists()
    assert len(train(experiment(algorithm="sac", settings=settings, steps=192), tmp_path)) == 3


def test_a_policy_with_a_memory_goes_on_and_drives(tmp_path: Path) -> None:
    planned = experiment(algorithm="recurrent_ppo", settings={"n_steps": 32, "batch_size": 32, "n_epochs": 1})
    rows = train(planned.replace(steps=64), tmp_path)
    again = train(planned, tmp_path)
    assert again[: len(rows)] == rows
    assert [row["steps"] for row in again] == [64, 128]
    results = run(evaluation_suite(tmp_path, "nominal", 1), tmp_path / "out", jobs=1)
    assert [(o.agent, o.failed) for o in results.outcomes] == [("learnt", False), ("nominal", False)]


def test_the_logs_hold_costs_by_cause_and_what_integrity_came_to(tmp_path: Path) -> None:
    train(experiment(sky="urban", overrides={"duration_s": 4.0}), tmp_path)
    logs = EventAccumulator(str(next((tmp_path / "logs").iterdir())))
    logs.Reload()
    tags = set(logs.Tags()["scalars"])
    assert {f"cost/{cause.removeprefix('cost_')}" for cause in CAUSES} <= tags
    assert {"integrity/availability", "integrity/alert_share", "integrity/pl_ct_mean_m", "integrity/share_rtk"} <= tags
    assert all(0.0 <= event.value <= 1.0 for event in logs.Scalars("integrity/availability"))


def test_the_best_is_by_return_within_the_limit_and_by_cost_outside() -> None:
    def best(*rows: tuple[float, float], se: float = 0.0) -> bool:
        return is_best([{"return": value, "cost": cost, "cost_se": se} for value, cost in rows], {"cost": 10.0})

    assert best((5.0, 50.0))
    assert best((5.0, 50.0), (4.0, 40.0))
    assert not best((5.0, 50.0), (9.0, 60.0))
    assert best((9.0, 60.0), (1.0, 9.0))
    assert best((1.0, 9.0), (2.0, 10.0))
    assert not best((1.0, 1.0), (9.0, 11.0))
    assert not best((1.0, 1.0), (9.0, 9.5), se=1.0)  # lucky, perhaps
    assert best((1.0, 1.0), (9.0, 8.5), se=1.0)


def test_the_best_is_within_all_limits_and_else_the_least_beyond_any() -> None:
    limits = {"cost": 10.0, "group_cost_lane": 2.0}

    def best(*rows: tuple[float, float, float]) -> bool:
        return is_best([dict(zip(("return", *limits), row, strict=True)) for row in rows], limits)

    assert not best((1.0, 9.0, 2.0), (9.0, 5.0, 2.1))  # more return, but one limit is exceeded
    assert best((9.0, 5.0, 2.1), (1.0, 9.0, 2.0))
    assert best((1.0, 5.0, 6.0), (1.0, 20.0, 2.0))  # threefold, then twofold
    assert not best((1.0, 20.0, 2.0), (1.0, 5.0, 6.0))
    assert is_best([{"return": 1.0, "cost": 1.0}, {"return": 2.0, "cost": 1e6}], {})


@pytest.mark.parametrize("name", [n.partition("/")[2] for n in preset_names() if n.startswith("experiments/")])
def test_the_packaged_experiments_can_be_opened(name: str) -> None:
    found = load_experiment(name)
    env = found.open()
    assert env.observation_space.shape is not None
    assert (
        name.removesuffix("_context")
        == f"{re.sub('(?<=[a-z])(?=[A-Z])', '_', found.env.removesuffix('-v0')).lower()}_{found.algorithm}"
    )
    assert 0 <= found.multiplier.after_steps < found.steps
    env.close()


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="did you mean 'lane_keeping_ppo'"):
        load_experiment("lane_keepin_ppo")
    with pytest.raises(ConfigError, match="steps must be >= 1"):
        experiment(steps=0)
    with pytest.raises(InputError, match=r"settings.n_stepz must be one that ppo takes, .*: did you mean 'n_steps'"):
        train(experiment(settings={"n_stepz": 3}), tmp_path)
    with pytest.raises(InputError, match=r"^settings.policy_kwargs.depth must suit ppo and LaneKeeping-v0, got 3 \("):
        train(experiment(settings={"policy_kwargs": {"depth": 3}}), tmp_path)
    with pytest.raises(InputError, match=r"^settings.target_entropy must suit sac and LaneKeeping-v0, got 'fast' \("):
        train(experiment(algorithm="sac", settings={"target_entropy": "fast"}), tmp_path / "sac")
    with pytest.raises(
        ConfigError, match=r"^overrides.duraton_s is not a known key: did you mean 'overrides.duration_s'"
    ):
        experiment(overrides={"duraton_s": 5}).open()


def test_a_device_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    message = "^settings.device must be one of this machine, got 'cuda' without CUDA: use cpu or auto$"
    with pytest.raises(InputError, match=message):
        train(experiment(settings={"device": "cuda"}), tmp_path)


@pytest.mark.filterwarnings("ignore:overflow|invalid value:RuntimeWarning")
@pytest.mark.parametrize("rate", [1e6, 1e38])
def test_learning_that_diverges_ends_in_a_line_and_keeps_no_checkpoint_of_it(tmp_path: Path, rate: float) -> None:
    settings = {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "learning_rate": rate}
    with pytest.raises(
        InputError, match=r"^learning diverged at step \d+: lower settings.learning_rate and .* kept\)$"
    ):
        train(experiment(settings=settings), tmp_path)


def test_what_diverges_after_a_checkpoint_leaves_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoil(checkpoint: Checkpoint) -> None:
        monkeypatch.setattr("stable_baselines3.PPO.train", lambda model: model.policy.log_std.data.fill_(np.nan))

    with pytest.raises(InputError, match=r"at step 128: .* \(the checkpoints before are kept in "):
        train(experiment(), tmp_path, on_checkpoint=spoil)
    assert [row["steps"] for row in json.loads((tmp_path / "progress.json").read_text())] == [64]
    assert load_model(tmp_path / "last.zip", experiment().algorithm).num_timesteps == 64


def test_other_errors_than_of_divergence_are_left_as_they_are(tmp_path: Path) -> None:
    def breaks(steps: int) -> None:
        raise ValueError("of another kind")

    with pytest.raises(ValueError, match="of another kind"):
        train(experiment(), tmp_path, stepped=breaks)


@pytest.mark.parametrize("name", ["run.json", "progress.json"])
def test_a_damaged_folder_is_refused_by_the_file(tmp_path: Path, name: str) -> None:
    train(experiment(steps=64), tmp_path)
    (tmp_path / name).write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match=rf"{name} is not JSON \(.*\): restore it or choose a new folder$"):
        train(experiment(), tmp_path)
    (tmp_path / name).write_text("3", encoding="utf-8")
    with pytest.raises(InputError, match=rf"{name} must hold a JSON (object|array), got int: restore it"):
        train(experiment(), tmp_path)
    if name == "run.json":
        with pytest.raises(InputError, match=r"run\.json must hold a JSON object"):
            evaluation_suite(tmp_path, "nominal", 1)


def test_damaged_transitions_are_refused_by_the_file(tmp_path: Path) -> None:
    settings = {"learning_starts": 20, "buffer_size": 100, "batch_size": 16, "train_freq": 16}
    train(experiment(algorithm="sac", steps=64, settings=settings), tmp_path)
    whole = (tmp_path / REPLAY).read_bytes()
    for damaged in (b"", b"{", whole[: len(whole) // 2]):
        (tmp_path / REPLAY).write_bytes(damaged)
        with pytest.raises(InputError, match=r"transitions must be as training keeps them, got .*last-replay\.pkl"):
            train(experiment(algorithm="sac", settings=settings), tmp_path)


def test_a_training_that_is_done_says_so(tmp_path: Path) -> None:
    planned = experiment()
    train(planned, tmp_path / "out")
    (tmp_path / "planned.yaml").write_text(planned.to_json(), encoding="utf-8")
    arguments = ["train", str(tmp_path / "planned.yaml"), "--out", str(tmp_path / "out"), "--set", "steps=64"]
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 0, told.output
    assert "all 64 decisions are made (now 128): raise steps to continue" in told.output


@pytest.mark.parametrize("engine", [True, False])
def test_shielded_cars_carry_out_the_safe_action_and_say_so(engine: bool) -> None:
    env = for_learning(experiment(env="CarFollowing", shield="cbf", engine=engine, overrides={"duration_s": 4.0}), 1)
    env.reset()
    told = [env.step(np.ones((env.num_envs, 2), np.float32))[3] for _ in range(5)]
    assert all(info["shielded"] is True for info in told[0])
    assert not any(info.get("crashed", False) for infos in told for info in infos)
    env.close()
