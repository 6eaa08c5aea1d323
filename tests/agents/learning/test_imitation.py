"""A policy that begins from a driver does nearly what it does, on ways of its own, and learning goes on from there."""

from __future__ import annotations

from contextlib import closing
from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from experiments import experiment
from stable_baselines3 import PPO

from lanebound.agents.checkpointing.folder import ResultFolder
from lanebound.agents.learning import imitation, training
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig
from lanebound.agents.learning.imitation import Teacher, imitate, teacher_of
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.learning.training import Checkpoint, one_thread, train
from lanebound.agents.studies.learning import LearningStudyConfig, plan
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.errors import ConfigError, InputError

SMALL: dict[str, Any] = {"rounds": 1, "decisions": 8, "epochs": 1}


BLIND: dict[str, Any] = {"observation": {"integrity": "blind"}}
SEEING: dict[str, Any] = {"observation": {"integrity": "full"}}


def _teacher(config: ExperimentConfig) -> Teacher:
    teacher = teacher_of(config)
    assert teacher is not None
    return teacher


def _apart(config: ExperimentConfig, model: PPO) -> tuple[float, float]:
    """How far the policy is from its teacher on its own way, and how far the best constant action would be.

    Mean square, or the share of actions that differ.
    """
    teacher = _teacher(config)
    with closing(for_learning(teacher.experiment, 1)) as env:
        env.seed(77)
        seen, starts, state = env.reset(), np.ones(env.num_envs, dtype=np.bool_), None
        off, said = [], []
        for _ in range(40):
            wanted, state = teacher.driver.predict(seen, state, starts)
            actions, _ = model.predict(np.asarray(seen)[:, teacher.places], deterministic=True)
            off.append(np.mean((actions - wanted) ** 2) if actions.ndim > 1 else np.mean(actions != wanted))
            said.append(wanted)
            seen, _, starts, _ = env.step(actions)
    every = np.concatenate(said)
    constant = every.var(axis=0).mean() if every.ndim > 1 else 1.0 - np.bincount(every).max() / every.size
    return float(np.mean(off)), float(constant)


@pytest.mark.parametrize(
    ("env", "driver", "epochs", "share"),
    [("LaneKeeping", "nominal", 12, 0.4), pytest.param("Highway", "integrity_aware", 60, 0.8, marks=pytest.mark.slow)],
)
def test_the_policy_comes_to_do_what_the_driver_does(env: str, driver: str, epochs: int, share: float) -> None:
    overrides: dict[str, Any] = {"navigation": {"source": "perfect"}}
    if env == "Highway":
        overrides |= {"perception": {"source": "truth"}, "world": {"vehicles_count": 8}, "duration_s": 20}
    shown = ImitationConfig(driver=driver, rounds=3, decisions=3200, epochs=epochs)
    config = experiment(env=env, overrides=overrides, count=32, imitation=shown)
    with closing(for_learning(config, 1)) as learning, one_thread():
        model = PPO("MlpPolicy", learning, seed=1, device="cpu")
        before, earned = _apart(config, model)[0], evaluate(config, model)["return"]
        losses = imitate(_teacher(config), model, learning)
        after, constant = _apart(config, model)
    assert len(losses) == 3
    assert after < min(share * constant, 0.7 * before)
    assert evaluate(config, model)["return"] > earned


def test_learning_goes_on_from_there_and_imitates_once(tmp_path: Path) -> None:
    told: list[Checkpoint] = []
    config = experiment(algorithm="ppo_lagrangian", imitation=SMALL)
    rows = train(config, tmp_path, on_checkpoint=told.append)
    assert [row["steps"] for row in rows] == [0, 64, 128] == [checkpoint.steps for checkpoint in told]
    assert "after imitating `integrity_aware`" in (tmp_path / "best.md").read_text()
    rows = train(experiment(algorithm="ppo_lagrangian", imitation=SMALL, steps=192), tmp_path)
    assert [row["steps"] for row in rows] == [0, 64, 128, 192]


SOON: dict[str, Any] = {
    "steps": 64,
    "checkpoint_steps": 16,
    "settings": {"n_steps": 8, "batch_size": 16, "n_epochs": 1},
}


@pytest.mark.parametrize(("env", "duration_s"), [("LaneKeeping", 4.0), ("Highway", 10.0)])  # continuous, discrete
def test_critics_learn_first(tmp_path: Path, caplog: pytest.LogCaptureFixture, env: str, duration_s: float) -> None:
    """The actor stays as it was until each environment has ended an episode, of 20 decisions, and learns then."""
    kept: list[dict[str, torch.Tensor]] = []

    def judge(_: ExperimentConfig, model: Any) -> dict[str, float]:
        kept.append(deepcopy(model.policy.state_dict()))
        return {"return": 0.0, "cost": 0.0}

    overrides = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": duration_s}
    config = experiment(env=env, overrides=overrides, imitation=SMALL, **SOON)
    train(config.replace(steps=16), tmp_path, judge=judge)
    assert "still that of the imitation" in caplog.text
    train(config, tmp_path, judge=judge)  # it was stopped before, and waits anew
    changed = [
        {name for name in before if not torch.equal(before[name], after[name])} for before, after in pairwise(kept)
    ]
    assert changed[0] == changed[1] == {name for name in kept[0] if "value" in name}
    assert changed[-1] == set(kept[0])


def test_the_policy_may_learn_at_once(tmp_path: Path) -> None:
    one, other = (
        train(experiment(imitation={**SMALL, "critics_first": first}, **SOON), tmp_path / str(first))
        for first in (True, False)
    )
    assert one[1] == one[0] | {"steps": 16}
    assert one[1] != other[1]


def test_the_same_seed_imitates_alike(tmp_path: Path) -> None:
    rows = [train(experiment(imitation=SMALL, steps=64), tmp_path / name) for name in "ab"]
    assert rows[0] == rows[1]
    longer = train(experiment(imitation={**SMALL, "decisions": 64}, steps=64), tmp_path / "c")
    assert longer[0] != rows[0][0]


def test_its_episodes_are_none_that_learning_meets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeded: list[int] = []
    seed = EngineVecEnv.seed
    monkeypatch.setattr(EngineVecEnv, "seed", lambda env, to: seeded.append(to) or seed(env, to))
    config = experiment(imitation=SMALL, steps=64)
    train(config, tmp_path)
    shown = seeded.index(episode_seeds(config, 0, "imitation"))
    assert episode_seeds(config, 0) in seeded[shown + 1 :]  # learning by reward begins with episodes of its own


@pytest.mark.parametrize("missing", ["progress.json", "best.md"])
def test_a_stop_between_files_loses_no_judgement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    config = experiment(imitation=SMALL, steps=64)
    whole = train(config, tmp_path / "whole")
    where = "write_card" if missing == "best.md" else "write_json"
    with monkeypatch.context() as patch:
        patch.setattr(training, where, stop)
        with pytest.raises(KeyboardInterrupt):
            train(config, tmp_path / "cut")
    assert (tmp_path / "cut" / "last.zip").exists()
    rows = train(config, tmp_path / "cut")
    assert [row["steps"] for row in rows] == [0, 64]
    assert rows[0] == whole[0]
    assert (tmp_path / "cut" / "best.md").exists()


def test_who_cannot_imitate_or_be_imitated_is_refused() -> None:
    with pytest.raises(ConfigError, match="imitation must be null for sac, got a driver: write imitation: null, or"):
        experiment(algorithm="sac", imitation=SMALL)
    with pytest.raises(ConfigError, match="agent 'nominl' is unknown: did you mean 'nominal'"):
        experiment(imitation={"driver": "nominl"})
    with pytest.raises(ConfigError, match="driver must have no memory of its commands, got 'mpc'"):
        experiment(imitation={"driver": "mpc"})


def test_what_is_refused_is_named_where_it_was_written() -> None:
    with pytest.raises(ConfigError, match=r"^overrides\.duraton_s is not a known key"):
        teacher_of(experiment(imitation={**SMALL, **SEEING}, overrides={"duraton_s": 5}))
    with pytest.raises(ConfigError, match=r"^imitation\.observation\.histry is not a known key"):
        teacher_of(experiment(imitation={**SMALL, "observation": {"histry": 2}}))


def test_a_driver_who_cannot_drive_there_leaves_no_folder(tmp_path: Path) -> None:
    blind = experiment(imitation=SMALL, overrides=BLIND)
    with pytest.raises(InputError, match="observation must show"):
        train(blind, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    study = LearningStudyConfig.load(
        {"arms": {"blind": {"overrides": BLIND}}, "envs": ["LaneKeeping"],
         "skies": ["open"], "experiment": {"imitation": SMALL}}
    )  # fmt: skip
    with pytest.raises(InputError, match="observation must show"):
        plan(study)


@pytest.mark.parametrize(("env", "history"), [("LaneKeeping", 1), ("Highway", 2)])
def test_what_the_driver_is_shown_holds_what_the_policy_sees(env: str, history: int) -> None:
    overrides = deep_merge(BLIND, {"observation": {"history": history}})
    config = experiment(env=env, overrides=overrides, imitation={**SMALL, **SEEING}, count=3, settings={})
    teacher = _teacher(config)
    with closing(for_learning(config, 1)) as ours, closing(for_learning(teacher.experiment, 1)) as theirs:
        seen, shown = ours.reset(), theirs.reset()
        for _ in range(25):
            np.testing.assert_array_equal(seen, np.asarray(shown)[:, teacher.places])
            actions = np.stack([ours.action_space.sample() for _ in range(3)])
            (seen, *_), (shown, *_) = ours.step(actions), theirs.step(actions)
        assert np.asarray(shown).shape[1] > np.asarray(seen).shape[1]


def test_a_blind_policy_begins_from_a_driver_that_sees_and_lags_behind_one_that_sees_too(tmp_path: Path) -> None:
    off = {}
    for name, own in (("blind", BLIND), ("sees", {})):
        shown = {"rounds": 3, "decisions": 3200, "epochs": 12, **SEEING}
        overrides = deep_merge(own, {"duration_s": 30.0})
        config = experiment(overrides=overrides, imitation=shown, count=32, sky="urban")
        with closing(for_learning(config, 1)) as learning, one_thread():
            model = PPO("MlpPolicy", learning, seed=1, device="cpu")
            before = _apart(config, model)[0]
            with closing(for_learning(_teacher(config).experiment, 1)) as env:
                imitate(_teacher(config), model, env)
            off[name] = _apart(config, model)[0]
        assert off[name] < before
    assert off["sees"] < 0.5 * off["blind"]  # 0.017 and 0.093: what the driver does at first, its levels decide
    short = experiment(overrides=BLIND, imitation={**SMALL, **SEEING}, steps=64)
    assert [row["steps"] for row in train(short, tmp_path)] == [0, 64]


def test_what_the_driver_is_shown_must_hold_all_that_the_policy_sees() -> None:
    for shown, reason in [
        ({"vehicles": 2}, "traffic.v2_present, traffic.v2_ahead"),
        ({"speed_max_mps": 50.0}, "ego.speed"),
        ({"integrity": "oracle"}, "integrity: oracle of the policy"),
        ({"history": 2}, "must have the history"),
    ]:
        with pytest.raises(InputError, match=reason):
            teacher_of(experiment(imitation={**SMALL, "observation": shown}))


def test_a_stop_loses_no_finished_round(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = experiment(imitation={**SMALL, "rounds": 3})
    states: list[dict[str, Any]] = []
    fit = imitation._fit

    def noted(model: Any, labels: Any, lessons: Any, optimiser: Any) -> float:
        stacked = {"observations": np.stack(labels.observations), "actions": np.stack(labels.actions)}
        before = {**stacked, "draws": torch.get_rng_state()}
        weights = {name: value.clone() for name, value in model.policy.state_dict().items()}
        states.append({**before, "weights": weights, "fit": deepcopy(optimiser.state_dict()["state"])})
        if len(states) == 3:
            raise KeyboardInterrupt
        return fit(model, labels, lessons, optimiser)

    monkeypatch.setattr(imitation, "_fit", noted)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path)
    steps: list[int] = []
    train(config, tmp_path, imitated=steps.append)
    assert len(states) == 4  # the third again, and no other
    assert steps[0] == steps[-1] // 3 * 2 + config.count
    cut, again = states[2:]
    finished = len(cut["observations"]) // 3 * 2
    for name in ("observations", "actions"):
        np.testing.assert_array_equal(again[name][:finished], cut[name][:finished])
    assert again["draws"].equal(cut["draws"])
    assert all(again["weights"][name].equal(value) for name, value in cut["weights"].items())
    assert cut["fit"].keys() == again["fit"].keys() != set()
    assert all(again["fit"][k]["exp_avg"].equal(cut["fit"][k]["exp_avg"]) for k in cut["fit"])
    assert not (tmp_path / "imitation.pt").exists()


def test_what_imitation_kept_and_cannot_be_read_is_named(tmp_path: Path) -> None:
    config = experiment(imitation=SMALL, steps=64)
    fixed = {key: value for key, value in config.to_dict().items() if key != "steps"}
    ResultFolder(tmp_path, "training", config.to_dict(), fixed=fixed).claim()
    (tmp_path / "imitation.pt").write_bytes(b"nothing of ours")
    with pytest.raises(
        InputError, match=r"imitation\.pt must be as imitation wrote it, got another file .*: delete it"
    ):
        train(config, tmp_path)


def test_what_the_driver_needs_is_asked_for_by_its_path(tmp_path: Path) -> None:
    remedy = r"got none: set observation\.integrity to full, or .* imitation\.observation"
    with pytest.raises(InputError, match=remedy) as told:
        train(experiment(imitation=SMALL, overrides=BLIND), tmp_path)
    assert len(str(told.value)) < 200
    with pytest.raises(ConfigError, match=r"^imitation\.observation\.integrity must be .*, got 'ful'"):
        teacher_of(experiment(imitation={**SMALL, "observation": {"integrity": "ful"}}))
