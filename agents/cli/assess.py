"""``lanebound assess``: measure whether the promises of the navigation layer hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.early import known_skies
from lanebound.agents.cli.options import AsJson, Assignments, Jobs, Plugins, changes

__all__ = ["app"]

SIZES = {"worst": "the size that misleads most", "uniform": "any size up to twice the threshold's"}

app = typer.Typer(
    cls=AdvisingGroup, help="Measure whether the promises of the navigation layer hold.", no_args_is_help=True
)


@app.callback()
def _assess() -> None:
    """Measure whether the promises of the navigation layer hold."""


@app.command("bounding")
def bounding(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    risk: Annotated[
        list[float] | None,
        typer.Option("--risk", help="Horizontal risk to count at; may be repeated. The study has 1e-3, 1e-4, 1e-5."),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Epochs to draw, two axes each; the study has 50 million. The other tables take minutes all the same.",
        ),
    ] = None,
    rare_risk: Annotated[float | None, typer.Option(help="Risk for importance sampling; the study has 1e-7.")] = None,
    in_the_loop: Annotated[
        bool,
        typer.Option(
            "--in-the-loop",
            help="Drive the whole navigator in generated streets instead of drawing epochs; 1 million epochs a sky.",
        ),
    ] = False,
    sky: Annotated[
        list[str] | None,
        typer.Option(help="With --in-the-loop: a level of sky; may be repeated. The study has urban and dense."),
    ] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """How often errors exceed their protection levels, exact and as the papers print them, with exact intervals.

    Example: lanebound assess bounding --out out/bounds --epochs 1000000 --jobs 2
    """
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.bounding import BoundingConfig, assess_bounding

    if in_the_loop:
        if rare_risk is not None:
            raise typer.BadParameter("--rare-risk does not go with --in-the-loop: drives are counted, not weighted")
        given = changes(assignments, risks=risk or None, epochs=epochs, skies=known_skies(sky))
        _bounding_in_the_loop(out, given, jobs, as_json)
        return
    if sky:
        raise typer.BadParameter("--sky goes with --in-the-loop: add it, or leave --sky away")
    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = BoundingConfig.load(changes(assignments, risks=risk or None, epochs=epochs, rare_risk=rare_risk))
        result = with_bar("parts", lambda on_progress: assess_bounding(config, out, jobs, on_progress))
        _report_bounding(result, out, as_json)


@app.command("faults")
def faults(
    out: Annotated[Path, typer.Option(help="Folder for results.json and figures; an interrupted run goes on.")],
    vehicles: Annotated[
        int | None, typer.Option(min=1, help="Vehicles that meet each fault; the study has 64.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that drive at a time.")] = 1,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a value of the study; may be repeated."),
    ] = None,
    _plugins: Plugins = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    r"""Every kind of fault in several sizes and lengths: is it noticed, how soon, and does it mislead?

    Example: lanebound assess faults --out out/faults --vehicles 4 --set 'kinds=\[spoofing,jamming]'
    """
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.faults import FaultsConfig, assess_faults

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        config = FaultsConfig.load(changes(assignments, vehicles=vehicles))
        result = with_bar("parts", lambda on_progress: assess_faults(config, out, jobs, on_progress))
        _report_faults(result, out, as_json)


@app.command("informativeness")
def informativeness(
    out: Annotated[Path, typer.Option(help="Folder for results.json and the figure; a run is resumed there.")],
    sky: Annotated[
        list[str] | None,
        typer.Option(help="A level of sky; may be repeated. The study has urban, dense and plaza."),
    ] = None,
    streets: Annotated[int | None, typer.Option(min=2, help="Streets of each sky; the study has 12.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Whether protection levels foretell large errors better than mode and age of RTK, on streets held out.

    Example: lanebound assess informativeness --out out/informative --sky urban --streets 4 --jobs 2
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.informativeness import (
        InformativenessConfig,
        assess_informativeness,
        informativeness_rows,
    )

    with resumable(lambda: kept_text(out, "parts/*.json", "street")):
        config = InformativenessConfig.load(changes(assignments, skies=known_skies(sky), streets=streets))
        result = with_bar("streets", lambda on_progress: assess_informativeness(config, out, jobs, on_progress))
    if as_json:
        print_json(result)
        return
    title = f"Errors across the track above {config.error_m:g} m, foretold for streets held out; 95 % by street"
    print_table(title, *informativeness_rows(result))
    typer.echo(f"results.json, informativeness.svg: {out}")


@app.command("rtk")
def rtk(
    folder: Annotated[Path, typer.Argument(help="Folder of a recorded drive: rover_rtk.pos and reference.csv.")],
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    streets: Annotated[int | None, typer.Option(min=1, help="Streets of each sky; the study has 6.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Conventional RTK on simulated signals next to a recorded drive, and the navigator on the same signals.

    Keys for --set: receiver=filtered for a Kalman filter in place of single epochs, kinematic.*, solution.*,
    navigator.*; skies, vehicles, baseline_km.

    Example: lanebound assess rtk drives/nagoya --out out/rtk --jobs 2
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.conventional import (
        RtkRealismConfig,
        assess_rtk,
        navigator_rows,
        rtk_rows,
        sky_rows,
    )

    with resumable(lambda: kept_text(out, "parts/*.json", "street")):
        config = RtkRealismConfig.load(changes(assignments, streets=streets))
        result = with_bar("streets", lambda on_progress: assess_rtk(folder, config, out, jobs, on_progress))
    if as_json:
        print_json(result)
        return
    print_table("Satellites that conventional RTK can use, by sky", *sky_rows(result))
    print_table(f"The sky nearest in usable satellites ({result['nearest']}) next to the recording", *rtk_rows(result))
    print_table("The navigator on the same signals: epochs beyond a level, 95 % by street", *navigator_rows(result))
    typer.echo(f"results.json: {out}")


@app.command("signals")
def signals(
    folder: Annotated[Path, typer.Argument(help="Folder of a drive of smartLoc: *_Input.txt(.gz) and *_GT.txt.")],
    out: Annotated[Path, typer.Option(help="Folder for signals.json and the figure.")],
    labels: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Raw table of a part of the drive: adds Doppler, and errors by path."),
    ] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Errors of code and Doppler of a recorded drive next to simulated ones, by C/N0 and elevation, and by path.

    Example: lanebound assess signals drives/potsdamer --out out/signals --set streets=8
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import with_bar
    from lanebound.agents.studies.signals import SignalsConfig, assess_signals, path_rows, signal_rows

    config = SignalsConfig.load(changes(assignments))
    result = with_bar("streets", lambda on_progress: assess_signals(folder, config, out, on_progress, labels))
    if as_json:
        print_json(result)
        return
    print_table("Share of the codes, and 50 / 75 / 90 / 95 % of their absolute errors [m]", *signal_rows(result))
    if "paths" in result:
        print_table("Absolute errors by path: recorded, with 95 % by satellite; simulated", *path_rows(result))
    typer.echo(f"signals.json: {out}")


@app.command("others")
def others(
    env: Annotated[str, typer.Argument(metavar="ID", help="Environment, as Highway or lanebound/Highway-v0.")],
    out: Annotated[Path, typer.Option(help="Folder for results.json.")],
    episodes: Annotated[int | None, typer.Option(min=8, help="Episodes of each kind; the study has 64.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seeds are drawn from it.")] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Whether broadcasts of surrogates differ from those of vehicles that navigate, in recorded cities and others.

    Example: lanebound assess others Merge --out out/others --episodes 16
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.episodes.opening import open_env
    from lanebound.agents.studies.others import OthersConfig, assess_others, difference_rows

    config = OthersConfig.load(changes(None, episodes=episodes, seed=seed))
    result = assess_others(config, open_env(env, changes(assignments)).config, out)
    if as_json:
        print_json(result)
        return
    heads = ("quantity", "surrogate", "full, same cities", "full, other cities")
    print_table(f"Others in {env}: medians or shares", heads, difference_rows(result))


@app.command("limits")
def limits(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    env: Annotated[
        list[str] | None,
        typer.Option("--env", metavar="ID", help="This id alone; may be repeated. All eight otherwise."),
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=2, help="Episodes under each error; the study has 32.")] = None,
    page: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose tables are written anew.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Whether alert limits are the largest errors that are safe: a driver that ignores alerts, under constant errors.

    Example: lanebound assess limits --out out/limits --env LaneKeeping --seeds 8
    """
    from lanebound.agents.cli.output import show_study
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.alert_limits import SECTIONS, AlertLimitsConfig, assess_alert_limits, tables

    if page is not None:
        require_page(page, SECTIONS)
    config = AlertLimitsConfig.load(changes(assignments, envs=env, seeds=seeds))
    with resumable(lambda: kept_text(out, "parts/*.json", "id")):
        found = with_bar("ids", lambda on_progress: assess_alert_limits(config, out, jobs, on_progress))
    show_study(found, tables(found), out, page, as_json)


@app.command("guidance")
def guidance(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=2, help="Episodes of each case; the study has 24.")] = None,
    page: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose tables are written anew.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """What a position of metres is worth where a camera keeps the lane: services and drivers in Guidance.

    Example: lanebound assess guidance --out out/guidance --seeds 8
    """
    from lanebound.agents.cli.output import show_study
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.guidance import SECTIONS, GuidanceConfig, assess_guidance, tables

    if page is not None:
        require_page(page, SECTIONS)
    config = GuidanceConfig.load(changes(assignments, seeds=seeds))
    with resumable(lambda: kept_text(out, "parts/*.json", "case")):
        found = with_bar("cases", lambda on_progress: assess_guidance(config, out, jobs, on_progress))
    show_study(found, tables(found), out, page, as_json)


def _bounding_in_the_loop(out: Path, given: dict[str, Any], jobs: int, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.in_the_loop import (
        FEW_STREETS,
        InTheLoopConfig,
        assess_in_the_loop,
        exceedance_rows,
        few_streets,
        mode_rows,
        sbas_rows,
        trust_rows,
    )

    with resumable(lambda: kept_text(out, "parts/*.json", "street")):
        config = InTheLoopConfig.load(given)
        if config.rounding:
            typer.echo(f"note: {config.rounding}", err=True)
        result = with_bar("streets", lambda on_progress: assess_in_the_loop(config, out, jobs, on_progress))
    if as_json:
        print_json(result)
        return
    print_table("In the loop: rate of errors beyond the level over the risk, 95 % by street", *exceedance_rows(result))
    print_table(f"Modes, median levels and epochs beyond at {config.risks[0]:g}", *mode_rows(result))
    heads, trusted = trust_rows(result)
    if trusted:
        print_table("Horizontal trust level, 6 sigma of the longer axis (S4 section II-F)", heads, trusted)
    heads, by_sbas = sbas_rows(result)
    if by_sbas:
        print_table("HPL_SBAS, en route, of the positions by codes (DO-229)", heads, by_sbas)
    typer.echo("A rate over the risk above 1 breaks the promise.")
    if few_streets(result):
        typer.echo(f"Fewer than {FEW_STREETS} streets of a sky say little of a rate: give more --epochs.")
    typer.echo(f"results.json: {out}")


def _report_bounding(result: dict[str, Any], out: Path, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.studies.bounding import (
        drift_rows,
        form_rows,
        place_rows,
        rare_place_rows,
        rare_rows,
        strata_rows,
        tightness_rows,
    )

    if as_json:
        print_json(result)
        return
    if "rates" in result:
        print_table(
            f"Misleading epochs, of {result['axis_epochs']:,} axis epochs: rate of either axis over the risk, 95 %",
            *form_rows(result),
        )
        print_table("Of these, by what there was: misleading epochs on either axis", *strata_rows(result))
        print_table("The same by place, at the least risk counted: rate over the risk", *place_rows(result))
        print_table("Levels over the least that would have held without faults, median", *tightness_rows(result))
    if "rare" in result:
        size, most = SIZES[result["config"]["rare_sizes"]], result["rare"]["spent"]["largest"]
        print_table(f"By importance sampling: rate of one axis; faults have {size}", *rare_rows(result))
        typer.echo(
            f"Not drawn: two faults and wrong fixes, at most so often on either axis ({most:.2e} in one geometry)."
        )
        print_table(
            f"The exact root at {result['config']['rare_risk']:g} by biases: rate of one axis", *rare_place_rows(result)
        )
    if "drift" in result:
        print_table("Between fixes: error beyond the level at the end of an outage, either axis", *drift_rows(result))
    typer.echo(f"A rate over the risk above 1 breaks the promise.\nresults.json: {out}")


def _report_faults(result: dict[str, Any], out: Path, as_json: bool) -> None:
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.studies.faults import consistency_rows, control_lines, fault_rows, theory_rows

    if as_json:
        print_json(result)
        return
    print_table(
        "Faults: vehicles that noticed while it lasted, or once it was over, and what it did to them from its onset on",
        *fault_rows(result),
    )
    print_table("Without faults: consistency of the position by mode", *consistency_rows(result))
    if result["theory"]:
        print_table(
            "A bias of one satellite against theory; without one what is noticed is false", *theory_rows(result)
        )
    for line in control_lines(result):
        typer.echo(line)
    typer.echo(f"results.json, faults.svg, detectability.svg: {out}")
