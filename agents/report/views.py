"""The tables and pictures of one place of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from lanebound.agents.benchmark.metrics import MAIN, METRICS, metric_named
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.results import Cell, Results
from lanebound.agents.report.charts import (
    AXIS_NAMES,
    CostBar,
    ParetoAxis,
    ParetoPoint,
    forest,
    pareto,
    share_text,
    stacked,
    stanford,
    trace,
)
from lanebound.agents.report.commands import replay_command
from lanebound.agents.report.episodes import pooled, trace_of, worst_of
from lanebound.agents.report.numbers import SHARE, plain
from lanebound.agents.report.style import Actor, slug_of, title_of, unit_of
from lanebound.agents.report.tables import Table, all_metrics, main_table
from lanebound.envs.costs import CAUSES, CostConfig
from lanebound.integrity.assessment.events import Zone
from lanebound.integrity.assessment.record import AXES
from lanebound.integrity.assessment.stanford import ZoneCounts

__all__ = ["ChartChoice", "Diagram", "PlaceView", "TraceView", "causes", "view_of"]

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
