"""Tolling by navigators and drivers: the tables of docs/results/tolling.md, through the vector engine.

    .venv/bin/python tests/helpers/tolling_table.py tolling 24      # suite, episodes of each cell

Skies, agents, figures and changes are those of the suite, whose agents are named ``driver_navigator``; the seeds are
consecutive from the first of its split. A drive does not depend on what is charged, so that positions are of any agent.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from drives import drives, single_of

from lanebound.agents.benchmark.suite import load_suite
from lanebound.agents.drivers.base import Reader
from lanebound.integrity.core.presets import deep_merge

__all__ = ["Row", "rows"]


class Row(NamedTuple):
    """An agent in a cell.

    objects: geo-objects, and of these over- and undercharged, and passed without a claim; tolled: driven ones that are
    tolled; cost, its standard error and return: of an episode; kept: episodes within the limit; level, error: 50, 95
    and 100 % of the decisions on links [m]; beyond: decisions with an error beyond its level.
    """

    sky: str
    agent: str
    objects: int
    over: int
    under: int
    deferred: int
    cost: float
    cost_error: float
    total_return: float
    kept: int
    level: list[float]
    error: list[float]
    beyond: int

    def line(self) -> str:
        """The row of a table in Markdown."""
        driver, _, navigator = self.agent.partition("_at_")
        counts = f"{self.over} | {self.under} | {100 * self.deferred / self.objects:.0f} %"
        level, error = (" / ".join(f"{v:.2g}" for v in found) for found in (self.level, self.error))
        return (
            f"| {self.sky} | {navigator} | `{driver}` | {self.objects} | {counts} | {self.cost:.2f} ± "
            f"{self.cost_error:.2f} | {self.total_return:.2f} | {self.kept} | {level} | {error} | {self.beyond} |"
        )


def rows(name: str, episodes: int) -> Iterator[Row]:
    """The rows of a suite, cell by cell."""
    suite = load_suite(name)
    for sky in suite.skies:
        for label, agent in suite.agents.items():
            config = deep_merge(deep_merge(suite.overrides, agent.config), {"sky": sky})
            single = single_of(suite.envs[0], deep_merge(config, {"observation": {"form": "flat"}}))
            reader, dt_s = Reader(single.config.observation), single.dt_s
            cost, total, counts = np.zeros(episodes), np.zeros(episodes), np.zeros(3)
            levels, errors = [], []
            for d in drives(suite.envs[0], config, agent.agent, dict(agent.figures) or None, episodes,
                            suite.seeds.seeds[0]):  # fmt: skip
                np.add.at(cost, d.episode, d.infos["cost"])
                np.add.at(total, d.episode, d.rewards)
                passed = np.abs(reader.value(d.observations, "road.toll_passed") - dt_s) < 0.1 * dt_s
                waits = passed & (reader.value(d.observations, "road.toll_open") > 0.5)
                counts += [d.infos["cost_overcharge"].sum(), d.infos["cost_undercharge"].sum(), waits.sum()]
                inside = reader.value(d.observations, "road.toll_inside") > 0.5
                levels.append(d.infos["pl_ct_m"][inside])
                errors.append(np.abs(d.infos["err_ct_m"][inside]))
            level, error = np.concatenate(levels), np.concatenate(errors)
            kept, spread = int((cost <= single.config.cost_limit).sum()), cost.std(ddof=1) / np.sqrt(episodes)
            yield Row(
                sky, label, episodes * len(single.world.tolled), *counts.astype(int).tolist(), float(cost.mean()),
                float(spread), float(total.mean()), kept, np.percentile(level, (50, 95, 100), method="lower").tolist(),
                np.percentile(error, (50, 95, 100)).tolist(), int((error > level).sum()),
            )  # fmt: skip


if __name__ == "__main__":
    suite_name, count = sys.argv[1], int(sys.argv[2])
    print("| sky | navigator | driver | objects | over | under | passed undecided | cost | return | kept | level | "
          "error | beyond |\n|" + "---|" * 13)  # fmt: skip
    for row in rows(suite_name, count):
        print(row.line(), flush=True)
