"""``lanebound bench``: measured speed against the gates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.options import AsJson

__all__ = ["bench"]


def bench(
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Run this benchmark alone; may be repeated.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Repeat each comparison and keep the median.")] = 5,
    out: Annotated[Path, typer.Option(help="Where to write the figures as JSON.")] = Path("build/bench.json"),
    as_json: AsJson = False,
) -> None:
    """Measure speed and compare it with the gates. Exit code 1 when a benchmark fails to run.

    The benchmark ``cold`` (a start of the vector engine with an empty cache of kernels) takes minutes and runs only
    with --only cold.

    Example: lanebound bench --only ambiguity --rounds 3 --json
    """
    from rich.console import Console

    from lanebound.agents.bench.runner import claim, run, select, write
    from lanebound.agents.cli.output import print_json, print_table

    names = select(only or [])
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
