"""Tolling by navigators and drivers: the tables of docs/results/tolling.md, through the vector engine.

    .venv/bin/python tests/helpers/tolling_table.py tolling 24 suburban      # suite, episodes of each cell, skies

Agents, figures and changes are those of the suite; the seeds are consecutive from the first of its split. What is
charged does not change the drive, so that all agents of one configuration decide on one drive that defers: the first
claim of each about an open geo-object counts.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from drives import single_of

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.benchmark.suite import load_suite
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.episodes import full_id
from lanebound.envs.batch.toll_kernel import CHARGE, DEFER, SPARE
from lanebound.integrity.core.presets import deep_merge

__all__ = ["Row", "decided", "rows"]


class Row(NamedTuple):
    """An agent in a cell.

    objects: geo-objects, of these due, over- and undercharged, and passed without a claim; costs, returns: of episodes;
    kept: episodes within the limit; level, error: 50, 95 and 100 % of the decisions on links [m]; beyond: decisions
    with an error beyond its level.
    """

    objects: int
    due: int
    over: int
    under: int
    waited: int
    costs: list[float]
    returns: list[float]
    kept: int
    level: list[float]
    error: list[float]
    beyond: int

    def line(self) -> str:
        """Columns of a table in Markdown."""
        cost, spread = np.mean(self.costs), np.std(self.costs, ddof=1) / np.sqrt(len(self.costs))
        level, error = (" / ".join(f"{v:.2g}" for v in found) for found in (self.level, self.error))
        return (
            f"{self.over} of {self.objects - self.due} | {self.under} of {self.due} | "
            f"{100 * self.waited / self.objects:.0f} | {cost:.2f} ± {spread:.2f} | {np.mean(self.returns):.2f} | "
            f"{self.kept} | {level} | {error} | {self.beyond}"
        )


def decided(
    env: str, config: Mapping[str, Any], agents: Mapping[str, tuple[str, Any]], episodes: int, seed: int
) -> dict[str, Row]:
    """Each agent (name, figures) of a configuration on the same drives, by its label."""
    made = deep_merge(config, {"observation": {"form": "flat"}})
    single = single_of(env, made)
    reader, weights = Reader(single.config.observation), single.config.cost
    drivers = [make_agent(name, single, figures) for name, figures in agents.values()]
    envs = gymnasium.make_vec(full_id(env), episodes, config=made, autoreset_mode="Disabled")
    observations, _ = envs.reset(seed=seed)
    tolls, rows_ = envs.unwrapped.engine.episodes.ego["toll"], np.arange(episodes)  # type: ignore[attr-defined]
    count = int(tolls["objects"][0])
    claims, waited = np.full((len(drivers), episodes, count), DEFER), np.zeros(len(drivers), dtype=np.int64)
    levels, errors, over = [], [], np.zeros(episodes, dtype=np.bool_)
    while not over.all():
        is_open, place = reader.value(observations, "road.toll_open") > 0.5, np.maximum(tolls["open"], 0)
        leaves = is_open & (np.abs(reader.value(observations, "road.toll_passed") - single.dt_s) < 0.1 * single.dt_s)
        for made_so_far, driver, k in zip(claims, drivers, range(len(drivers)), strict=True):
            decides = is_open & (made_so_far[rows_, place] == DEFER)
            waited[k] += (leaves & decides).sum()
            given, _ = driver.predict(observations)
            made_so_far[rows_[decides], place[decides]] = given[decides]
        observations, _, terminated, truncated, infos = envs.step(np.full(episodes, DEFER))
        inside = reader.value(observations, "road.toll_inside") > 0.5
        levels.append(infos["pl_ct_m"][inside])
        errors.append(np.abs(infos["err_ct_m"][inside]))
        over = terminated | truncated  # of all in the same step: nothing but the time ends a drive
    assert (tolls["settled"] == count).all()
    due = tolls["driven"][:, :count] == tolls["tolled"][:, :count]
    charged, spared = claims == CHARGE, claims == SPARE
    wrong, missed, right = charged & ~due, ~charged & due, (charged & due) | (spared & ~due)
    costs = weights.overcharge * wrong.sum(axis=2) + weights.undercharge * missed.sum(axis=2)
    kept, beyond = (costs <= single.config.cost_limit).sum(axis=1), np.concatenate(errors) > np.concatenate(levels)
    sizes = [np.percentile(np.concatenate(v), (50, 95, 100), method="lower").tolist() for v in (levels, errors)]
    return {
        label: Row(
            due.size, int(due.sum()), int(wrong[k].sum()), int(missed[k].sum()), int(waited[k]), costs[k].tolist(),
            right[k].sum(axis=1).tolist(), int(kept[k]), *sizes, int(beyond.sum()),
        )
        for k, label in enumerate(agents)
    }  # fmt: skip


def rows(name: str, episodes: int, skies: Sequence[str] = ()) -> Iterator[tuple[str, str, Row]]:
    """Sky, agent and row of a suite, cell by cell."""
    suite = load_suite(name)
    for sky in skies or suite.skies:
        cells: list[tuple[dict[str, Any], dict[str, tuple[str, Any]]]] = []
        for label, agent in suite.agents.items():
            config = deep_merge(deep_merge(suite.overrides, agent.config), {"sky": sky})
            known = next((agents for other, agents in cells if other == config), None)
            if known is None:
                cells.append((config, known := {}))
            known[label] = agent.agent, dict(agent.figures) or None
        for config, agents in cells:
            for label, row in decided(suite.envs[0], config, agents, episodes, suite.seeds.seeds[0]).items():
                yield sky, label, row


if __name__ == "__main__":
    print("| sky | agent | over | under | passed undecided [%] | cost | return | kept | level | error | beyond |")
    print("|" + "---|" * 11)
    for sky, label, row in rows(sys.argv[1], int(sys.argv[2]), sys.argv[3:]):
        print(f"| {sky} | {label} | {row.line()} |", flush=True)
