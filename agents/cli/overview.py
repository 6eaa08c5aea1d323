"""The overview of a benchmark: the opening sentences, and one table with means of each agent over all cells."""

from __future__ import annotations

from collections import Counter

import typer

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.suite import flat_changes
from lanebound.agents.benchmark.verdicts import limits_of_other_skies, mean_over_cells, opening
from lanebound.agents.cli.benchmark_tables import number, print_failures
from lanebound.agents.cli.output import counted, open_console, print_table

__all__ = ["SHOWN", "overview_rows", "print_overview"]

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
