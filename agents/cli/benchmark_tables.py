"""Results of a benchmark in a terminal.

The overview: the opening sentences, and one table with means of each agent over all cells. In full: a table for each
place, and the differences from the references. Where episodes have one fault each: integrity by kind of fault, and at
nominal rates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lanebound.agents.benchmark.fault_rates import FaultCell, FaultRate
from lanebound.agents.benchmark.metrics import MAIN, Metric, metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Cell, Paired, Results
from lanebound.agents.benchmark.statistics import VERDICT_SEEDS
from lanebound.agents.benchmark.suite import flat_changes
from lanebound.agents.benchmark.verdicts import limits_of_other_skies, mean_over_cells, opening
from lanebound.agents.cli.output import open_console, print_table
from lanebound.agents.serialization import counted

SHARES = ("availability", "hmi")
COLOURS = {"better": "green", "worse": "red"}
FAILURES = 10  # that are listed


def print_results(results: Results) -> None:
    """Print means with intervals, paired differences and failures; wide tables are split."""
    console = open_console()
    for place in results.suite.places:
        if any(cell.place == place for cell in results.cells):
            _print_place(console, results, place)
    console.print(
        Text(
            "With 95 % intervals over seeds, where these differ enough; green and red: clearly better and worse than "
            f"the reference, each figure by its own interval, from {VERDICT_SEEDS} seeds on and where neither agent "
            "failed. n: seeds that a figure is of, where they are fewer. Untuned: margins that were not fitted there."
        )
    )
    print_failures(console, results)


def _print_place(console: Console, results: Results, place: Place) -> None:
    cells = [cell for cell in results.cells if cell.place == place]
    faults = "" if place.faults == "none" else f", {place.faults} faults"
    seeds = max(c.episodes for c in cells)
    title = f"{place.env}, {place.sky} sky{faults}: means of {seeds} seeds"
    pairs = {(p.agent, p.against, p.metric): p for p in results.paired if p.place == place}
    shown = [metric_named(key) for key in MAIN if any(cell.metrics[key].n for cell in cells)]
    rows = list(dict.fromkeys((agent, against) for agent, against, _ in pairs))
    columns = [_column(metric, cells, [pairs[(*row, metric.key)] for row in rows], seeds) for metric in shown]
    names = TableColumn(
        "agent", [*map(Text, map(_name, cells)), *(Text(f"{agent} - {against}") for agent, against in rows)]
    )
    console.print(Text(title, style="bold"))
    for group in _groups(columns, console.width - names.width(console) - 2):
        console.print(_table(console, [names, *group], len(cells)))


def _name(cell: Cell) -> str:
    return f"{cell.agent} (untuned)" if cell.untuned else cell.agent


def _column(metric: Metric, cells: Sequence[Cell], pairs: Sequence[Paired], seeds: int) -> TableColumn:
    """Means of a metric with intervals, and below them the differences from the references."""
    found = []
    for cell in cells:
        e = cell.metrics[metric.key]
        found.append(_text(*with_interval(metric, e.mean, e.low, e.high), _fewer(e.n, seeds)))
    for pair in pairs:
        shown = with_interval(metric, pair.difference, pair.low, pair.high, signed=True)
        text = _text(*shown, _fewer(pair.n, seeds))
        if tone := COLOURS.get(pair.verdict(metric.better)):
            text.stylize(tone)
        found.append(text)
    unit = "%" if _in_percent(metric) else metric.unit
    return TableColumn("\n".join([*metric.title.split(), f"[{unit}]" if unit else ""]), found)


def _fewer(n: int, seeds: int) -> str:
    """The number of seeds of a value, where it is smaller than that of all."""
    return f"n={n}" if 0 < n < seeds else ""


def _text(mean: str, interval: str, fewer: str) -> Text:
    return Text.assemble(mean, "\n", (" ".join(filter(None, (interval, fewer))), "dim"))


@dataclass(frozen=True)
class TableColumn:
    """A column of a table; entries have two lines in a terminal, and one in a file."""

    head: str
    entries: list[Text]

    def width(self, console: Console) -> int:
        """Its width with padding [characters]."""
        lines = [line for text in self.entries for line in self.fitted(console, text).plain.splitlines()]
        head = self.head.split("\n") if console.is_terminal else [self.head]
        return max(map(len, [*head, *lines])) + 2

    def fitted(self, console: Console, text: Text) -> Text:
        """An entry for this console."""
        return text if console.is_terminal else Text(" ".join(text.plain.split("\n")).rstrip())


def _groups(columns: Sequence[TableColumn], room: int) -> list[list[TableColumn]]:
    """Groups of columns that fit side by side, at least one column each."""
    console = Console()
    groups: list[list[TableColumn]] = [[]]
    for column in columns:
        if groups[-1] and sum(c.width(console) for c in [*groups[-1], column]) > room:
            groups.append([])
        groups[-1].append(column)
    return groups


def _table(console: Console, columns: Sequence[TableColumn], agents: int) -> Table:
    table = Table(box=SIMPLE_HEAD, header_style="bold", padding=(0, 1, 0, 1), collapse_padding=True, pad_edge=False)
    for column in columns:
        head = Text(column.head) if console.is_terminal else Text(" ".join(column.head.split()))
        justify: Literal["left", "right"] = "left" if column is columns[0] else "right"
        table.add_column(head, justify=justify, no_wrap=True, min_width=column.width(console) - 2, vertical="top")
    for k in range(len(columns[0].entries)):
        table.add_row(*(column.fitted(console, column.entries[k]) for column in columns), end_section=k == agents - 1)
    return table


def with_interval(
    metric: Metric, mean: float | None, low: float | None, high: float | None, signed: bool = False
) -> tuple[str, str]:
    """A mean and its interval as text; ``-`` and "" where they are missing."""
    if mean is None:
        return "-", ""
    if low is None or high is None:
        return number(metric, mean, signed), ""
    return number(metric, mean, signed), f"{number(metric, low, signed)}..{number(metric, high, signed)}"


def number(metric: Metric, value: float, signed: bool = False) -> str:
    """A value of a metric as text, shares in percent."""
    scaled = 100.0 * value if _in_percent(metric) else value
    digits = 1 if abs(scaled) < 100.0 else 0
    text = f"{scaled:{'+' if signed else ''}.{digits}f}"
    return text.replace("-", "") if float(text) == 0.0 else text


def _in_percent(metric: Metric) -> bool:
    return metric.rate or metric.key in SHARES


def print_failures(console: Console, results: Results) -> None:
    """Print the first episodes in which an agent failed, with the reasons."""
    failures = results.failures
    if not failures:
        return
    console.print(Text(f"\n{counted(len(failures), 'episode')} in which the agent failed", style="bold red"))
    table: Any = Table(header_style="bold")
    for column in ("episode", "status", "message"):
        table.add_column(column, overflow="fold", no_wrap=column != "message")
    for outcome in failures[:FAILURES]:
        table.add_row(*map(Text, (outcome.id, outcome.status, outcome.message)))
    console.print(table)
    if len(failures) > FAILURES:
        console.print(Text(f"... and {len(failures) - FAILURES} more, in results.json"))


SHOWN = {
    "harm": "harm",
    "throughput": "thru-\nput\n[m/s]",
    "collision": "crash\n[%]",
    "off_road": "off\nroad\n[%]",
    "lane_departure": "left\nlane\n[%]",
    "success": "ended\nwell\n[%]",
    "cost": "cost",
    "return": "return",
}
MEANT = (
    "Harm: 50 for a crash or an end off the road, and m2 of the true body beyond its lane. Ended well: no crash, still "
    "on the road, and at the goal and in time where the task asks for it (success)."
)


def print_overview(results: Results) -> None:
    """Print the sentences that open a report, one row for each agent, and failures."""
    places = list(dict.fromkeys(cell.place for cell in results.cells))
    if not places:
        typer.echo("No episode was driven: there is nothing to show.")
        return
    seeds = max(cell.episodes for cell in results.cells)
    whole = f"{counted(len(places), 'cell')} (environments x skies x faults)"
    title = f"Means over {whole}, {counted(seeds, 'seed')} each"
    for line in opening(results):
        typer.echo(line)
    print_table(title, ("agent", *SHOWN.values()), overview_rows(results), numbers=SHOWN.values())
    remarks = *_changed(results), *limits_of_other_skies(results), *_partial(results, len(places)), *_untuned(results)
    for line in (MEANT, *remarks, *_failing(results)):
        typer.echo(line)
    typer.echo("Each cell with its intervals: the same command with --full.\n")
    print_failures(open_console(), results)


def _changed(results: Results) -> list[str]:
    """The changes of all environments, with which figures differ from those of other suites."""
    changed = ", ".join(f"{key} = {value}" for key, value in flat_changes(results.suite.overrides).items())
    return [f"Changed in all environments: {changed}. Compare with no other suite."] if changed else []


def overview_rows(results: Results) -> list[list[str]]:
    """Name and figures of each agent."""
    driven = {cell.agent for cell in results.cells}
    return [
        [agent, *(_shown(results, agent, key) for key in SHOWN)] for agent in results.suite.agents if agent in driven
    ]


def _shown(results: Results, agent: str, key: str) -> str:
    mean = mean_over_cells(results, agent, key)
    return "-" if mean is None else number(metric_named(key), mean)


def _partial(results: Results, places: int) -> list[str]:
    """Agents that have not driven all cells: their means are not comparable."""
    driven = Counter(cell.agent for cell in results.cells)
    fewer = [f"{agent} drove {count} of the {places} cells" for agent, count in driven.items() if count < places]
    return [f"{', '.join(fewer)}: not to be compared in this table."] if fewer else []


def _untuned(results: Results) -> list[str]:
    """Agents with untuned margins."""
    driven = Counter(cell.agent for cell in results.cells)
    untuned = Counter(cell.agent for cell in results.cells if cell.untuned)
    return [
        f"{agent} is untuned in {count} of its {counted(driven[agent], 'cell')}: its margins were not fitted there."
        for agent, count in untuned.items()
    ]


def _failing(results: Results) -> list[str]:
    """Agents with failed episodes, perhaps the hard ones, which their means leave out."""
    driven = Counter(outcome.agent for outcome in results.outcomes)
    failed = Counter(outcome.agent for outcome in results.failures)
    return [
        f"{agent} failed in {count} of {counted(driven[agent], 'episode')}: its figures but success leave these out."
        for agent, count in failed.items()
    ]


GIVEN_FAULT = {
    "any_mi": "MI\n[%]",
    "any_hmi": "HMI\n[%]",
    "alert_after_fault": "alert\nafter\n[%]",
    "alert_delay": "delay\n[s]",
    "time_to_alert": "TTA\n[s]",
    "cost_hmi": "cost_hmi",
}
FAULT_MEANT = (
    "MI, HMI and alerts: share of the episodes with any. Delay: from the onset of the fault to the first alert that "
    "begins after it. TTA: from an error above its limit to the alert. Share: of the kind at nominal rates."
)


def print_given_fault(results: Results) -> None:
    """Print both tables, where a cell has ``faults: one``; else nothing."""
    if not results.fault_cells:
        return
    heads = "cell", "agent", "kind of fault", "episodes", "share\n[%]", *GIVEN_FAULT.values()
    print_table("Given one fault in each episode", heads, map(_cell_row, results.fault_cells), numbers=heads[3:])
    typer.echo(FAULT_MEANT + "\n")
    heads = (
        "cell",
        "agent",
        "share of episodes with",
        "given one fault",
        "probability\nof one fault",
        "in all",
        "unseen",
    )
    print_table("At nominal rates of faults", heads, map(_rate_row, results.fault_rates))
    typer.echo("In all: with the episodes of faults none; unseen: what two faults or more may add.\n")


def _cell_row(cell: FaultCell) -> list[str]:
    means = ((key, cell.metrics[key].mean) for key in GIVEN_FAULT)
    shown = ("-" if mean is None else number(metric_named(key), mean) for key, mean in means)
    head = f"{cell.env.removesuffix('-v0')}, {cell.sky}", cell.agent, cell.kind
    return [*head, str(cell.episodes), f"{100.0 * cell.share:.2g}", *shown]


def _rate_row(rate: FaultRate) -> list[str]:
    given = _with_ends(rate.given_one, rate.low, rate.high)
    total = _with_ends(rate.total, rate.total_low, rate.total_high)
    head = f"{rate.env.removesuffix('-v0')}, {rate.sky}", rate.agent, metric_named(rate.metric).title
    return [*head, given, f"{rate.probability:.2g}", total, f"{rate.unseen:.2g}"]


def _with_ends(share: float | None, low: float | None, high: float | None) -> str:
    """Shares of episodes, in two digits because they may be tiny."""
    return "-" if share is None else f"{share:.2g} ({low:.2g}..{high:.2g})"
