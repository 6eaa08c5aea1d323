"""Evaluation of a policy, on seeds that training does not draw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import GROUP_COST
from lanebound.agents.benchmark.scoring import UNNAMED, outcome_of_statistics
from lanebound.agents.benchmark.suite import SPLITS, SuiteConfig, parse_agents
from lanebound.agents.checkpointing.folder import ResultFolder
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.foreign import load_checkpoint, require_foreign
from lanebound.agents.drivers.origin import environment_in, experiment_in
from lanebound.agents.episodes import open_env
from lanebound.agents.learning.algorithms import CLASSES
from lanebound.agents.learning.experiment import FLAT, ExperimentConfig, Shield
from lanebound.agents.learning.opening import for_judging
from lanebound.envs.config import EnvConfig
from lanebound.envs.costs import GROUPS
from lanebound.envs.episode_totals import EPISODE_KEY
from lanebound.integrity.core.config import deep_merge
from lanebound.integrity.core.errors import InputError

__all__ = ["JUDGED", "drive_all", "evaluate", "evaluation_suite", "learnt_agent", "trained"]

JUDGED = (
    "return", "cost", "over_cost_limit", "success", "collision", "off_road", "lane_departure", "harm", "mean_speed",
    "throughput", "alert_share", "any_hmi", *(f"over_{group}_limit" for group in GROUPS), "within_all_limits",
)  # fmt: skip
"""Metrics of an episode in evaluations of checkpoints; those about limits where there are limits."""
KINDS = {path.rpartition(":")[2]: algorithm for algorithm, path in CLASSES.items()}


def evaluate(experiment: ExperimentConfig, model: BaseAlgorithm) -> dict[str, float]:
    """Means over episodes of the policy without its noise, and standard errors of the costs with a limit (``cost_se``).

    The seeds are the last training seeds: those of the benchmarks stay unseen, and training does not use them, because
    its environments continue from a seed of their own.
    """
    rows = drive_all(experiment, model, SPLITS["train"][-experiment.evaluation_episodes :])
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    means = {name: float(np.mean(values)) for name, values in columns.items()}
    limited = [name for name in columns if name == "cost" or name.startswith(GROUP_COST)]
    return {**means, **{f"{name}_se": _standard_error(columns[name]) for name in limited}}


def _standard_error(values: Sequence[float]) -> float:
    """Of the mean; 0 of a single value."""
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else 0.0


def drive_all(experiment: ExperimentConfig, model: BaseAlgorithm, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Metrics of the policy without exploration under each of consecutive seeds; in the engine all at once.

    Of an episode: the benchmark's metrics :data:`JUDGED`, ``length`` in decisions, and the weighted costs of each group
    that has a limit (``group_cost_lane`` and so on). The way of ``throughput`` is the true speed at each decision times
    its duration.
    """
    with closing(experiment.open()) as single:
        dt_s, longest_s = single.dt_s, allotted_s(single)
    config = experiment.env_config.replace(cost_limit=experiment.limit())
    env = for_judging(experiment, len(seeds))
    try:
        ends = [info for seed in seeds[:: env.num_envs] for info in _drive(env, model, seed)]
    finally:
        env.close()
    return [_row(info, dt_s, config, longest_s) for info in ends]


def _drive(env: VecEnv, model: BaseAlgorithm, seed: int) -> list[Mapping[str, Any]]:
    """The last info of an episode in each environment, under the seeds from ``seed`` on; later episodes are ignored."""
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


def _row(info: Mapping[str, Any], dt_s: float, config: EnvConfig, allotted_s: float) -> dict[str, float]:
    """Metrics of an episode, from the info of its last step."""
    episode = info[EPISODE_KEY]
    times = {"time_s": dt_s * episode["length"], "allotted_s": allotted_s}
    outcome = outcome_of_statistics(info, episode, UNNAMED, config, **times)
    found = {key: metric_named(key).take(outcome) for key in JUDGED}
    known = {key: value for key, value in found.items() if value is not None}
    groups = {GROUP_COST + group: value for group, value in outcome.group_costs.items()}
    return {**known, "length": float(outcome.steps), **groups}


def trained(
    source: Path, env: str | None = None, changes: Mapping[str, Any] | None = None
) -> tuple[ExperimentConfig, Path]:
    """The experiment of a training and its checkpoint, from a folder or from a checkpoint alone.

    Parameters
    ----------
    source : folder of a training, whose best checkpoint is taken, or a checkpoint of Stable-Baselines3
    env, changes : id, and values of an experiment (``sky``, ``overrides``), over those that ``source`` holds

    Raises
    ------
    InputError
        ``source`` is neither, has no checkpoint yet, is damaged, or does not say where it was learnt and ``env`` is
        None; ConfigError where a value is refused.
    """
    best = source / "best.zip"
    if source.suffix == ".zip" and source.is_file():
        require_foreign(str(source))
        found = experiment_in(source)
        if found is None:
            env = env or environment_in(source) or None
            if env is None:
                raise InputError(f"{source} must say where it was learnt, but holds no experiment: add --env ID")
            kind = type(load_checkpoint(source)).__name__
            found = {"title": f"{kind} of {source.name}"} | ({"algorithm": KINDS[kind]} if kind in KINDS else {})
        return ExperimentConfig.build(found or {}, {**(changes or {}), **({} if env is None else {"env": env})}), source
    if not best.is_file():
        raise InputError(f"TRAINING must be a folder with best.zip or a checkpoint .zip, got {source}: train first")
    found = ResultFolder(source, "training").manifest()["config"]
    return ExperimentConfig.build(found, {**(changes or {}), **({} if env is None else {"env": env})}), best


def learnt_agent(experiment: ExperimentConfig, checkpoint: Path) -> dict[str, Any]:
    """A checkpoint as an agent of a suite, with the filter and the observations of its training."""
    config = deep_merge(experiment.overrides, FLAT)
    if experiment.shield is Shield.CBF:
        return {"agent": "cbf", "figures": {"over": str(checkpoint)}, "config": config}
    if experiment.shield is Shield.LAYER:
        return {
            "agent": "layer",
            "figures": {"over": str(checkpoint), **experiment.rules.to_dict()},
            "config": config,
        }
    return {"agent": str(checkpoint), "config": config}


def evaluation_suite(
    source: Path, agents: str, seeds: int, skip: int = 0, env: str | None = None,
    changes: Mapping[str, Any] | None = None,
) -> SuiteConfig:  # fmt: skip
    """A suite of a learnt policy beside other agents where it was trained, on test seeds but the first ``skip``.

    Parameters
    ----------
    source, env, changes : as of :func:`trained`

    Raises
    ------
    InputError
        As :func:`trained`, or the policy has other actions or observations than the environment; ConfigError for an
        agent that is unknown.
    """
    experiment, best = trained(source, env, changes)
    others = parse_agents(agents)
    reference = next(iter(others), "learnt")
    suite = SuiteConfig.load(
        {
            "title": f"{experiment.algorithm} in {experiment.env}",
            "envs": [experiment.env],
            "skies": [experiment.sky],
            "agents": {"learnt": learnt_agent(experiment, best), **others},
            "reference": reference,
            "seeds": {"split": "test", "count": seeds, "skip": skip},
            "overrides": {**experiment.overrides, "cost_limit": experiment.limit()},
        }
    )
    _require_fitting(suite)
    return suite


def _require_fitting(suite: SuiteConfig) -> None:
    """Refuse a policy that cannot drive in its environment, such as one with other actions."""
    chosen, place = suite.agents["learnt"], suite.places[0]
    with closing(open_env(place.env, suite.env_overrides(place, "learnt"))) as env:
        make_agent(chosen.agent, env, chosen.figures)
