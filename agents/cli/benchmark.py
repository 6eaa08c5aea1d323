"""``lanebound benchmark``: agents compared, seed by seed, and a page about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from lanebound.agents.benchmark import Results, SuiteConfig
    from lanebound.agents.benchmark.running import Plan, Progress

__all__ = ["benchmark"]

Agents = Annotated[
    str | None,
    typer.Option(metavar="A,B", help="Drive these alone: names, or name=model.zip, .onnx or package.module:callable."),
]


def benchmark(
    suite: Annotated[str, typer.Argument(metavar="SUITE", help="quick, standard, faults, or a YAML file of your own.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; a run goes on where one stopped.")],
    agents: Agents = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Episodes of each agent in each cell.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh/--resume", help="Throw away what DIR holds of an earlier run, or go on with it.")
    ] = False,
    budget: Annotated[float | None, typer.Option(min=0.0, metavar="HOURS", help="Begin no episode after that.")] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a value of it; may be repeated.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Drive a suite of environments, skies and faults with several agents, and compare them seed by seed.

    Example: lanebound benchmark standard --out out/mine --agents nominal,mine=runs/model.zip --seeds 20 --budget 2
    """
    from lanebound.agents.benchmark.running import Plan, run_plan
    from lanebound.agents.cli.interrupt import stoppable, wait_for

    with stoppable(lambda: _kept(out)):
        plan = wait_for(lambda: Plan.of(_suite(suite, agents, seeds, assignments or []), out, fresh))
        _announce(plan, jobs, budget)
        results = _with_bar(plan, lambda told: run_plan(plan, jobs, budget, told))
        _report(results, out, budget, as_json)


def _suite(name: str, agents: str | None, seeds: int | None, assignments: list[str]) -> SuiteConfig:
    """The suite with what the options change of it."""
    from lanebound.agents.benchmark.suite import load_suite, parse_agents
    from lanebound.integrity.presets import deep_merge, parse_assignments

    changes = parse_assignments(assignments)
    if seeds is not None:
        changes = deep_merge(changes, {"seeds": {"count": seeds}})
    found = load_suite(name, changes)
    if agents is None:
        return found
    known = {name: chosen.to_dict() for name, chosen in found.agents.items()}
    wanted = {name: known.get(agent, agent) for name, agent in parse_agents(agents).items()}
    return type(found).load({**found.to_dict(), "agents": wanted})


def _announce(plan: Plan, jobs: int | None, budget: float | None) -> None:
    """What is to be driven and about how long it takes."""
    from lanebound.agents.benchmark.running import cores

    count = cores() if jobs is None else jobs
    there = f", {plan.stored} are there already" if plan.stored else ""
    line = f"{len(plan.tasks)} episodes to drive with {count} processes{there}: about {_length(plan.hours(count))}"
    typer.echo(f"{line}{'' if budget is None else f', of which {budget:g} h may be used'}.", err=True)
    for env, agent, why in plan.left_out:
        typer.echo(f"left out: {agent} in {env} ({why})", err=True)


def _length(hours: float) -> str:
    return f"{hours:.2g} h" if hours >= 1.0 else f"{max(1, round(60.0 * hours))} min"


def _kept(out: Path) -> str:
    from lanebound.agents.benchmark.parts import episodes_kept

    kept = episodes_kept(out)
    found = f"{kept} finished episodes are kept in {out}" if kept else "no episode was finished"
    return f"{found}; run the same command again (without --fresh) to go on"


def _with_bar(plan: Plan, drive: Any) -> Results:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    from lanebound.agents.cli.interrupt import wait_for

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rest]}"))
    with Bar(*columns, console=Console(stderr=True)) as bar:
        rest = "kernels compile first"
        task = bar.add_task("episodes", total=plan.stored + len(plan.tasks), completed=plan.stored, rest=rest)

        def told(progress: Progress) -> None:
            failed = f", {len(progress.failures)} failed" if progress.failures else ""
            rest = f"{_clock(progress.left_s)} left{failed}"
            bar.update(task, completed=plan.stored + progress.done, rest=rest)

        results: Results = wait_for(lambda: drive(told))
    return results


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _report(results: Results, out: Path, budget: float | None, as_json: bool) -> None:
    from lanebound.agents.benchmark.results import FILES
    from lanebound.agents.cli.benchmark_tables import print_results
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.report import write_report

    page = write_report(results, out)
    if as_json:
        print_json(results.to_dict())
        return
    print_results(results)
    if results.missing:
        why = "" if budget is None else f": the budget of {budget:g} h is used up"
        typer.echo(f"{len(results.missing)} episodes are missing{why}. Run the same command again to go on.\n")
    typer.echo(f"report: {page}\ndata:   {', '.join(str(out / name) for name in FILES)}\n")
    typer.echo(_next(results, out))


def _next(results: Results, out: Path) -> str:
    """What to try next."""
    planned = [o for o in results.outcomes if results.suite.agents[o.agent].agent != "random"]
    worst = max(results.failures or planned or results.outcomes, key=lambda o: o.cost, default=None)
    lines = ["What to try next"]
    if worst is not None:
        lines.append(f"  lanebound replay-episode {out} {worst.id} --video out/replay.mp4")
    lines += [
        "  lanebound benchmark quick --out out/mine --agents nominal,mine=my_agent:make   # your own, see the README",
        "  lanebound benchmark standard --out out/standard --budget 1                     # every environment and sky",
    ]
    return "\n".join(lines)
