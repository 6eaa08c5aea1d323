"""The tables and pictures of one place of a benchmark, from its stored episodes.

Tables have agents by metrics with intervals, and places by agents; episodes are those to assess, and the worst ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lanebound.agents.benchmark.metrics import MAIN, METRICS, Metric, metric_named
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.results import Cell, Estimate, Results
from lanebound.agents.benchmark.statistics import SPREAD_SEEDS, VERDICT_SEEDS
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.verdicts import mean_over_cells
from lanebound.agents.report.charts import (
    AXIS_NAMES,
    CostBar,
    EpisodeTrace,
    ParetoAxis,
    ParetoPoint,
    forest,
    pareto,
    share_text,
    stacked,
    stanford,
    trace,
)
from lanebound.agents.report.style import SHARE, Actor, clear_best, plain, replay_command, slug_of, title_of, unit_of
from lanebound.envs.costs import CAUSES, CostConfig
from lanebound.integrity.assessment.plotting import ZoneCounts
from lanebound.integrity.assessment.record import AXES, Record, Zone
from lanebound.integrity.positioning.modes import Mode

BAD_ENDS = ("collision", "off road", "wrong way")
SECONDS = "time_s"
TAKEN = ("time_s", "mode", "err_at_m", "err_ct_m", "pl_at_m", "pl_ct_m", "al_at_m", "al_ct_m", "alert", "available")
Columns = dict[str, NDArray[Any]]


def trace_of(results: Results, outcome: Outcome) -> EpisodeTrace | None:
    """Belief and truth of an episode after every decision; None without stored rows."""
    columns = _columns(results, outcome)
    return None if columns is None else _traced([columns])


def pooled(results: Results, outcomes: Iterable[Outcome]) -> EpisodeTrace | None:
    """The same of many episodes, one after the other; their time counts decisions."""
    parts = [columns for outcome in outcomes if (columns := _columns(results, outcome)) is not None]
    return _traced(parts) if parts else None


def _columns(results: Results, outcome: Outcome) -> Columns | None:
    """The needed columns of the decisions with finite errors."""
    if results.folder is None:
        return None
    import pyarrow.parquet as pq

    table = pq.ParquetFile(EpisodeStore(results.folder).path(outcome.task)).read(columns=list(TAKEN))
    if table.num_rows < 2:
        return None
    found: Columns = {name: table[name].to_numpy() for name in TAKEN}
    keep = np.isfinite(found["err_at_m"]) & np.isfinite(found["err_ct_m"])
    keep[0] = False
    return {name: values[keep] for name, values in found.items()} if keep.any() else None


def _traced(parts: Sequence[Columns]) -> EpisodeTrace:
    """One record; where alert limits change, errors and levels are scaled to the first limit."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in TAKEN}
    limits = {axis: joined[f"al_{axis}_m"] for axis in AXES}
    first = {axis: float(limit[0]) for axis, limit in limits.items()}
    ratio = {axis: first[axis] / limit for axis, limit in limits.items()}
    many = len(parts) > 1
    record = Record(
        time_s=np.arange(1.0, joined[SECONDS].size + 1.0) if many else joined[SECONDS],
        mode=np.array([int(Mode.named(key)) for key in joined["mode"]]),
        error_at_m=joined["err_at_m"] * ratio["at"],
        error_ct_m=joined["err_ct_m"] * ratio["ct"],
        pl_at_m=joined["pl_at_m"] * ratio["at"],
        pl_ct_m=joined["pl_ct_m"] * ratio["ct"],
        alert=joined["alert"].astype(bool),
        available=joined["available"].astype(bool),
    )
    return EpisodeTrace(record, first["at"], first["ct"])


def what_happened(outcome: Outcome) -> str:
    """Why an episode counts as a failure; "" where it does not."""
    if outcome.failed:
        return f"{outcome.status.replace('_', ' ')}: {outcome.message}" if outcome.message else outcome.status
    if outcome.ended in BAD_ENDS:
        return outcome.ended
    return "" if outcome.success else f"no success ({outcome.ended})"


def badness(outcome: Outcome) -> tuple[int, float]:
    """Sort key of the worst episodes: bad ends first, then by cost."""
    return int(outcome.ended in BAD_ENDS), outcome.cost


def worst_of(outcomes: Iterable[Outcome], actors: Mapping[str, Actor], count: int) -> list[Outcome]:
    """The worst episode of each agent, the worst first; equal drives of several agents count once.

    Agents that failed are left out, and agents that act at random where others drove.
    """
    driven = [o for o in outcomes if not o.failed]
    serious = [o for o in driven if not actors[o.agent].chance] or driven
    worst: dict[str, Outcome] = {}
    for outcome in serious:
        if outcome.agent not in worst or badness(outcome) > badness(worst[outcome.agent]):
            worst[outcome.agent] = outcome
    different = {(o.seed, o.cost, o.total_return): o for o in reversed(worst.values())}
    return sorted(different.values(), key=badness, reverse=True)[:count]


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


GAINS = ("return", "success", "throughput", "mean_speed")
WORST, WORST_OF_MANY = 3, 1  # episodes whose traces a place shows, and where there are many places
MANY_PLACES = 12


@dataclass(frozen=True)
class ChartChoice:
    """One of several pictures of the same kind."""

    key: str
    title: str
    picture: Markup

    @property
    def both(self) -> tuple[str, str]:
        """Key and title."""
        return self.key, self.title


@dataclass(frozen=True)
class Forests:
    """Differences against a reference: a picture for each metric."""

    against: str
    pictures: list[ChartChoice]


@dataclass(frozen=True)
class Diagram:
    """The Stanford diagrams of an agent; each line of its table is ``(zone, number, share along, share across)``."""

    actor: Actor
    epochs: int
    pictures: list[Markup]
    lines: list[tuple[str, int, str, str]]


@dataclass(frozen=True)
class TraceView:
    """One of the worst episodes."""

    outcome: Outcome
    figures: str
    picture: Markup
    command: str


@dataclass(frozen=True)
class PlaceView:
    """All tables and pictures of a place."""

    slug: str
    title: str
    env: str
    main: Table
    full: Table
    forests: list[Forests]
    fronts: list[ChartChoice]
    costs: Markup | None
    diagrams: list[Diagram]
    traces: list[TraceView]


def view_of(results: Results, place: Place, cells: Sequence[Cell], actors: Mapping[str, Actor]) -> PlaceView:
    """The view of a place where the agents of ``cells`` drove."""
    here = [outcome for outcome in results.outcomes if outcome.task.place == place]
    return PlaceView(
        slug=slug_of(place),
        title=title_of(place),
        env=place.env,
        main=main_table(cells, actors),
        full=all_metrics(cells, actors),
        forests=[
            found for against in results.suite.references if (found := _forests(results, cells, against)).pictures
        ],
        fronts=_fronts(cells, actors),
        costs=_costs(results, place, here, [cell.agent for cell in cells]),
        diagrams=_diagrams(results, here, [actors[cell.agent] for cell in cells]),
        traces=_traces(results, here, actors),
    )


def _forests(results: Results, cells: Sequence[Cell], against: str) -> Forests:
    """Paired differences from a reference in the main metrics that have intervals."""
    found = []
    names = {cell.agent: f"{cell.agent}, untuned" if cell.untuned else cell.agent for cell in cells}
    for metric in (metric_named(key) for key in MAIN):
        rows = {
            names[pair.agent]: pair
            for pair in results.paired
            if (pair.place, pair.against, pair.metric) == (cells[0].place, against, metric.key)
            if pair.difference is not None
        }
        if any(row.low is not None for row in rows.values()):
            picture = forest(metric.title, unit_of(metric), metric.better, names[against], rows)
            found.append(ChartChoice(metric.key, metric.title, picture))
    return Forests(names.get(against, against), found)


def _fronts(cells: Sequence[Cell], actors: Mapping[str, Actor]) -> list[ChartChoice]:
    """Cost against gains."""
    return [choice for key in GAINS if (choice := _front(key, cells, actors)) is not None]


def _front(key: str, cells: Sequence[Cell], actors: Mapping[str, Actor]) -> ChartChoice | None:
    gain, spots = metric_named(key), []
    for cell in cells:
        x, y = (_spread(cell, name) for name in ("cost", key))
        if x is not None and y is not None:
            spots.append(ParetoPoint(cell.agent, actors[cell.agent].look, x, y, actors[cell.agent].bound))
    if not spots:
        return None
    sides = [ParetoAxis(m.title, "" if unit_of(m) == SHARE else m.unit, m.better) for m in (metric_named("cost"), gain)]
    return ChartChoice(key, gain.title, pareto(spots, *sides))


def _spread(cell: Cell, key: str) -> tuple[float, float, float] | None:
    """Mean and interval of a metric; the mean alone where there is no interval."""
    found = cell.metrics[key]
    if found.mean is None:
        return None
    low, high = (found.mean if end is None else end for end in (found.low, found.high))
    return found.mean, low, high


def causes() -> list[tuple[str, str]]:
    """The causes of cost in the order of their colours, as ``(title, meaning)``."""
    known = {metric.key: metric for metric in METRICS}
    return [(_cause(name), known[name].meaning) for name in CAUSES]


def _cause(name: str) -> str:
    return name.removeprefix("cost_").replace("_", " ")


def _costs(results: Results, place: Place, here: Sequence[Outcome], agents: Sequence[str]) -> Markup | None:
    """Mean weighted cost of an episode by cause; the bars end at the mean cost."""
    stacks = []
    for agent in agents:
        driven = [outcome for outcome in here if outcome.agent == agent and not outcome.failed]
        if driven:
            weights = _weights(results, place, agent)
            parts = {c: weights[c] * float(np.mean([o.costs.get(c, 0.0) for o in driven])) for c in CAUSES}
            stacks.append(CostBar(agent, {_cause(cause): value for cause, value in parts.items()}))
    return stacked("Costs by cause", stacks) if stacks else None


def _weights(results: Results, place: Place, agent: str) -> dict[str, float]:
    from lanebound.agents.episodes.opening import full_id
    from lanebound.envs import IDS, make_config

    env_id = full_id(place.env)
    costs = make_config(env_id, results.suite.env_overrides(place, agent)).cost if env_id in IDS else CostConfig()
    return costs.weights


def _diagrams(results: Results, here: Sequence[Outcome], actors: Sequence[Actor]) -> list[Diagram]:
    found = []
    for actor in actors:
        driven = pooled(results, (outcome for outcome in here if outcome.agent == actor.name))
        if driven is not None:
            both = [stanford(actor.name, driven.record, axis, driven.limit_m(axis)) for axis in AXES]
            lines = _zone_lines(*(zones for _, zones in both))
            found.append(Diagram(actor, driven.record.epochs, [picture for picture, _ in both], lines))
    return found


def _zone_lines(at: ZoneCounts, ct: ZoneCounts) -> list[tuple[str, int, str, str]]:
    return [(zone.label, int(zone), share_text(at.rate(zone)), share_text(ct.rate(zone))) for zone in Zone]


def _traces(results: Results, here: Sequence[Outcome], actors: Mapping[str, Actor]) -> list[TraceView]:
    found = []
    count = WORST if len(results.suite.places) <= MANY_PLACES else WORST_OF_MANY
    for outcome in worst_of(here, actors, count):
        driven = trace_of(results, outcome)
        if driven is not None:
            title = f"{outcome.agent}, seed {outcome.seed}"
            picture = trace(driven, f"Errors and protection levels {' and '.join(AXIS_NAMES.values())}: {title}")
            found.append(TraceView(outcome, _figures(outcome), picture, replay_command(results.folder, outcome)))
    return found


def _figures(outcome: Outcome) -> str:
    """Main figures of an episode, in a line."""
    figures = [f"{outcome.ended} after {plain(outcome.time_s)} s", f"cost {plain(outcome.cost)}"]
    figures += [f"return {plain(outcome.total_return)}"]
    figures += [f"{outcome.hmi_steps} steps hazardously misleading"] if outcome.hmi_steps else []
    return ", ".join(figures)
