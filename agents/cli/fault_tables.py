"""Integrity given one fault in each episode, in a terminal: by kind of fault, and at nominal rates."""

from __future__ import annotations

import typer

from lanebound.agents.benchmark.fault_rates import FaultCell, FaultRate
from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.results import Results
from lanebound.agents.cli.benchmark_tables import number
from lanebound.agents.cli.output import print_table

__all__ = ["print_given_fault"]

SHOWN = {
    "any_mi": "MI\n[%]",
    "any_hmi": "HMI\n[%]",
    "alert_after_fault": "alert\nafter\n[%]",
    "alert_delay": "delay\n[s]",
    "time_to_alert": "TTA\n[s]",
    "cost_hmi": "cost_hmi",
}
MEANT = (
    "MI, HMI and alerts: share of the episodes with any. Delay: from the onset of the fault to the first alert that "
    "begins after it. TTA: from an error above its limit to the alert. Share: of the kind at nominal rates."
)


def print_given_fault(results: Results) -> None:
    """Print both tables, where a cell has ``faults: one``; else nothing."""
    if not results.fault_cells:
        return
    heads = "cell", "agent", "kind of fault", "episodes", "share\n[%]", *SHOWN.values()
    print_table("Given one fault in each episode", heads, map(_cell_row, results.fault_cells), numbers=heads[3:])
    typer.echo(MEANT + "\n")
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
    means = ((key, cell.metrics[key].mean) for key in SHOWN)
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
