"""What a policy comes to, on seeds that training does not draw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.metrics import HARM_OF_AN_END
from lanebound.agents.benchmark.seeds import SPLITS
from lanebound.agents.benchmark.suite import SuiteConfig, parse_agents
from lanebound.agents.checkpointing.folder import ResultFolder
from lanebound.agents.learning.experiment import FLAT, ExperimentConfig, Shield
from lanebound.agents.learning.opening import for_judging
from lanebound.envs.tally import EPISODE_KEY
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.errors import InputError

__all__ = ["drive_all", "evaluate", "evaluation_suite", "learnt_agent", "trained"]


def evaluate(experiment: ExperimentConfig, model: BaseAlgorithm) -> dict[str, float]:
    """Means over episodes of the policy without its noise, and the standard error of the cost (``cost_se``).

    The seeds are the last of the training seeds: those of the benchmarks stay unseen, and none is drawn in training,
    where environments go on from a seed of their own.
    """
    rows = drive_all(experiment, model, SPLITS["train"][-experiment.evaluation_episodes :])
    costs = [row["cost"] for row in rows]
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return {**means, "cost_se": float(np.std(costs, ddof=1)) / math.sqrt(len(costs)) if len(costs) > 1 else 0.0}


def drive_all(experiment: ExperimentConfig, model: BaseAlgorithm, seeds: Sequence[int]) -> list[dict[str, float]]:
    """What the policy without its noise comes to under each of consecutive seeds; in the engine all at once.

    Of an episode, by the names of the benchmark's metrics: ``return, cost, over_cost_limit, success, collision,
    off_road, lane_departure, harm, mean_speed, throughput, alert_share, any_hmi``, and ``length`` in decisions. The way
    of ``throughput`` is the true speed at each decision times its duration.
    """
    with closing(experiment.open()) as single:
        terms = Terms(single.config.cost_limit, single.dt_s, allotted_s(single))
    env = for_judging(experiment, len(seeds))
    try:
        return [_row(info, terms) for seed in seeds[:: env.num_envs] for info in _drive(env, model, seed)]
    finally:
        env.close()


class Terms(NamedTuple):
    """What all episodes of an environment have in common: limit of cost, time of a decision and in all [s]."""

    cost_limit: float
    dt_s: float
    allotted_s: float


def _drive(env: VecEnv, model: BaseAlgorithm, seed: int) -> list[Mapping[str, Any]]:
    """How an episode ends in each environment, under the seeds from ``seed`` on; who ends sooner drives on, unnoted."""
    env.seed(seed)
    observations: Any = env.reset()
    ends: dict[int, Mapping[str, Any]] = {}
    state: Any = None
    over = np.ones(env.num_envs, dtype=np.bool_)
    while len(ends) < env.num_envs:
        actions, state = model.predict(observations, state, over, deterministic=True)
        observations, _, over, infos = env.step(actions)
        for e in np.flatnonzero(over).tolist():
            ends.setdefault(e, infos[e])
    return [ends[e] for e in range(env.num_envs)]


def _row(info: Mapping[str, Any], terms: Terms) -> dict[str, float]:
    """What is noted of an episode, from what its end says."""
    episode = info[EPISODE_KEY]
    success, collision, off_road = bool(info["is_success"]), bool(info["crashed"]), episode["cost_off_road"] > 0.0
    time_s = terms.dt_s * episode["length"]
    taken_s = time_s if success else max(terms.allotted_s, time_s)
    return {
        "return": episode["return"],
        "cost": episode["cost"],
        "over_cost_limit": float(episode["cost"] > terms.cost_limit),
        "success": float(success),
        "collision": float(collision),
        "off_road": float(off_road),
        "lane_departure": float(episode["cost_lane"] > 0.0),
        "harm": HARM_OF_AN_END * float(collision or off_road) + episode["cost_lane"],
        "mean_speed": episode["speed_mean_mps"],
        "throughput": episode["speed_mean_mps"] * time_s / taken_s,
        "alert_share": episode["alert_share"],
        "any_hmi": float(episode["hmi_steps"] > 0),
        "length": float(episode["length"]),
    }


def trained(folder: Path) -> tuple[ExperimentConfig, Path]:
    """The experiment of a folder of a training, and its best checkpoint.

    Raises
    ------
    InputError
        ``folder`` is none of a training, has no checkpoint yet, or is damaged.
    """
    best = folder / "best.zip"
    if not best.is_file():
        raise InputError(f"folder must be one of a training with best.zip, got {folder}: train first")
    return ExperimentConfig.load(ResultFolder(folder, "training").manifest()["config"]), best


def learnt_agent(experiment: ExperimentConfig, checkpoint: Path) -> dict[str, Any]:
    """A checkpoint as an agent of a suite, under the filter that it was trained with, and seeing what it saw then."""
    config = deep_merge(experiment.overrides, FLAT)
    if experiment.shield is Shield.CBF:
        return {"agent": "cbf", "figures": {"over": str(checkpoint)}, "config": config}
    return {"agent": str(checkpoint), "config": config}


def evaluation_suite(folder: Path, agents: str, seeds: int, skip: int = 0) -> SuiteConfig:
    """The best checkpoint of a training beside other agents where it was trained, on test seeds but the first ``skip``.

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
            "seeds": {"split": "test", "count": seeds, "skip": skip},
            "overrides": dict(experiment.overrides),
        }
    )
