"""A policy that begins from a driver does nearly what it does, on ways of its own, and learning goes on from there."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiments import experiment
from stable_baselines3 import PPO

from lanebound.agents.drivers import make_agent
from lanebound.agents.learning.evaluation import evaluate
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig
from lanebound.agents.learning.imitation import imitate
from lanebound.agents.learning.opening import episode_seeds, for_learning
from lanebound.agents.learning.training import Checkpoint, one_thread, train
from lanebound.integrity.errors import ConfigError

SMALL: dict[str, Any] = {"rounds": 1, "decisions": 8, "epochs": 1}


def _apart(config: ExperimentConfig, model: PPO, driver: str) -> float:
    """How far the policy is from the driver on its own way: mean square, or share of actions that differ."""
    with closing(config.open()) as single:
        wanted_of = make_agent(driver, single)
    with closing(for_learning(config, 1)) as env:
        env.seed(77)
        seen, starts, state, off = env.reset(), np.ones(env.num_envs, dtype=np.bool_), None, []
        for _ in range(40):
            wanted, state = wanted_of.predict(seen, state, starts)
            actions, _ = model.predict(seen, deterministic=True)
            off.append(np.mean((actions - wanted) ** 2) if actions.ndim > 1 else np.mean(actions != wanted))
            seen, _, starts, _ = env.step(actions)
    return float(np.mean(off))


@pytest.mark.parametrize(
    ("env", "driver", "most"), [("LaneKeeping", "nominal", 0.02), ("Highway", "integrity_aware", 0.5)]
)
def test_the_policy_comes_to_do_what_the_driver_does(env: str, driver: str, most: float) -> None:
    overrides: dict[str, Any] = {"navigation": {"source": "perfect"}}
    if env == "Highway":
        overrides |= {"perception": {"source": "truth"}, "world": {"vehicles_count": 8}, "duration_s": 20}
    config = experiment(env=env, overrides=overrides, count=32)
    with closing(for_learning(config, 1)) as learning, one_thread():
        model = PPO("MlpPolicy", learning, seed=1, device="cpu")
        before, earned = _apart(config, model, driver), evaluate(config, model)["return"]
        losses = imitate(config, ImitationConfig(driver=driver, rounds=3, decisions=3200, epochs=12), model, learning)
        after = _apart(config, model, driver)
    assert len(losses) == 3
    assert after < min(most, 0.7 * before)
    assert evaluate(config, model)["return"] > earned
    assert env != "Highway" or losses[-1] < 0.6 * math.log(5)  # of a policy that knows nothing


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


def test_its_episodes_are_none_that_learning_meets() -> None:
    config = experiment()
    assert episode_seeds(config, 0, "imitation") != episode_seeds(config, 0)


def test_who_cannot_imitate_or_be_imitated_is_refused() -> None:
    with pytest.raises(ConfigError, match="imitation must be left out of sac, got one: choose ppo or ppo_lagrangian"):
        experiment(algorithm="sac", imitation=SMALL)
    with pytest.raises(ConfigError, match="driver 'nominl' is unknown: did you mean 'nominal'"):
        experiment(imitation={"driver": "nominl"})
