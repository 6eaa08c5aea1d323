"""``lanebound assess``: measure whether the promises of the navigation layer hold; ``fit-errors`` for its monitors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, EnvIds, Jobs, Page, Plugins, changes
from lanebound.agents.cli.output import carry_out, show, show_study, with_bar
from lanebound.agents.cli.static import known_skies

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

    if in_the_loop:
        from lanebound.agents.studies.in_the_loop import InTheLoopConfig, assess_in_the_loop, shown_in_the_loop

        if rare_risk is not None:
            raise typer.BadParameter("--rare-risk does not go with --in-the-loop: drives are counted, not weighted")
        loop = InTheLoopConfig.load(changes(assignments, risks=risk or None, epochs=epochs, skies=known_skies(sky)))
        if loop.rounding:
            typer.echo(f"note: {loop.rounding}", err=True)
        result = carry_out(out, "street", lambda report: assess_in_the_loop(loop, out, jobs, report))
        show(result, shown_in_the_loop(result), as_json, f"results.json: {out}")
        return
    from lanebound.agents.studies.bounding import BoundingConfig, assess_bounding, shown

    if sky:
        raise typer.BadParameter("--sky goes with --in-the-loop: add it, or leave --sky away")
    config = BoundingConfig.load(changes(assignments, risks=risk or None, epochs=epochs, rare_risk=rare_risk))
    result = carry_out(out, "part", lambda report: assess_bounding(config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json: {out}")


@app.command("faults")
def faults(
    out: Annotated[Path, typer.Option(help="Folder for results.json and figures; an interrupted run goes on.")],
    vehicles: Annotated[
        int | None, typer.Option(min=1, help="Vehicles that meet each fault; the study has 64.")
    ] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    r"""Every kind of fault in several sizes and lengths: is it noticed, how soon, and does it mislead?

    Example: lanebound assess faults --out out/faults --vehicles 4 --set 'kinds=\[spoofing,jamming]'
    """
    from lanebound.agents.studies.faults import FaultsConfig, assess_faults, shown

    config = FaultsConfig.load(changes(assignments, vehicles=vehicles))
    result = carry_out(out, "part", lambda report: assess_faults(config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json, faults.svg, detectability.svg: {out}")


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
    from lanebound.agents.studies.in_the_loop import (
        InformativenessConfig,
        assess_informativeness,
        shown_informativeness,
    )

    config = InformativenessConfig.load(changes(assignments, skies=known_skies(sky), streets=streets))
    result = carry_out(out, "street", lambda report: assess_informativeness(config, out, jobs, report))
    show(result, shown_informativeness(result), as_json, f"results.json, informativeness.svg: {out}")


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
    from lanebound.agents.studies.conventional import RtkRealismConfig, assess_rtk, shown

    config = RtkRealismConfig.load(changes(assignments, streets=streets))
    result = carry_out(out, "street", lambda report: assess_rtk(folder, config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json: {out}")


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
    from lanebound.agents.studies.signals import SignalsConfig, assess_signals, shown

    config = SignalsConfig.load(changes(assignments))
    result = with_bar("streets", lambda report: assess_signals(folder, config, out, report, labels))
    show(result, shown(result), as_json, f"signals.json: {out}")


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
    from lanebound.agents.episodes.opening import open_env
    from lanebound.agents.studies.others import OthersConfig, assess_others, difference_rows

    config = OthersConfig.load(changes(None, episodes=episodes, seed=seed))
    result = assess_others(config, open_env(env, changes(assignments)).config, out)
    show(result, [(f"Others in {env}: medians or shares", difference_rows(result))], as_json)


@app.command("limits")
def limits(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    env: EnvIds = None,
    seeds: Annotated[int | None, typer.Option(min=2, help="Episodes under each error; the study has 32.")] = None,
    page: Page = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Whether alert limits are the largest errors that are safe: a driver that ignores alerts, under constant errors.

    Example: lanebound assess limits --out out/limits --env LaneKeeping --seeds 8
    """
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.limits import ALERT_SECTIONS, AlertLimitsConfig, alert_tables, assess_alert_limits

    if page is not None:
        require_page(page, ALERT_SECTIONS)
    config = AlertLimitsConfig.load(changes(assignments, envs=env, seeds=seeds))
    found = carry_out(out, "id", lambda report: assess_alert_limits(config, out, jobs, report))
    show_study(found, alert_tables(found), out, page, as_json)


@app.command("decisions")
def decisions(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    env: Annotated[
        list[str] | None, typer.Option(help="An id of ours without lanebound/, with an engine; may be repeated.")
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=2, help="Episodes of each case; the study has 100.")] = None,
    page: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose tables are written anew.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Where a level decides: navigators and drivers in each id, beside the same driver with a clock in its place.

    Example: lanebound assess decisions --out out/decisions --env Guidance --seeds 8
    """
    from lanebound.agents.report.pages import fill, require_page
    from lanebound.agents.studies.decisions import SECTIONS, DecisionsConfig, assess_decisions, tables

    if page is not None:
        require_page(page, SECTIONS[:1])
    config = DecisionsConfig.load(changes(assignments, envs=env, seeds=seeds))
    found = carry_out(out, "place", lambda report: assess_decisions(config, out, jobs, report))
    shown = tables(found)
    if page is not None:  # the other tables have hundreds of rows: they are printed, and in results.json
        fill(page, {SECTIONS[0]: shown[SECTIONS[0]]})
    show_study(found, shown, out, None, as_json)


@app.command("cities")
def cities(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    env: Annotated[
        list[str] | None, typer.Option(help="An id of ours without lanebound/, with an engine; may be repeated.")
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=2, help="Episodes of each id and driver; the study has 32.")] = None,
    page: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose table is written anew.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """What drivers and shipped policies keep in cities that nothing was tuned on: reward, cost and availability.

    Example: lanebound assess cities --out out/cities --env LaneKeeping --seeds 8
    """
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.cities import SECTIONS, GeneralisationConfig, assess_cities, tables

    if page is not None:
        require_page(page, SECTIONS)
    config = GeneralisationConfig.load(changes(assignments, envs=env, seeds=seeds))
    found = carry_out(out, "id", lambda report: assess_cities(config, out, jobs, report))
    show_study(found, tables(found), out, page, as_json)


@app.command("journeys")
def journeys(
    out: Annotated[Path, typer.Option(help="Folder for results.json and ppo.zip; a run is resumed there.")],
    cities: Annotated[int | None, typer.Option(min=1, max=100, help="Test cities; the study has 20.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Decisions to learn from; the study has 400,000.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Drivers of Journey-v0 and a learnt one in unseen cities, under the navigator and on the fast engine.

    Example: lanebound assess journeys --out out/drivers --cities 2 --steps 20000
    """
    from lanebound.agents.studies.journey_drivers import JourneyDriversConfig, assess_journeys, shown

    config = JourneyDriversConfig.load(changes(assignments, cities=cities, steps=steps))
    result = carry_out(out, "part", lambda report: assess_journeys(config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json and ppo.zip: {out}")


@app.command("relative-levels")
def relative_levels(
    out: Annotated[Path, typer.Option(help="Folder for results.json; a run is resumed there.")],
    decisions: Annotated[int | None, typer.Option(min=1, help="Of each environment; the study has 200.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """How often positions of other vehicles by cooperative perception are beyond their levels, in all ids with traffic.

    Example: lanebound assess relative-levels --out out/relative --decisions 50
    """
    from lanebound.agents.studies.relative_levels import RelativeLevelsConfig, run_relative_levels, shown

    config = RelativeLevelsConfig.load(changes(assignments, decisions=decisions))
    result = carry_out(out, "part", lambda report: run_relative_levels(config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json: {out}")


@app.command("monitors")
def assess_monitors(
    out: Annotated[Path, typer.Option(help="Folder for results.json and report.html; a run is resumed there.")],
    data: Annotated[Path | None, typer.Option(metavar="FOLDER", help="A recorded drive of smartLoc.")] = None,
    sky: Annotated[list[str] | None, typer.Option(help="A level of sky that is simulated; may be repeated.")] = None,
    monitor: Annotated[
        list[str] | None, typer.Option(help="A monitor, as 'lanebound monitors' lists them; may be repeated.")
    ] = None,
    streets: Annotated[int | None, typer.Option(min=1, help="Streets of each sky; the study has 6.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """All monitors that apply, on the same epochs: exceedances, levels, availability, alarms and cost of each one.

    Example: lanebound assess monitors --data data/smartloc_berlin_potsdamer --out out/monitors
    """
    from lanebound.agents.studies.monitors import MonitorsConfig, shown, write_page
    from lanebound.agents.studies.monitors import assess_monitors as assess

    config = MonitorsConfig.load(
        changes(assignments, skies=known_skies(sky), monitors=monitor or None, streets=streets)
    )
    result = carry_out(out, "part", lambda report: assess(config, data, out, jobs, report))
    written = ", ".join(path.name for path in write_page(config, result, out))
    show(result, shown(config, result), as_json, f"results.json, {written}: {out}")


def fit_errors(
    out: Annotated[Path, typer.Option(metavar="FILE.yaml", help="Preset to write.")],
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="[DATASET]", help="Folder of a drive of smartLoc; its first part is fitted."),
    ] = None,
    sky: Annotated[str | None, typer.Option(help="In place of a data set: simulated streets under a sky.")] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Fit overbounds of code errors to classes of C/N0, elevation and path, and laws of the position error.

    Keys for --set: training_share, form (cdf, tail, paired, pdf), sides (both, late, early), centred, edges, fewest.

    Example: lanebound fit-errors data/smartloc_berlin_potsdamer --out berlin.yaml
    """
    from lanebound.agents.studies.monitored_drives import FitErrorsConfig, class_rows, law_rows, write_preset
    from lanebound.agents.studies.monitored_drives import fit_errors as fit

    fitted, found = fit(dataset, sky, FitErrorsConfig.load(changes(assignments)))
    write_preset(out, fitted)
    shown = (
        ("Overbounds of code errors by class", class_rows(fitted.classes)),
        ("Laws of all code errors, and the errors themselves", law_rows(found)),
    )
    show({"fitted": fitted.to_dict(), **found}, shown, as_json, f"Preset: {out}")
