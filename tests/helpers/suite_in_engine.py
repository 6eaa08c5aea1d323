"""A suite through the vector engine: rows of a table in minutes, where ``lanebound benchmark`` takes an hour.

    .venv/bin/python tests/helpers/suite_in_engine.py work_zone 24      # suite, episodes of each agent in each cell

Environments, skies, agents and changes are those of the suite; the seeds are consecutive from the first of its split.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from drives import drives

from lanebound.agents.benchmark.suite import load_suite
from lanebound.integrity.core.presets import deep_merge

__all__ = ["Row", "rows"]


class Row(NamedTuple):
    """Counts of episodes, and means over them, of an agent in a cell.

    cost_error: standard error of the mean cost; alert: share of the decisions.
    """

    env: str
    sky: str
    agent: str
    success: int
    crashed: int
    off_road: int
    cost: float
    cost_error: float
    speed_mps: float
    alert: float

    def line(self) -> str:
        """The row of a table in Markdown."""
        ends, cost = f"{self.success} | {self.crashed} | {self.off_road}", f"{self.cost:.1f} ± {self.cost_error:.1f}"
        return f"| {self.sky} | `{self.agent}` | {ends} | {cost} | {self.speed_mps:.1f} | {self.alert:.2f} |"


def rows(name: str, episodes: int) -> Iterator[Row]:
    """The rows of a suite, cell by cell."""
    suite = load_suite(name)
    for env in suite.envs:
        for sky in suite.skies:
            for label, agent in suite.agents.items():
                config = deep_merge(deep_merge(suite.overrides, agent.config), {"sky": sky})
                cost, ends = np.zeros(episodes), np.zeros((episodes, 3), dtype=np.int64)
                decisions = speed = alerts = 0.0
                for d in drives(env, config, agent.agent, dict(agent.figures) or None, episodes, suite.seeds.seeds[0]):
                    np.add.at(cost, d.episode, d.infos["cost"])
                    speed, alerts = speed + d.infos["speed_mps"].sum(), alerts + d.infos["alert"].sum()
                    decisions += d.episode.size
                    found = np.column_stack([d.infos[key] for key in ("is_success", "crashed", "off_road")])
                    ends[d.episode[d.over]] = found[d.over]
                error, means = cost.std(ddof=1) / np.sqrt(episodes), (speed / decisions, alerts / decisions)
                yield Row(env, sky, label, *ends.sum(axis=0).tolist(), float(cost.mean()), float(error), *means)


if __name__ == "__main__":
    suite_name, count = sys.argv[1], int(sys.argv[2])
    print("| sky | agent | success | crash | off the road | cost | m/s | alert |\n|---|---|---|---|---|---|---|---|")
    for row in rows(suite_name, count):
        print(row.line(), flush=True)
