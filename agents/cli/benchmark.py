"""``lanebound benchmark``: agents compared, seed by seed, and a report."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

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
from lanebound.agents.cli.output import kept_text, print_json, resumable, wait_for, with_bar
from lanebound.agents.serialization import counted

if TYPE_CHECKING:
    from lanebound.agents.benchmark import Results, SuiteConfig
    from lanebound.agents.benchmark.work import BenchmarkPlan

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
    from lanebound.agents.cli.static import refuse_keys, refuse_preset

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

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(doing, total=None)
        return wait_for(lambda: work(lambda more: bar.update(task, description=f"{doing}: {more}")))


def _plan(suite: SuiteConfig, out: Path, fresh: bool) -> tuple[BenchmarkPlan, bool]:
    """The plan of a suite, and whether kernels must be compiled for it."""
    from lanebound.agents.benchmark.work import BenchmarkPlan
    from lanebound.integrity.core.accel import kernels_are_cached
    from lanebound.integrity.navigators.rtk_reckoning import epoch_kernel  # compiled after its stages

    cold = not kernels_are_cached(epoch_kernel.__file__)
    return BenchmarkPlan.of(suite, out, fresh), cold


def _suite(name: str, agents: str | None, seeds: int | None, changed: dict[str, Any]) -> SuiteConfig:
    """The suite with the changes of the options."""
    from lanebound.agents.benchmark.suite import load_suite, parse_agents
    from lanebound.agents.drivers import AGENTS, bare_name, unknown_agent
    from lanebound.agents.drivers.foreign import is_foreign
    from lanebound.integrity.core.presets import deep_merge

    if seeds is not None:
        require_one_source(changed, "seeds.count", "--seeds")
    found = load_suite(name, changed if seeds is None else deep_merge(changed, {"seeds": {"count": seeds}}))
    if agents is None:
        return found
    known = {name: chosen.to_dict() for name, chosen in found.agents.items()}
    given = parse_agents(agents)
    for agent in (bare_name(name) for name in given.values()):
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
    from lanebound.agents.cli.benchmark_tables import print_given_fault, print_overview, print_results

    if as_json:
        print_json(results.to_dict())
        return
    (print_results if full else print_overview)(results)
    print_given_fault(results)
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
