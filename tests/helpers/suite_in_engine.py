"""A suite through the vector engine: rows of a table in minutes, where ``lanebound benchmark`` takes an hour.

    .venv/bin/python tests/helpers/suite_in_engine.py work_zone 24      # suite, episodes of each agent in each cell
    .venv/bin/python tests/helpers/suite_in_engine.py detectors 48 paired

Environments, skies, agents and changes are those of the suite; the seeds are consecutive from the first of its split.
``paired``: means, and below them differences to the reference of the suite, seed by seed, with 95 % intervals.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from drives import drives, single_of
from numpy.typing import NDArray

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.benchmark.metrics import HARM_OF_AN_END
from lanebound.agents.benchmark.statistics import difference
from lanebound.agents.benchmark.suite import load_suite
from lanebound.integrity.core.presets import deep_merge

__all__ = ["Cell", "cells"]

Array = NDArray[np.float64]
SUMMED = ("cost", "speed_mps", "alert", "cost_lane", "cost_off_road")
LAST = ("is_success", "crashed", "off_road")
COMPARED = ("alert", "cost", "harm", "throughput")


class Cell(NamedTuple):
    """Episodes of an agent under a sky.

    figures : arrays (n,) by name: sums over an episode (SUMMED), values at its end (LAST), its number of ``decisions``
    allotted : longest number of decisions of an episode
    """

    env: str
    sky: str
    agent: str
    figures: dict[str, Array]
    allotted: float

    def line(self) -> str:
        """The row of a table in Markdown; ± is a standard error."""
        f, n = self.figures, self.figures["cost"].size
        ends, error = " | ".join(f"{f[name].sum():.0f}" for name in LAST), f["cost"].std(ddof=1) / np.sqrt(n)
        speed, alert = (f[name].sum() / f["decisions"].sum() for name in ("speed_mps", "alert"))
        cost = f"{f['cost'].mean():.1f} ± {error:.1f}"
        return f"| {self.sky} | `{self.agent}` | {ends} | {cost} | {speed:.1f} | {alert:.2f} |"

    def compared(self) -> dict[str, Array]:
        """Share of alerts, cost, harm and throughput of each episode, as the benchmark defines them."""
        f = self.figures
        ended = (f["crashed"] > 0.0) | (f["cost_off_road"] > 0.0)
        taken = np.where(f["is_success"] > 0.0, f["decisions"], np.maximum(self.allotted, f["decisions"]))
        return {
            "alert": f["alert"] / f["decisions"],
            "cost": f["cost"],
            "harm": HARM_OF_AN_END * ended + f["cost_lane"],
            "throughput": f["speed_mps"] / taken,
        }

    def paired(self, reference: Cell) -> str:
        """The row of a table in Markdown: means, or for other agents than the reference differences to it."""
        ours, theirs = self.compared(), reference.compared()
        cells = [f"{ours[name].mean():.3g}" for name in COMPARED]
        if self is not reference:
            found = [difference(ours[name], theirs[name], None) for name in COMPARED]
            cells = [f"{d.difference:+.2g} ({_end(d.low)} to {_end(d.high)})" for d in found]
        ended = f"{self.figures['is_success'].sum():.0f}, {(ours['harm'] >= HARM_OF_AN_END).sum()}"
        return f"| {self.env} | {self.sky} | `{self.agent}` | {ended} | {' | '.join(cells)} |"


def _end(value: float | None) -> str:
    return "?" if value is None else f"{value:+.2g}"


def cells(name: str, episodes: int) -> Iterator[Cell]:
    """The cells of a suite, one after the other."""
    suite = load_suite(name)
    for env in suite.envs:
        for sky in suite.skies:
            for label, agent in suite.agents.items():
                config = deep_merge(deep_merge(suite.overrides, agent.config), {"sky": sky})
                figures = {key: np.zeros(episodes) for key in (*SUMMED, *LAST, "decisions")}
                for d in drives(env, config, agent.agent, dict(agent.figures) or None, episodes, suite.seeds.seeds[0]):
                    figures["decisions"][d.episode] += 1.0
                    for key in SUMMED:
                        figures[key][d.episode] += d.infos[key]
                    for key in LAST:
                        figures[key][d.episode[d.over]] = d.infos[key][d.over]
                single = single_of(env, config)
                yield Cell(env, sky, label, figures, allotted_s(single) * single.config.policy_hz)


if __name__ == "__main__":
    suite_name, count, pairs = sys.argv[1], int(sys.argv[2]), sys.argv[3:] == ["paired"]
    first = "| sky | agent | success | crash | off the road | cost | m/s | alert |\n|---|---|---|---|---|---|---|---|"
    if pairs:
        first = (
            "| id | sky | agent | success, ended badly | alert share | cost | harm | throughput [m/s] |\n"
            "|---|---|---|---|---|---|---|---|"
        )
    print(first)
    reference = None
    for cell in cells(suite_name, count):
        if cell.agent == load_suite(suite_name).references[0]:
            reference = cell
        print(cell.line() if not pairs or reference is None else cell.paired(reference), flush=True)
