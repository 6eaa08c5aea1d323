"""A benchmark in one table and two lines: agents over all cells, and who is clearly safer than the reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from statistics import fmean

import typer

from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Cell, Paired, Results
from lanebound.agents.cli.benchmark_tables import number, print_failures
from lanebound.agents.cli.output import counted, open_console, print_table

__all__ = ["SHOWN", "conclusions", "overview_rows", "print_overview"]

SHOWN = {
    "success": "success\n[%]",
    "collision": "collision\n[%]",
    "lane_departure": "departure\n[%]",
    "cost": "cost",
    "return": "return",
    "mean_speed": "speed\n[m/s]",
}
HARM = ("collision", "lane_departure", "cost")
BOUND = "oracle"  # drives on the truth: no opponent, and not to be praised


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
    for line in _partial(results, len(places)):
        typer.echo(line)
    for line in conclusions(results):
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


def conclusions(results: Results) -> list[str]:
    """At most two lines: who is clearly safer than the reference and in how many cells, and what that costs in speed.

    Clearly safer: one of collisions, departures and cost clearly lower, and none of them clearly higher. A cell counts
    only where the agent succeeded in an episode: whoever never gets there does no harm either.
    """
    reference = results.suite.reference
    places = {
        agent: [place for place in results.suite.places if _compared(results, place, agent)]
        for agent, chosen in results.suite.agents.items()
        if agent != reference and chosen.agent != BOUND
    }
    places = {agent: there for agent, there in places.items() if there}
    if not places:
        return []
    safer = {agent: [p for p in there if _safer(results, p, agent)] for agent, there in places.items()}
    ranked = sorted((agent for agent in safer if safer[agent]), key=lambda agent: -len(safer[agent]))
    if not ranked:
        seeds = counted(max(cell.episodes for cell in results.cells), "seed")
        return [f"With {seeds} no agent is clearly safer than {reference} in any cell; --seeds takes more."]
    named = ", ".join(f"{agent} in {len(safer[agent])} of {len(places[agent])}" for agent in ranked)
    lines = [f"Clearly safer than {reference} (collisions, departures or cost): {named} cells."]
    paid = [(agent, _speed_lost(results, agent, safer[agent])) for agent in ranked]
    slower = [f"{agent} {lost:+.1f} m/s" for agent, lost in paid if lost is not None]
    return [*lines, f"Mean speed in these cells against {reference}: {', '.join(slower)}."] if slower else lines


def _pairs(results: Results, place: Place, agent: str) -> dict[str, Paired]:
    return {pair.metric: pair for pair in results.paired if pair.place == place and pair.agent == agent}


def _compared(results: Results, place: Place, agent: str) -> bool:
    return bool(_pairs(results, place, agent))


def _safer(results: Results, place: Place, agent: str) -> bool:
    if not results.cell(place, agent).metrics["success"].mean:
        return False
    pairs = _pairs(results, place, agent)
    signs = [pairs[key].difference or 0.0 for key in HARM if pairs[key].clear]
    return bool(signs) and max(signs) < 0.0


def _speed_lost(results: Results, agent: str, places: Iterable[Place]) -> float | None:
    found = [_pairs(results, place, agent)["mean_speed"].difference for place in places]
    known = [difference for difference in found if difference is not None]
    return fmean(known) if known else None
