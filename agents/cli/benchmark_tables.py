"""How results of a benchmark look in a terminal: a table for each place, and the differences from the reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from lanebound.agents.benchmark.metrics import MAIN, Metric, metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Paired, Results
from lanebound.agents.cli.output import WIDTH_OF_A_FILE

__all__ = ["number", "print_results", "with_interval"]

SHARES = ("availability", "hmi")
COLOURS = {True: "green", False: "red"}
FAILURES = 10  # that are listed


def print_results(results: Results) -> None:
    """Print means with intervals, paired differences and failures; in a file each row is one line."""
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH_OF_A_FILE
    for place in results.suite.places:
        if any(cell.place == place for cell in results.cells):
            _print_place(console, results, place)
    console.print(
        Text("Brackets: 95 % bootstrap intervals over seeds. Green and red: better, worse than the reference.")
    )
    _print_failures(console, results)


def _print_place(console: Console, results: Results, place: Place) -> None:
    metrics = [metric_named(key) for key in MAIN]
    cells = [cell for cell in results.cells if cell.place == place]
    shown = [m for m in metrics if any(cell.metrics[m.key].n for cell in cells)]
    faults = "" if place.faults == "none" else f", {place.faults} faults"
    title = f"{place.env}, {place.sky} sky{faults}: mean of {max(c.episodes for c in cells)} seeds"
    table = _table(shown, "agent")
    for cell in cells:
        found = [cell.metrics[m.key] for m in shown]
        table.add_row(
            cell.agent, *(_cell(console, m, e.mean, e.low, e.high) for m, e in zip(shown, found, strict=True))
        )
    console.print(Text(title, style="bold"))
    console.print(table)
    pairs = [p for p in results.paired if p.place == place and p.metric in MAIN]
    if pairs:
        _print_pairs(console, shown, pairs)
    console.print()


def _print_pairs(console: Console, shown: Sequence[Metric], pairs: Sequence[Paired]) -> None:
    table = _table(shown, f"less {pairs[0].against}")
    by_key = {(p.agent, p.metric): p for p in pairs}
    for agent in dict.fromkeys(p.agent for p in pairs):
        row = []
        for metric in shown:
            pair = by_key[(agent, metric.key)]
            text = _cell(console, metric, pair.difference, pair.low, pair.high, signed=True)
            if pair.clear and metric.better is not None and pair.difference is not None:
                text.stylize(COLOURS[(pair.difference > 0.0) == (metric.better == "higher")])
            row.append(text)
        table.add_row(agent, *row)
    console.print(table)


def _table(metrics: Sequence[Metric], first: str) -> Table:
    table = Table(header_style="bold", padding=(0, 1), show_lines=False)
    table.add_column(first, overflow="fold")
    for metric in metrics:
        unit = "%" if _in_percent(metric) else metric.unit
        table.add_column(f"{metric.title} [{unit}]".replace("[", r"\[") if unit else metric.title, justify="right")
    return table


def _cell(
    console: Console, metric: Metric, mean: float | None, low: float | None, high: float | None, signed: bool = False
) -> Text:
    mean_text, interval = with_interval(metric, mean, low, high, signed)
    if not interval:
        return Text(mean_text)
    return Text.assemble(mean_text, "\n" if console.is_terminal else " ", (interval, "dim"))


def with_interval(
    metric: Metric, mean: float | None, low: float | None, high: float | None, signed: bool = False
) -> tuple[str, str]:
    """A mean and its interval as text; ``-`` and nothing where there is none."""
    if mean is None:
        return "-", ""
    if low is None or high is None:
        return number(metric, mean, signed), ""
    return number(metric, mean, signed), f"[{number(metric, low, signed)}, {number(metric, high, signed)}]"


def number(metric: Metric, value: float, signed: bool = False) -> str:
    """A figure of a metric with as many digits as can be read: shares in percent."""
    scaled = 100.0 * value if _in_percent(metric) else value
    digits = 1 if abs(scaled) < 100.0 else 0
    text = f"{scaled:{'+' if signed else ''}.{digits}f}"
    return text.replace("-", "") if float(text) == 0.0 else text


def _in_percent(metric: Metric) -> bool:
    return metric.rate or metric.key in SHARES


def _print_failures(console: Console, results: Results) -> None:
    failures = results.failures
    if not failures:
        return
    console.print(Text(f"\n{len(failures)} episodes in which the agent failed", style="bold red"))
    table: Any = Table(header_style="bold")
    for column in ("episode", "status", "message"):
        table.add_column(column, overflow="fold")
    for outcome in failures[:FAILURES]:
        table.add_row(*map(Text, (outcome.id, outcome.status, outcome.message)))
    console.print(table)
    if len(failures) > FAILURES:
        console.print(f"... and {len(failures) - FAILURES} more, in results.json")
