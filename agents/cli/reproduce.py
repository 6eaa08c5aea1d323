"""``lanebound reproduce``: the results of the source papers, from one documented parameter set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import AsJson, Assignments, Jobs, changes
from lanebound.agents.cli.output import carry_out, kept_text, resumable, show, with_bar

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
    from lanebound.agents.cli.listing import resolve
    from lanebound.agents.studies import urban_drive as study

    _, config = resolve("studies/urban_drive", changes(assignments, seeds=seeds, minutes=minutes))
    assert isinstance(config, study.UrbanDriveConfig)
    if ablate:
        with resumable(lambda: kept_text(out, "*/parts/*.json", "part")):
            found = with_bar("epochs", lambda report: study.run_ablation(config, out, report))
        title = f"Cells of S1 met without a constant: {found['seeds']} drives of {found['minutes']:g} min"
        written = f"ablation.json, and tables and figures of each: {out}"
        show(found, [(title, study.ablation_rows(found))], as_json, written)
        return
    study.check(config, out)
    tables = carry_out(out, "part", lambda report: study.run_study(config, out, report), "epochs")
    against = study.rows_against_paper(tables)
    data = {"tables": tables, "against_paper": against, "short_run": study.is_short(tables)}
    show(data, study.shown(tables), as_json, f"Tables and figures: {out}")


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
    from lanebound.agents.studies.filters import FiltersConfig, run_filters, shown

    config = FiltersConfig.load(changes(assignments, seeds=seeds))
    result = carry_out(out, "part", lambda report: run_filters(config, out, report), "trials")
    show(result, shown(result), as_json, f"tables.json and figures: {out}")


@app.command("barrier-promise")
def barrier_promise(
    out: Annotated[Path, typer.Option(help="Folder for promise.json; a run is resumed there.")],
    episodes: Annotated[int | None, typer.Option(min=1, help="Of each group; the study has 1,000.")] = None,
    source: Annotated[
        str, typer.Option(help="Source of the leader's state: v2v (radio), sensor, both, or cooperative (with ranges).")
    ] = "v2v",
    kind: Annotated[
        str | None, typer.Option(help="Only episodes whose fault is of this kind, such as v2v_lie.")
    ] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """The barrier filter under reckless drivers: is its barrier ever negative, without faults and with them?

    Example: lanebound reproduce barrier-promise --out out/barrier --episodes 100 --jobs 2
    """
    from lanebound.agents.studies.barrier_promise import BarrierPromiseConfig, run_promise, shown

    config = BarrierPromiseConfig.load(changes(assignments, episodes=episodes, source=source, kind=kind))
    found = carry_out(out, "part", lambda report: run_promise(config, out, jobs, report), "episodes")
    show(found, shown(found), as_json, f"promise.json: {out}")


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
    from lanebound.agents.studies.services import ServiceStudyConfig, run_services, shown

    config = ServiceStudyConfig.load(changes(assignments, seeds=seeds))
    result = carry_out(out, "part", lambda report: run_services(config, out, jobs, report))
    show(result, shown(result), as_json, f"services.json: {out}")


@app.command("cooperative")
def cooperative(
    out: Annotated[Path, typer.Option(help="Folder for cooperative.json; a run is resumed there.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Drives under each sky; the study has 100.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Two vehicles and two roadside units that share codes and ranges, next to S2 Table 5; and one of them lies.

    Example: lanebound reproduce cooperative --out out/cooperative --seeds 4 --set skies=[open,urban]
    """
    from lanebound.agents.studies.cooperative import CooperativeStudyConfig, run_cooperative, shown

    config = CooperativeStudyConfig.load(changes(assignments, seeds=seeds))
    result = carry_out(out, "part", lambda report: run_cooperative(config, out, jobs, report), "drives")
    show(result, shown(result), as_json, f"cooperative.json: {out}")


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
    from lanebound.agents.studies.context_study import ContextStudyConfig, run_context, shown

    config = ContextStudyConfig().replace(**changes(assignments, seeds=seeds))
    tables = carry_out(out, "part", lambda report: run_context(config, out, report), "points")
    show(tables, shown(tables), as_json, f"tables.json and figures: {out}")


@app.command("map-matching")
def map_matching(
    out: Annotated[Path, typer.Option(help="Folder for results.json and the figure; a run is resumed there.")],
    maps: Annotated[
        list[str],
        typer.Option("--map", metavar="MAP", help="FILE.osm, .osm.gz or .osm.pbf, or a packaged map; two at least."),
    ],
    drives: Annotated[
        int | None, typer.Option(min=2, help="Drives on each map under each sky; the study has 40.")
    ] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Scores of map matching beside S5's (its Table 5) on real roads; thresholds are fitted on the other maps.

    Example: lanebound reproduce map-matching --out out/matching --map berlin_kreuzberg --map Helsinki.osm.pbf
    """
    from lanebound.agents.studies.map_matching import run_map_matching, shown
    from lanebound.agents.studies.matched_drives import MapMatchingConfig

    config = MapMatchingConfig.load(changes(assignments, maps=maps, drives=drives))
    result = carry_out(out, "part", lambda report: run_map_matching(config, out, jobs, report), "drives")
    show(result, shown(result), as_json, f"results.json and figure: {out}")


@app.command("prediction")
def prediction(
    out: Annotated[Path, typer.Option(help="Folder for results.json and the figures; a run is resumed there.")],
    streets: Annotated[
        int | None, typer.Option(min=1, help="Streets of each sky for the fit, and as many others; the study has 10.")
    ] = None,
    berlin: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder with smartLoc's drive over Gendarmenmarkt, its city model and broadcast messages.",
        ),
    ] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Satellites, PDOP, availability and levels predicted before a journey from maps of a city, as in S2 section 3.

    Example: lanebound reproduce prediction --out out/prediction --streets 4
    """
    from lanebound.agents.studies.prediction import PredictionConfig, run_prediction, shown

    config = PredictionConfig.load(changes(assignments, streets=streets))
    result = carry_out(out, "part", lambda report: run_prediction(config, out, jobs, report, berlin))
    show(result, shown(result), as_json, f"results.json and figures: {out}")


@app.command("ranging")
def ranging(
    data: Annotated[Path, typer.Option(metavar="DIR", help="Folder with Indoor_UWB_Input.txt and Indoor_UWB_GT.txt.")],
    out: Annotated[Path, typer.Option(help="Folder for ranging.json.")],
    as_json: AsJson = False,
) -> None:
    """Our law of UWB ranges against recorded ones: noise, late ranges, and how its bounds hold.

    Example: lanebound reproduce ranging --data data/uwb_indoor --out out/ranging
    """
    from lanebound.agents.studies.ranging import run_ranging, shown

    result = run_ranging(data, out)
    show(result, shown(result), as_json, f"ranging.json: {out}")


@app.command("availability")
def availability(
    out: Annotated[Path, typer.Option(help="Folder for availability.json; a run is resumed there.")],
    cities: Annotated[int | None, typer.Option(min=1, help="Training cities; the packaged model has 10.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Fit the model of availability by which journeys are planned; configs/maps/availability.json is its output.

    Example: lanebound reproduce availability --out out/availability --cities 2
    """
    from lanebound.agents.studies.availability import AvailabilityConfig, run_availability, shown

    config = AvailabilityConfig.load(changes(assignments, cities=cities))
    result = carry_out(out, "part", lambda report: run_availability(config, out, jobs, report))
    show(result, shown(result), as_json, f"availability.json: {out}")


@app.command("journeys")
def journeys(
    out: Annotated[Path, typer.Option(help="Folder for results.json and the figure; a run is resumed there.")],
    cities: Annotated[int | None, typer.Option(min=1, max=100, help="Test cities; the study has 20.")] = None,
    pairs: Annotated[int | None, typer.Option(min=1, help="Journeys in each; the study has 10.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Routes chosen by length, time and predicted integrity in unseen cities, driven by the whole navigator.

    Example: lanebound reproduce journeys --out out/journeys --cities 2 --pairs 3
    """
    from lanebound.agents.studies.journeys import JourneysConfig, run_journeys, shown

    config = JourneysConfig.load(changes(assignments, cities=cities, pairs=pairs))
    result = carry_out(out, "part", lambda report: run_journeys(config, out, jobs, report))
    show(result, shown(result), as_json, f"results.json and figure: {out}")
