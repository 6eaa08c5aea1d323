"""``lanebound reproduce``: the results of the source papers, from one documented parameter set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, Jobs, changes

if TYPE_CHECKING:
    from lanebound.agents.studies.urban_drive import UrbanDriveConfig

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, help="Reproduce the results of the source papers.", no_args_is_help=True)


@app.callback()
def _reproduce() -> None:
    """Reproduce the results of the source papers."""


@app.command("urban-drive")
def urban_drive(
    out: Annotated[Path, typer.Option(help="Folder for tables.json and the figures; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Number of drives; the study has 100.")] = None,
    minutes: Annotated[float | None, typer.Option(min=1.0, help="Length of a drive; the study has 26.")] = None,
    ablate: Annotated[
        bool, typer.Option("--ablate", help="Count the cells met when each chosen constant is taken away; 10 studies.")
    ] = False,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """A Tokyo-like urban drive: RTK, Doppler, IMU + odometer, and the tables of S1 next to ours.

    Example: lanebound reproduce urban-drive --out out/urban --seeds 10
    """
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.urban_drive_study import check, run_study

    if ablate:
        _ablate(out, changes(assignments, seeds=seeds, minutes=minutes), as_json)
        return
    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = _config(changes(assignments, seeds=seeds, minutes=minutes))
        check(config, out)
        tables = with_bar("epochs", lambda on_progress: run_study(config, out, on_progress))
        _report(tables, out, as_json)


@app.command("filters")
def filters(
    out: Annotated[Path, typer.Option(help="Folder for tables.json and the figures; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Drives of each trial; the study has 100.")] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """The trials of S4: EKF, UKF, IMM and dead reckoning through outages, spurious positions, sharp turns and faults.

    Example: lanebound reproduce filters --out out/filters --seeds 10
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.filter_faults import fault_rows
    from lanebound.agents.studies.filter_scenarios import law_rows
    from lanebound.agents.studies.filters import FiltersConfig, run_filters, sharp_rows, table_rows

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = FiltersConfig.load(changes(assignments, seeds=seeds))
        result = with_bar("trials", lambda on_progress: run_filters(config, out, on_progress))
    if as_json:
        print_json(result)
        return
    heads = "trial", "figure", "paper", "ours", "5 .. 95 %"
    print_table(f"S4 against ours: medians over {result['seeds']} drives [m]", heads, table_rows(result))
    if result["sharp"]:
        models = "SM-EKF", "SM-EKF, yaw noise of CM", "CM-EKF"
        sensors = "sensors", "largest, IMM", "largest, SM-EKF", *(f"RMS gained over {name}" for name in models), "HTL"
        print_table("Scenario 10 with better sensors [m]; S4: below 3, -, 0.48, -", sensors, sharp_rows(result))
    log = "static log", "S4", "ours", "5 .. 95 %"
    print_table("Warm-up error of accelerometers: the fit of logs made by S4's law", log, law_rows(result["law"]))
    if result["faults"]:
        print_table("Spurious positions: with S4's gate and without", *fault_rows(result))
    typer.echo(f"tables.json and figures: {out}")


@app.command("barrier-promise")
def barrier_promise(
    out: Annotated[Path, typer.Option(help="Folder for promise.json; a run is resumed there.")],
    episodes: Annotated[int | None, typer.Option(min=1, help="Of each group; the study has 1,000.")] = None,
    source: Annotated[str, typer.Option(help="Source of the leader's state: v2v (radio), sensor, or both.")] = "v2v",
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """The barrier filter under reckless drivers: is its barrier ever negative, without faults and with them?

    Example: lanebound reproduce barrier-promise --out out/barrier --episodes 100 --jobs 2
    """
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.barrier_promise import BarrierPromiseConfig, run_promise

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = BarrierPromiseConfig.load(changes(None, episodes=episodes, source=source))
        found = with_bar("episodes", lambda on_progress: run_promise(config, out, jobs, on_progress))
        _report_promise(found, out, as_json)


@app.command("services")
def services(
    out: Annotated[Path, typer.Option(help="Folder for services.json; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Streets of each sky; the study has 100.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Positioning services under open, half-open and urban skies, next to S2 Table 1, S2 section 6 and S4 III-A.

    Example: lanebound reproduce services --out out/services --seeds 10
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies import services as study

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = study.ServiceStudyConfig.load(changes(assignments, seeds=seeds))
        result = with_bar("parts", lambda on_progress: study.run_services(config, out, jobs, on_progress))
    if as_json:
        print_json(result)
        return
    print_table("Services, medians over streets; shares are means", *study.service_rows(result))
    heads, by_egnos = study.mixed_rows(result)
    if by_egnos:
        print_table("EGNOS by its satellites alone and with SISNeT", heads, by_egnos)
    if "ppp" in result:
        print_table("PPP at rest in the open, by the time since it was switched on", *study.convergence_rows(result))
    heads, lines = study.published_rows(result)
    if lines:
        print_table("The papers line by line", heads, lines)
    typer.echo(f"services.json: {out}")


@app.command("context")
def context(
    out: Annotated[Path, typer.Option(help="Folder for tables.json and the figures; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Drives in each environment; the study has 100.")] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """The context-aware monitor on urban, rural and mixed drives, and the rates of S5 next to ours.

    Example: lanebound reproduce context --out out/context --seeds 5
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies import context_tables as made
    from lanebound.agents.studies.context_study import ContextStudyConfig, run_context

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = ContextStudyConfig().replace(**changes(assignments, seeds=seeds))
        tables = with_bar("points", lambda on_progress: run_context(config, out, on_progress))
    if as_json:
        print_json(tables)
        return
    print_table("Overall correct detection rate; medians over drives, 5 to 95 %", *made.ocdr_rows(tables))
    print_table("By what the receiver uses and declares", *made.assumption_rows(tables))
    print_table("Each phase over the points that reach it, drives together", *made.stage_rows(tables))
    print_table("Why the driver is warned, shares of all points", *made.reason_rows(tables))
    print_table("What each phase adds, and naive rules", *made.rule_rows(tables))
    print_table("Matchers, with the true map and with one that has errors", *made.matcher_rows(tables))
    print_table("Speed phase: windows warned of", *made.speed_rows(tables))
    print_table("Charges by the matched link", *made.application_rows(tables))
    typer.echo(f"tables.json and figures: {out}")


def _report_promise(result: dict[str, Any], out: Path, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table

    if as_json:
        print_json(result)
        return
    groups = list(result)
    named = sorted({name for group in result.values() for name in group["exceptions"]})
    counted = (
        ("counts", "", ("decisions", "kept", "broken", "exceptional", "lost", "unsafe starts")),
        ("exceptions", "exceptions: ", named),
        ("filter", "", ("following infeasible", "lane slack", "lane infeasible")),
    )
    rows = [("episodes", *(result[g]["episodes"] for g in groups))]
    rows += [
        (f"{head}{key}", *(result[g][kind].get(key, 0) for g in groups)) for kind, head, keys in counted for key in keys
    ]
    for key in ("crashes", "integrity_risk", "level_exceeded_per_decision", "barrier_lost_per_decision"):
        rows.append((key.replace("_", " "), *(result[g][key] for g in groups)))
    rows.append(("crashes, 95 %", *(_interval(result[g]["crash_share_95"]) for g in groups)))
    rows.append(("least barrier [m]", *(_short(result[g]["least_barrier_m"]) for g in groups)))
    print_table("The barrier's promise, by faults injected", ("", *groups), rows)
    kinds = result["one fault"]["by_fault"]
    crashes = [
        (kind.replace("_", " "), str(of["episodes"]), str(of["crashes"]), _interval(of["crash_share_95"]))
        for kind, of in kinds.items()
    ]
    print_table("Crashes by the fault that was injected", ("fault", "episodes", "crashes", "share, 95 %"), crashes)
    typer.echo("broken: the barrier went negative by a decision for which every assumption held; none may be.")
    typer.echo(f"promise.json: {out}")


def _interval(share: Sequence[float]) -> str:
    return f"{100.0 * share[0]:.1f} to {100.0 * share[1]:.1f} %"


def _config(changed: dict[str, Any]) -> UrbanDriveConfig:
    """The configuration of the study with changes."""
    from lanebound.agents.cli.kinds import resolve
    from lanebound.agents.studies.urban_drive import UrbanDriveConfig

    _, config = resolve("studies/urban_drive", changed)
    assert isinstance(config, UrbanDriveConfig)
    return config


def _ablate(out: Path, changed: dict[str, Any], as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.ablation import ablation_rows, run_ablation

    with resumable(lambda: kept_text(out, "*/parts/*.json", "part")):
        config = _config(changed)
        result = with_bar("epochs", lambda on_progress: run_ablation(config, out, on_progress))
    if as_json:
        print_json(result)
        return
    title = f"Cells of S1 met without a constant: {result['seeds']} drives of {result['minutes']:g} min"
    print_table(title, *ablation_rows(result))
    typer.echo(f"ablation.json, and tables and figures of each: {out}")


def _report(tables: dict[str, Any], out: Path, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.studies.urban_drive_study import is_short, rows_against_paper

    rows, short = rows_against_paper(tables), is_short(tables)
    if as_json:
        print_json({"tables": tables, "against_paper": rows, "short_run": short})
        return
    _print_figures(rows, tables, short)
    _print_exceedance(tables)
    typer.echo(f"RTK within 1 m at 1e-6 for {tables['availability']['rtk_1m']:.2%} of its epochs.")
    typer.echo(f"Tables and figures: {out}")


def _print_figures(rows: list[dict[str, Any]], tables: dict[str, Any], short: bool) -> None:
    from lanebound.agents.cli.output import print_table
    from lanebound.agents.studies.urban_drive_study import verdict

    print_table(
        f"S1 against ours: medians over {tables['seeds']} drives of {tables['minutes']:g} min [m]",
        ("figure", "paper", "ours", "5 %", "95 %", "band aimed at", "ours in band"),
        (
            (
                r["figure"], *(_short(r[k]) for k in ("paper", "ours", "low", "high")),
                f"{r['band'][0]:.3f} .. {r['band'][1]:.3f}", verdict(r, short),
            )
            for r in rows
        ),
    )  # fmt: skip
    met = sum(row["met"] for row in rows)
    typer.echo(f"{met} of {len(rows)} printed figures lie inside the band aimed at.")
    if short:
        typer.echo(
            "The bands are meant for the whole study, 100 drives of 26 min: this run is shorter, and a figure outside "
            "its band\nmay be chance. Leave out --seeds and --minutes for the full comparison."
        )
    typer.echo()


def _print_exceedance(tables: dict[str, Any]) -> None:
    from lanebound.agents.cli.output import print_table
    from lanebound.agents.studies.urban_drive import MODES

    print_table(
        "Share of epochs whose error exceeds the protection level on either axis",
        ("mode", "form", "epochs", "1e-3", "1e-4", "1e-5", "1e-6"),
        (
            (mode, form, f"{tables['epochs'][mode]:,}", *(_share(rate) for rate in by_risk.values()))
            for mode in MODES
            for form, by_risk in sorted(tables["exceedance"].get(mode, {}).items(), reverse=True)
        ),
    )
    total = sum(tables["epochs"].values())
    typer.echo(f"Shares are of {total:,} epochs in all, ten a second and so strongly correlated.\n")


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _share(rate: float) -> str:
    return "0" if rate == 0.0 else f"{rate:.1e}"
