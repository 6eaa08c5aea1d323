"""``lanebound reproduce``: what the source papers show, from one documented parameter set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, help="Reproduce what the source papers show.", no_args_is_help=True)


@app.callback()
def _reproduce() -> None:
    """Reproduce what the source papers show."""


@app.command("urban-drive")
def urban_drive(
    out: Annotated[
        Path, typer.Option(help="Folder for tables.json and the figures; an interrupted run goes on there.")
    ],
    seeds: Annotated[int | None, typer.Option(min=1, help="Number of drives; the study has 100.")] = None,
    minutes: Annotated[float | None, typer.Option(min=1.0, help="Length of a drive; the study has 26.")] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a value of the study; may be repeated."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """A Tokyo-like urban drive: RTK, Doppler, IMU + odometer, and the tables of S1 beside ours.

    Example: lanebound reproduce urban-drive --out out/urban --seeds 10
    """
    from lanebound.agents.cli.kinds import resolve
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.reproduce.study import rows_against_paper
    from lanebound.agents.reproduce.urban_drive import UrbanDriveConfig
    from lanebound.integrity.presets import parse_assignments

    changes: dict[str, Any] = parse_assignments(assignments or [])
    changes.update({key: value for key, value in (("seeds", seeds), ("minutes", minutes)) if value is not None})
    _, config = resolve("studies/urban_drive", changes)
    assert isinstance(config, UrbanDriveConfig)
    tables = _run_with_bar(config, out)
    rows = rows_against_paper(tables)
    if as_json:
        print_json({"tables": tables, "against_paper": rows})
    else:
        _print(rows, tables, out)


def _run_with_bar(config: Any, out: Path) -> dict[str, Any]:
    from rich.console import Console
    from rich.progress import Progress

    from lanebound.agents.reproduce.study import run_study

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(f"{config.seeds} drives of {config.minutes:g} min (kernels compile first)", total=None)
        return run_study(config, out, lambda done, of: bar.update(task, completed=done, total=of))


def _print(rows: list[dict[str, Any]], tables: dict[str, Any], out: Path) -> None:
    from lanebound.agents.cli.output import print_table

    print_table(
        f"S1 against ours: medians over {tables['seeds']} drives [m]",
        ("figure", "paper", "ours", "5 %", "95 %", "band", "met"),
        (
            (
                r["figure"], *(_short(r[k]) for k in ("paper", "ours", "low", "high")),
                f"{r['band'][0]:.3f} .. {r['band'][1]:.3f}", r["met"],
            )
            for r in rows
        ),
    )  # fmt: skip
    rates = tables["exceedance"]
    print_table(
        "Share of epochs whose error exceeds the protection level on either axis",
        ("mode", "form", "1e-3", "1e-4", "1e-5", "1e-6"),
        (
            (mode, form, *(f"{rate:.1e}" for rate in by_risk.values()))
            for mode, forms in rates.items()
            for form, by_risk in forms.items()
        ),
    )
    met = sum(row["met"] for row in rows)
    typer.echo(f"{met} of {len(rows)} printed figures inside the band aimed at; RTK within 1 m at 1e-6 for "
               f"{tables['availability']['rtk_1m']:.2%} of its epochs. Tables and figures: {out}")  # fmt: skip


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
