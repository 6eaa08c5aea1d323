"""A benchmark in one table and a few lines: agents over all cells, and who is clearly safer than the references."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from statistics import fmean

import typer

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.results import Cell, Results
from lanebound.agents.benchmark.verdicts import conclusions
from lanebound.agents.cli.benchmark_tables import number, print_failures
from lanebound.agents.cli.output import counted, open_console, print_table

__all__ = ["SHOWN", "overview_rows", "print_overview"]

SHOWN = {
    "success": "ended\nwell\n[%]",
    "collision": "crash\n[%]",
    "off_road": "off\nroad\n[%]",
    "lane_departure": "left\nlane\n[%]",
    "harm": "harm",
    "cost": "cost",
    "return": "return",
    "throughput": "thru-\nput\n[m/s]",
}


MEANT = (
    "Ended well: no crash, still on the road, and on average at least a quarter of the limit; who waits is late. "
    "Harm: 50 for a crash or an end off the road, and m2 of the true body beyond its lane."
)


def print_overview(results: Results) -> None:
    """Print one row for each agent, what follows from the paired differences, and failures."""
    places = list(dict.fromkeys(cell.place for cell in results.cells))
    if not places:
        typer.echo("No episode was driven: there is nothing to show.")
        return
    seeds = max(cell.episodes for cell in results.cells)
    whole = f"{counted(len(places), 'cell')} (environments x skies x faults)"
    title = f"Means over {whole}, {counted(seeds, 'seed')} each"
    print_table(title, ("agent", *SHOWN.values()), overview_rows(results), numbers=SHOWN.values())
    typer.echo(MEANT)
    for line in (*_partial(results, len(places)), *_untuned(results), *_failing(results), *conclusions(results)):
        typer.echo(line)
    typer.echo("Each cell with its intervals: the same command with --full.\n")
    print_failures(open_console(), results)


def overview_rows(results: Results) -> list[list[str]]:
    """Name and figures of each agent; cells weigh alike, whatever number of seeds they have."""
    found = []
    for agent in results.suite.agents:
        cells = [cell for cell in results.cells if cell.agent == agent]
        if cells:
            found.append([agent, *(_mean(cells, key) for key in SHOWN)])
    return found


def _partial(results: Results, places: int) -> list[str]:
    """Who has not driven everywhere: such means are not comparable."""
    driven = Counter(cell.agent for cell in results.cells)
    fewer = [f"{agent} drove {count} of the {places} cells" for agent, count in driven.items() if count < places]
    return [f"{', '.join(fewer)}: not to be compared in this table."] if fewer else []


def _mean(cells: Iterable[Cell], key: str) -> str:
    means = [mean for cell in cells if (mean := cell.metrics[key].mean) is not None]
    return number(metric_named(key), fmean(means)) if means else "-"


def _untuned(results: Results) -> list[str]:
    """Who drove with defaults where it is to be tuned."""
    driven = Counter(cell.agent for cell in results.cells)
    untuned = Counter(cell.agent for cell in results.cells if cell.untuned)
    return [
        f"{agent} is untuned in {count} of its {counted(driven[agent], 'cell')}: its margins were not fitted there."
        for agent, count in untuned.items()
    ]


def _failing(results: Results) -> list[str]:
    """Whose figures leave out the episodes in which they failed: perhaps the hard ones."""
    driven = Counter(outcome.agent for outcome in results.outcomes)
    failed = Counter(outcome.agent for outcome in results.failures)
    return [
        f"{agent} failed in {count} of {counted(driven[agent], 'episode')}: its figures but success leave these out."
        for agent, count in failed.items()
    ]
