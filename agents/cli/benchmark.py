"""``lanebound benchmark``: agents compared, seed by seed, and a report."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lanebound.agents.benchmark.metrics import MAIN, Metric, metric_named
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.results import Cell, Paired, Results
from lanebound.agents.benchmark.statistics import VERDICT_SEEDS
from lanebound.agents.benchmark.suite import flat_changes
from lanebound.agents.benchmark.verdicts import limits_of_other_skies, mean_over_cells, opening
from lanebound.agents.cli.options import (
    AsJson,
    Assignments,
    Budget,
    Cores,
    Fresh,
    FullTables,
    Plugins,
    changes,
    require_one_source,
)
from lanebound.agents.cli.output import counted, open_console, print_table

if TYPE_CHECKING:
    from lanebound.agents.benchmark import Results, SuiteConfig
    from lanebound.agents.benchmark.work import BenchmarkPlan

__all__ = [
    "SHOWN",
    "benchmark",
    "carry_out",
    "number",
    "overview_rows",
    "print_failures",
    "print_overview",
    "print_results",
    "with_interval",
]


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


T = TypeVar("T")
PAGE = "report.html"
AGENTS_HELP = "Drive these alone: names ('lanebound agents'), or name=FILE.zip, .onnx, .npz or module:callable."


def benchmark(
    suite: Annotated[
        str,
        typer.Argument(
            metavar="SUITE", help="A preset of suites/ (lanebound config list), such as quick or claim, or a YAML file."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; a run is resumed there.")],
    agents: Annotated[str | None, typer.Option(metavar="A,B", help=AGENTS_HELP)] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Episodes of each agent in each cell.")] = None,
    jobs: Cores = None,
    fresh: Fresh = False,
    budget: Budget = None,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    full: FullTables = False,
    as_json: AsJson = False,
) -> None:
    """Drive a suite of environments, skies and faults with several agents, and compare them seed by seed.

    'lanebound agents' describes the agents.

    Example: lanebound benchmark standard --out out/mine --agents nominal,mine=runs/model.zip --seeds 20 --budget 2
    """
    from lanebound.agents.cli.early import refuse_preset
    from lanebound.agents.cli.keys import refuse_keys

    given = changes(assignments)
    if not _plugins:
        refuse_keys("suite", given)
    refuse_preset("suite", "suites/", suite)
    carry_out(lambda: _suite(suite, agents, seeds, given), out, fresh, jobs, budget, full, as_json)


def carry_out(
    choose: Callable[[], SuiteConfig],
    out: Path,
    fresh: bool,
    jobs: int | None,
    budget: float | None,
    full: bool,
    as_json: bool,
) -> None:
    """Drive a suite, print the results and write the report, with progress."""
    from lanebound.agents.benchmark.work import run_plan
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar

    with resumable(lambda: kept_text(out, "episodes/*/*/*/*.parquet", "episode")):
        plan, cold = _while("opening the environments", lambda say: _plan(choose(), out, fresh))
        _announce(plan, jobs, budget, cold)
        results = with_bar("episodes", lambda on_progress: run_plan(plan, jobs, budget, on_progress))
        _print(results, budget, full, as_json)
        if plan.tasks and not sys.stderr.isatty():
            typer.echo("writing the report: filming the worst episodes", err=True)
        page = _while(f"writing {out / PAGE}", lambda say: _write(results, out, say))
        if not as_json:
            _point_to(results, out, page)
        if useless := _always_failing(results):
            typer.echo(f"every episode of {', '.join(useless)} failed: see the messages above", err=True)
            raise typer.Exit(1)


def _always_failing(results: Results) -> list[str]:
    """Agents that failed in all their episodes."""
    driven = Counter(outcome.agent for outcome in results.outcomes)
    failed = Counter(outcome.agent for outcome in results.failures)
    return [agent for agent, count in driven.items() if failed[agent] == count]


def _while(doing: str, work: Callable[[Callable[[str], None]], T]) -> T:
    """The result of ``work``; a line in a terminal shows its time and what it reports."""
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from lanebound.agents.cli.progress import wait_for

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(doing, total=None)
        return wait_for(lambda: work(lambda more: bar.update(task, description=f"{doing}: {more}")))


def _plan(suite: SuiteConfig, out: Path, fresh: bool) -> tuple[BenchmarkPlan, bool]:
    """The plan of a suite, and whether kernels must be compiled for it."""
    from lanebound.agents.benchmark.work import BenchmarkPlan
    from lanebound.integrity.core.accel import kernels_are_cached
    from lanebound.integrity.navigators.rtk_reckoning import report_kernel  # the last stage of an epoch

    cold = not kernels_are_cached(report_kernel.__file__)
    return BenchmarkPlan.of(suite, out, fresh), cold


def _suite(name: str, agents: str | None, seeds: int | None, changed: dict[str, Any]) -> SuiteConfig:
    """The suite with the changes of the options."""
    from lanebound.agents.benchmark.suite import load_suite, parse_agents
    from lanebound.agents.drivers import AGENTS, unknown_agent
    from lanebound.agents.drivers.foreign import is_foreign
    from lanebound.integrity.core.presets import deep_merge

    if seeds is not None:
        require_one_source(changed, "seeds.count", "--seeds")
    found = load_suite(name, changed if seeds is None else deep_merge(changed, {"seeds": {"count": seeds}}))
    if agents is None:
        return found
    known = {name: chosen.to_dict() for name, chosen in found.agents.items()}
    given = parse_agents(agents)
    for agent in given.values():
        if agent not in known and agent not in AGENTS and not is_foreign(agent):
            raise unknown_agent(agent, list(known))
    wanted = {name: known.get(agent, agent) for name, agent in given.items()}
    return type(found).load({**found.to_dict(), "agents": wanted})


def _announce(plan: BenchmarkPlan, jobs: int | None, budget: float | None, cold: bool) -> None:
    """Print the planned episodes and about how long they take."""
    from lanebound.agents.benchmark.suite import flat_changes
    from lanebound.agents.checkpointing.runner import available_cores

    for env, agent, why in plan.left_out:
        typer.echo(f"left out: {agent} in {env} ({why.partition(': ')[0]})", err=True)
    if changed := ", ".join(f"{key} = {value}" for key, value in flat_changes(plan.suite.overrides).items()):
        typer.echo(f"changed in all environments of this suite: {changed}", err=True)
    for warning in plan.warnings:
        typer.echo(f"warning: {warning}", err=True)
    if not plan.tasks:
        typer.echo(f"{counted(plan.stored, 'episode')}, all stored already: nothing to drive.", err=True)
        return
    count = min(available_cores() if jobs is None else jobs, len(plan.tasks))
    there = f", {plan.stored} more {'is' if plan.stored == 1 else 'are'} stored already" if plan.stored else ""
    line = f"{counted(len(plan.tasks), 'episode')} to drive with {counted(count, 'process')}{there}"
    line += f": {_length(plan.hours(count))}"
    line += ", and two to four minutes more to compile kernels, once" if cold else ""
    typer.echo(f"{line}{'' if budget is None else f', of which {budget:g} h may be used'}.", err=True)


def _length(hours: float) -> str:
    if hours >= 1.0:
        return f"about {hours:.2g} h"
    return f"about {round(60.0 * hours)} min" if hours > 1.5 / 60.0 else "a minute or less"


def _print(results: Results, budget: float | None, full: bool, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json

    if as_json:
        print_json(results.to_dict())
        return
    (print_results if full else print_overview)(results)
    if results.missing:
        why = "" if budget is None else f": the budget of {budget:g} h is used up"
        missing = f"{counted(len(results.missing), 'episode')} {'is' if len(results.missing) == 1 else 'are'} missing"
        typer.echo(f"{missing}{why}. Run the same command again to resume.\n")


def _write(results: Results, out: Path, say: Callable[[str], None]) -> Path:
    from lanebound.agents.report import write_report

    def report(done: int, of: int) -> None:
        say(f"filming the worst episodes, {done} of {of} done")

    return write_report(results, out, on_clip=report)


def _point_to(results: Results, out: Path, page: Path) -> None:
    from lanebound.agents.benchmark.results import FILES

    typer.echo(f"report: {page}\ndata:   {', '.join(str(out / name) for name in FILES)}")
    typer.echo(_next(results, out))


def _next(results: Results, out: Path) -> str:
    """Commands to try next."""
    planned = [o for o in results.outcomes if results.suite.agents[o.agent].agent != "random"]
    worst = max(results.failures or planned or results.outcomes, key=lambda o: o.cost, default=None)
    lines = ["What to try next"]
    if worst is not None:
        lines.append(f"  lanebound replay-episode {out} {worst.id} --video out/replay.mp4")
    lines += [
        "  lanebound benchmark quick --out out/mine --agents nominal,mine=my_agent:make   # own: docs/training.md",
        "  lanebound benchmark standard --out out/standard --budget 1                     # every environment and sky",
    ]
    return "\n".join(lines)
