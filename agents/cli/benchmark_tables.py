"""Results of a benchmark in a terminal: a table for each place, and the differences from the references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lanebound.agents.benchmark.metrics import MAIN, Metric, metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Cell, Paired, Results
from lanebound.agents.benchmark.statistics import VERDICT_SEEDS
from lanebound.agents.cli.output import counted, open_console

__all__ = ["number", "print_failures", "print_results", "with_interval"]

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
