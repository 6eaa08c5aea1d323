"""What a policy comes to, on seeds that training does not draw."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.benchmark.seeds import SPLITS
from lanebound.agents.benchmark.suite import SuiteConfig, parse_agents
from lanebound.agents.learning.experiment import FLAT, ExperimentConfig, Shield
from lanebound.agents.learning.opening import for_judging
from lanebound.envs.tally import EPISODE_KEY
from lanebound.integrity.config import deep_merge
from lanebound.integrity.errors import InputError

__all__ = ["evaluate", "evaluation_suite", "learnt_agent", "trained"]


def evaluate(experiment: ExperimentConfig, model: BaseAlgorithm) -> dict[str, float]:
    """Means over episodes of the policy without its noise: return, cost, success, collision, speed and decisions.

    The seeds are the last of the training seeds: those of the benchmarks stay unseen, and none is drawn in training,
    where environments go on from a seed of their own.
    """
    seeds = SPLITS["train"][-experiment.evaluation_episodes :]
    env = for_judging(experiment, len(seeds))
    try:
        rows = [row for seed in seeds[:: env.num_envs] for row in _drive(env, model, seed)]
    finally:
        env.close()
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _drive(env: VecEnv, model: BaseAlgorithm, seed: int) -> list[dict[str, float]]:
    """An episode in each environment under the seeds from ``seed`` on; those that end sooner drive on, unnoted."""
    env.seed(seed)
    observations: Any = env.reset()
    rows: dict[int, dict[str, float]] = {}
    state: Any = None
    over = np.ones(env.num_envs, dtype=np.bool_)
    while len(rows) < env.num_envs:
        actions, state = model.predict(observations, state, over, deterministic=True)
        observations, _, over, infos = env.step(actions)
        for e in np.flatnonzero(over).tolist():
            rows.setdefault(e, _row(infos[e]))
    return [rows[e] for e in range(env.num_envs)]


def _row(info: Mapping[str, Any]) -> dict[str, float]:
    """What is noted of an episode, from what its end says."""
    episode = info[EPISODE_KEY]
    return {
        "return": episode["return"],
        "cost": episode["cost"],
        "success": float(info["is_success"]),
        "collision": float(info["crashed"]),
        "off_road": float(info["off_road"]),
        "speed_mps": episode["speed_mean_mps"],
        "length": float(episode["length"]),
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
