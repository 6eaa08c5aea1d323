"""A policy that begins from a driver does nearly what it does, on ways of its own, and learning goes on from there."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiments import experiment
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor

from lanebound.agents.drivers import make_agent
from lanebound.agents.learning import training
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig
from lanebound.agents.learning.imitation import imitate, teacher_of
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.learning.study import LearningStudyConfig, plan
from lanebound.agents.learning.training import Checkpoint, one_thread, train
from lanebound.integrity.errors import ConfigError, InputError

SMALL: dict[str, Any] = {"rounds": 1, "decisions": 8, "epochs": 1}


def _apart(config: ExperimentConfig, model: PPO, driver: str) -> tuple[float, float]:
    """How far the policy is from the driver on its own way, and how far the best constant action would be.

    Mean square, or the share of actions that differ.
    """
    with closing(config.open()) as single:
        wanted_of = make_agent(driver, single)
    with closing(for_learning(config, 1)) as env:
        env.seed(77)
        seen, starts, state = env.reset(), np.ones(env.num_envs, dtype=np.bool_), None
        off, said = [], []
        for _ in range(40):
            wanted, state = wanted_of.predict(seen, state, starts)
            actions, _ = model.predict(seen, deterministic=True)
            off.append(np.mean((actions - wanted) ** 2) if actions.ndim > 1 else np.mean(actions != wanted))
            said.append(wanted)
            seen, _, starts, _ = env.step(actions)
    every = np.concatenate(said)
    constant = every.var(axis=0).mean() if every.ndim > 1 else 1.0 - np.bincount(every).max() / every.size
    return float(np.mean(off)), float(constant)


@pytest.mark.parametrize(
    ("env", "driver", "epochs", "share"), [("LaneKeeping", "nominal", 12, 0.4), ("Highway", "integrity_aware", 60, 0.8)]
)
def test_the_policy_comes_to_do_what_the_driver_does(env: str, driver: str, epochs: int, share: float) -> None:
    overrides: dict[str, Any] = {"navigation": {"source": "perfect"}}
    if env == "Highway":
        overrides |= {"perception": {"source": "truth"}, "world": {"vehicles_count": 8}, "duration_s": 20}
    config = experiment(env=env, overrides=overrides, count=32)
    with closing(for_learning(config, 1)) as learning, one_thread():
        model = PPO("MlpPolicy", learning, seed=1, device="cpu")
        before, earned = _apart(config, model, driver)[0], evaluate(config, model)["return"]
        shown = ImitationConfig(driver=driver, rounds=3, decisions=3200, epochs=epochs)
        config = config.replace(imitation=shown)
        losses = imitate(config, teacher_of(config), model, learning)
        after, constant = _apart(config, model, driver)
    assert len(losses) == 3
    assert after < min(share * constant, 0.7 * before)
    assert evaluate(config, model)["return"] > earned


def test_learning_goes_on_from_there_and_imitates_once(tmp_path: Path) -> None:
    told: list[Checkpoint] = []
    config = experiment(algorithm="ppo_lagrangian", imitation=SMALL)
    rows = train(config, tmp_path, told=told.append)
    assert [row["steps"] for row in rows] == [0, 64, 128] == [checkpoint.steps for checkpoint in told]
    assert "after imitating `integrity_aware`" in (tmp_path / "best.md").read_text()
    rows = train(experiment(algorithm="ppo_lagrangian", imitation=SMALL, steps=192), tmp_path)
    assert [row["steps"] for row in rows] == [0, 64, 128, 192]


def test_the_same_seed_imitates_alike(tmp_path: Path) -> None:
    rows = [train(experiment(imitation=SMALL, steps=64), tmp_path / name) for name in "ab"]
    assert rows[0] == rows[1]
    longer = train(experiment(imitation={**SMALL, "decisions": 64}, steps=64), tmp_path / "c")
    assert longer[0] != rows[0][0]


def test_its_episodes_are_none_that_learning_meets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeded: list[int] = []
    seed = VecEnvWrapper.seed
    monkeypatch.setattr(VecMonitor, "seed", lambda env, to: seeded.append(to) or seed(env, to))
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
    where = "write_card" if missing == "best.md" else "finite_or_none"
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


def test_a_driver_who_cannot_drive_there_leaves_no_folder(tmp_path: Path) -> None:
    blind = experiment(imitation=SMALL, overrides={"observation": {"integrity": "blind"}})
    with pytest.raises(InputError, match="observation must show"):
        train(blind, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    study = LearningStudyConfig.load(
        {"arms": {"blind": {"overrides": {"observation": {"integrity": "blind"}}}}, "envs": ["LaneKeeping"],
         "skies": ["open"], "experiment": {"imitation": SMALL}}
    )  # fmt: skip
    with pytest.raises(InputError, match="observation must show"):
        plan(study)
