"""Tables of a report: agents by metrics with intervals, and places by agents."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lanebound.agents.benchmark.metrics import MAIN, METRICS, Metric, metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Cell, Estimate, Results
from lanebound.agents.benchmark.statistics import SPREAD_SEEDS, VERDICT_SEEDS
from lanebound.agents.benchmark.verdicts import mean_over_cells
from lanebound.agents.report.numbers import SHARE, plain
from lanebound.agents.report.style import Actor, clear_best, slug_of, title_of, unit_of

__all__ = [
    "Head",
    "Overview",
    "Table",
    "TableEntry",
    "all_metrics",
    "head_of",
    "main_table",
    "means_table",
    "overviews",
]

ARROWS = {"higher": "↑", "lower": "↓"}


@dataclass(frozen=True)
class Head:
    """The head of a metric: its title, unit, the arrow of its good direction, and that in words."""

    key: str
    title: str
    unit: str
    arrow: str
    better: str
    meaning: str

    @property
    def both(self) -> tuple[str, str]:
        """Key and title."""
        return self.key, self.title


@dataclass(frozen=True)
class TableEntry:
    """A mean and its interval as text, or the reason for none; ``best`` where its interval is better than all others.

    ``seeds`` is their number where it is smaller than that of the driven ones.
    """

    mean: str
    interval: str = ""
    lacks: str = ""
    best: bool = False
    iqm: str = ""
    seeds: str = ""


@dataclass(frozen=True)
class TableRow:
    """An agent, its number of episodes, its entries, and whether it is untuned here."""

    actor: Actor
    episodes: int
    failed: int
    entries: list[TableEntry]
    untuned: bool = False


@dataclass(frozen=True)
class Table:
    """Agents by metrics."""

    heads: list[Head]
    rows: list[TableRow]


@dataclass(frozen=True)
class Overview:
    """One metric: places by agents; each line is ``(title, slug, entries)``."""

    head: Head
    agents: list[Actor]
    lines: list[tuple[str, str, list[TableEntry]]]


def head_of(metric: Metric) -> Head:
    """The head of a metric."""
    unit = unit_of(metric)
    better = f"{metric.better} is better" if metric.better else ""
    return Head(
        metric.key, metric.title, "" if unit == SHARE else unit, ARROWS.get(metric.better or "", ""), better,
        metric.meaning,
    )  # fmt: skip


def main_table(cells: Sequence[Cell], actors: Mapping[str, Actor]) -> Table:
    """The main metrics of the agents at one place."""
    return _table(cells, actors, [metric_named(key) for key in MAIN])


def means_table(results: Results, actors: Mapping[str, Actor]) -> Table:
    """The main metrics of the agents in the mean of all places, without intervals."""
    metrics = [metric_named(key) for key in MAIN]
    rows = []
    for name, actor in actors.items():
        cells = [cell for cell in results.cells if cell.agent == name]
        entries = [TableEntry(plain(mean_over_cells(results, name, m.key), unit_of(m))) for m in metrics]
        if cells:
            rows.append(TableRow(actor, sum(c.episodes for c in cells), sum(c.failed for c in cells), entries))
    return Table([head_of(metric) for metric in metrics], rows)


def all_metrics(cells: Sequence[Cell], actors: Mapping[str, Actor]) -> Table:
    """All metrics with a value of any agent."""
    return _table(cells, actors, [m for m in METRICS if any(cell.metrics[m.key].n for cell in cells)])


def _table(cells: Sequence[Cell], actors: Mapping[str, Actor], metrics: Sequence[Metric]) -> Table:
    columns = [_entries(metric, cells, actors) for metric in metrics]
    rows = [
        TableRow(actors[cell.agent], cell.episodes, cell.failed, [column[i] for column in columns], cell.untuned)
        for i, cell in enumerate(cells)
    ]
    return Table([head_of(metric) for metric in metrics], rows)


def _entries(metric: Metric, cells: Sequence[Cell], actors: Mapping[str, Actor]) -> list[TableEntry]:
    """One metric of the agents at one place; agents that observe the truth or failed are never best."""
    found = {cell.agent: cell.metrics[metric.key] for cell in cells}
    failed, seeds = {cell.agent for cell in cells if cell.failed}, max(cell.episodes for cell in cells)
    rivals = [
        (name, *((e.low, e.high) if e.n >= VERDICT_SEEDS else (None, None)))
        for name, e in found.items()
        if e.n and not actors[name].bound
    ]
    known = all(low is not None for _, low, _ in rivals)  # else an agent without interval may be better
    best = clear_best(rivals, metric.better) if known else None
    return [_entry(e, metric, name == best and name not in failed, seeds) for name, e in found.items()]


def _entry(estimate: Estimate, metric: Metric, best: bool, seeds: int) -> TableEntry:
    """One estimate; rates have no interquartile mean."""
    e, unit = estimate, unit_of(metric)
    iqm = "" if metric.rate else f"{plain(e.iqm, unit)} {_bare(e.iqm_low, e.iqm_high, unit)}"
    fewer = f"n = {e.n}" if 0 < e.n < seeds else ""
    return TableEntry(plain(e.mean, unit), _bare(e.low, e.high, unit), _lacking(e, metric), best, iqm, fewer)


def _lacking(e: Estimate, metric: Metric) -> str:
    """Why an estimate has no interval; "" where it has one, or does not exist."""
    if e.mean is None or e.low is not None:
        return ""
    if e.n < SPREAD_SEEDS:
        return f"{e.n} seed{'s' if e.n > 1 else ''}"
    if e.mean == 0.0 and metric.bounds[0] == 0.0:
        return f"never in {e.n}"
    alike = e.iqm is not None and math.isclose(e.mean, e.iqm, rel_tol=1e-9)
    return f"all {e.n} alike" if alike else "few seeds dominate"


def _bare(low: float | None, high: float | None, unit: str) -> str:
    """An interval in brackets, without the percent sign of the mean."""
    if low is None or high is None:
        return ""
    return f"[{plain(low, unit)}, {plain(high, unit)}]".replace(" %", "")


def overviews(places: Mapping[Place, Sequence[Cell]], actors: Mapping[str, Actor]) -> list[Overview]:
    """A table of all places for each main metric."""
    driven = {cell.agent for cells in places.values() for cell in cells}
    agents = [actor for name, actor in actors.items() if name in driven]
    return [_overview(metric_named(key), places, agents, actors) for key in MAIN]


def _overview(
    metric: Metric, places: Mapping[Place, Sequence[Cell]], agents: Sequence[Actor], actors: Mapping[str, Actor]
) -> Overview:
    lines = []
    for place, cells in places.items():
        found = dict(zip((cell.agent for cell in cells), _entries(metric, cells, actors), strict=True))
        lines.append((title_of(place), slug_of(place), [found.get(a.name, TableEntry("")) for a in agents]))
    return Overview(head_of(metric), list(agents), lines)
