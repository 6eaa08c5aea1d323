"""``lanebound bench``: measured speed against the gates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.options import AsJson
from lanebound.agents.cli.output import carry_out, print_json, print_table, show_study


def bench(
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Run this benchmark alone; may be repeated.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Repeat each comparison and keep the median.")] = 5,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File of the figures, build/bench.json; with --scale a folder, build/scale, that is resumed."
        ),
    ] = None,
    scale: Annotated[
        bool,
        typer.Option("--scale", help="Time and memory against environments, vehicles, satellites, length of episodes."),
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="With --scale: a few small points, in a minute.")] = False,
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.md",
            help="With --scale: page whose tables are written anew, and next to it FILE.csv with all points.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure speed and compare it with the gates. Exit code 1 when a benchmark fails to run.

    The benchmark ``cold`` (a start of the vector engine with an empty cache of kernels) takes minutes and runs only
    with --only cold. --scale is a measurement of its own, ten to thirty minutes of one core.

    Example: lanebound bench --only ambiguity --rounds 3 --json
    """
    if scale:
        _scale(Path("build/scale") if out is None else out, quick, page, only, as_json)
        return
    _refuse_without_scale(quick, page)
    _against_gates(only or [], rounds, Path("build/bench.json") if out is None else out, as_json)


def _against_gates(only: list[str], rounds: int, out: Path, as_json: bool) -> None:
    from rich.console import Console

    from lanebound.agents.bench.runner import claim, run, select, write

    names = select(only)
    claim(out)
    with Console(stderr=True).status("measuring") as status:
        report = run(names, rounds, progress=lambda name: status.update(f"measuring {name}"))
    write(report.rows, out)
    rows = [row.to_json() for row in report.rows]
    if as_json:
        print_json(rows)
    else:
        columns = ("name", "value", "unit", "gate", "stretch", "met")
        print_table("Benchmark", columns, ([row[column] for column in columns] for row in rows))
    for name, failure in report.failures.items():
        typer.echo(f"error: benchmark '{name}' failed: {failure}", err=True)
    if report.failures:
        raise typer.Exit(1)


def _refuse_without_scale(quick: bool, page: Path | None) -> None:
    from lanebound.integrity.core.errors import InputError

    for given, option in ((quick, "--quick"), (page is not None, "--page")):
        if given:
            raise InputError(f"{option} needs --scale, got {option} alone: add --scale, or leave it out")


def _scale(out: Path, quick: bool, page: Path | None, only: list[str] | None, as_json: bool) -> None:
    from lanebound.agents.report.pages import csv_of, require_page
    from lanebound.agents.studies.scale import SECTIONS, measured, run_scale, tables
    from lanebound.integrity.core.errors import InputError

    if only:
        raise InputError("--only and --scale must not be given together, got both: leave one of them out")
    if quick and page is not None:
        raise InputError("--quick and --page must not be given together, got both: a page has the whole measurement")
    if page is not None:
        require_page(page, SECTIONS)
    result = carry_out(out, "point", lambda report: run_scale(out, quick, report), "seconds of work")
    show_study(result, {"points": measured(result)} if quick else tables(result), out, page, as_json)
    if page is not None:
        page.with_suffix(".csv").write_text(csv_of(measured(result)), encoding="utf-8")
