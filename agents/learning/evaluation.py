"""What a policy comes to, on seeds that training does not draw."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from lanebound.agents.benchmark.seeds import SPLITS
from lanebound.agents.benchmark.suite import SuiteConfig, parse_agents
from lanebound.agents.learning.experiment import FLAT, ExperimentConfig, Shield
from lanebound.agents.learning.shield import Shielded
from lanebound.integrity.config import deep_merge
from lanebound.integrity.errors import InputError

__all__ = ["evaluate", "evaluation_suite", "learnt_agent", "trained"]


def evaluate(experiment: ExperimentConfig, model: BaseAlgorithm) -> dict[str, float]:
    """Means over episodes of the policy without its noise: return, cost, success, collision, speed and decisions.

    The seeds are the last of the training seeds: those of the benchmarks stay unseen, and none is drawn in training,
    where environments go on from a seed of their own.
    """
    env: Any = experiment.open()
    if experiment.shield is Shield.CBF:
        env = Shielded(env)
    seeds = SPLITS["train"][-experiment.evaluation_episodes :]
    rows = [_drive(env, model, seed) for seed in seeds]
    env.close()
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _drive(env: Any, model: BaseAlgorithm, seed: int) -> dict[str, float]:
    observation, info = env.reset(seed=seed)
    total, cost, speed, steps, ended = 0.0, 0.0, 0.0, 0, False
    state: Any = None
    start = np.ones(1, dtype=np.bool_)
    while not ended:
        action, state = model.predict(observation, state, start, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        start = np.zeros(1, dtype=np.bool_)
        total, cost, speed, steps = total + reward, cost + info["cost"], speed + info["speed_mps"], steps + 1
        ended = terminated or truncated
    return {
        "return": total,
        "cost": cost,
        "success": float(info["is_success"]),
        "collision": float(info["crashed"]),
        "off_road": float(info["off_road"]),
        "speed_mps": speed / steps,
        "length": float(steps),
    }


def trained(folder: Path) -> tuple[ExperimentConfig, Path]:
    """The experiment of a folder of a training, and its best checkpoint.

    Raises
    ------
    InputError
        ``folder`` is none of a training, or has no checkpoint yet.
    """
    mark, best = folder / "experiment.json", folder / "best.zip"
    if not (mark.is_file() and best.is_file()):
        raise InputError(f"folder must be one of a training with best.zip, got {folder}: train first")
    return ExperimentConfig.load(json.loads(mark.read_text(encoding="utf-8"))), best


def learnt_agent(experiment: ExperimentConfig, checkpoint: Path) -> dict[str, Any]:
    """A checkpoint as an agent of a suite, under the filter that it was trained with, and seeing what it saw then."""
    config = deep_merge(experiment.overrides, FLAT)
    if experiment.shield is Shield.CBF:
        return {"agent": "cbf", "figures": {"over": str(checkpoint)}, "config": config}
    return {"agent": str(checkpoint), "config": config}


def evaluation_suite(folder: Path, agents: str, seeds: int) -> SuiteConfig:
    """The best checkpoint of a training beside other agents, on test seeds, where it was trained.

    Raises
    ------
    InputError
        ``folder`` is none of a training, or has no checkpoint yet; ConfigError for an agent that is unknown.
    """
    experiment, best = trained(folder)
    others = parse_agents(agents)
    reference = next(iter(others), "learnt")
    return SuiteConfig.load(
        {
            "title": f"{experiment.algorithm} in {experiment.env}",
            "envs": [experiment.env],
            "skies": [experiment.sky],
            "agents": {"learnt": learnt_agent(experiment, best), **others},
            "reference": reference,
            "seeds": {"split": "test", "count": seeds},
            "overrides": dict(experiment.overrides),
        }
    )
