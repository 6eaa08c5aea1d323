"""Drives with and without the safety layer, for the table of docs/training.md.

``python tests/helpers/layer_table.py [IDS...] [--seeds 20] [--rules '{"least_share": 0}'] [--config '{...}']`` drives
the random and the nominal agent on the first training seeds in each id as shipped, and prints a line for each: without
the layer → with it. Changed: share of the decisions that a rule changed, and by rule [%].
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from lanebound.agents.benchmark.suite import TRAIN
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.rules import RULES
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.opening import full_id
from lanebound.agents.interventions import INTERVENTIONS_KEY
from lanebound.agents.safety_layer import VecSafetyLayer
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.envs import IDS
from lanebound.envs.episode_totals import EPISODE_KEY

HEAD = ("id", "agent", "cost", "crashes", "off road", "successes", "return", "m/s", "changed")


def drive(env_id: str, agent: str, seeds: int, config: Mapping[str, Any], rules: Mapping[str, Any] | None) -> list[Any]:
    """The last info of an episode under each seed; ``rules`` None: without the layer."""
    env: Any = EngineVecEnv(env_id, seeds, config, statistics=True)
    if rules is not None:
        env = VecSafetyLayer(env, rules)
    driver: Any = make_agent(agent, open_env(env_id, dict(config)))
    env.seed(TRAIN[0])
    observations, ends, state, over = env.reset(), {}, None, np.ones(seeds, dtype=np.bool_)
    while len(ends) < seeds:
        actions, state = driver.predict(observations, state, over, True)
        observations, _, over, infos = env.step(actions)
        for e in np.flatnonzero(over).tolist():
            ends.setdefault(e, infos[e])
    env.close()
    return list(ends.values())


def figures(ends: list[Any]) -> list[str]:
    """Mean cost with its standard error, numbers of episodes, and means."""

    def mean(name: str) -> float:
        return float(np.mean([end[EPISODE_KEY][name] for end in ends]))

    costs = [end[EPISODE_KEY]["cost"] for end in ends]
    crash, off = (sum(end[EPISODE_KEY][f"cost_{name}"] > 0 for end in ends) for name in ("collision", "off_road"))
    error = np.std(costs, ddof=1) / np.sqrt(len(costs))
    row = [f"{np.mean(costs):.1f} ± {error:.1f}", f"{crash}", f"{off}", f"{mean('is_success') * len(ends):.0f}"]
    return [*row, f"{mean('return'):.1f}", f"{mean('speed_mean_mps'):.1f}"]


def changed(ends: list[Any]) -> str:
    """Share of the decisions that were changed, and by which rules, largest first."""
    totals = {name: sum(end[INTERVENTIONS_KEY][name] for end in ends) for name in ends[0][INTERVENTIONS_KEY]}
    share = {name: 100.0 * totals[name] / totals["decisions"] for name in ("intervened", *RULES)}
    by = sorted((name for name in RULES if share[name] >= 0.5), key=lambda name: -share[name])
    return f"{share['intervened']:.0f}: {', '.join(f'{name} {share[name]:.0f}' for name in by)}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("ids", nargs="*")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--agents", default="random,nominal")
    parser.add_argument("--rules", type=json.loads, default={})
    parser.add_argument("--config", type=json.loads, default={})
    given = parser.parse_args()
    torch.set_num_threads(1)
    print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
    for env_id in [full_id(name) for name in given.ids] or list(IDS):
        for agent in given.agents.split(","):
            free, bound = (drive(env_id, agent, given.seeds, given.config, rules) for rules in (None, given.rules))
            pairs = zip(figures(free), figures(bound), strict=True)
            row = [f"{one} → {two}" if one != two else one for one, two in pairs]
            name = env_id.removeprefix("lanebound/").removesuffix("-v0")
            print("| " + " | ".join([name, f"`{agent}`", *row, changed(bound)]) + " |", flush=True)


if __name__ == "__main__":
    main()
