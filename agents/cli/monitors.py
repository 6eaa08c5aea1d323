"""``lanebound monitors``, ``fit-errors`` and ``assess monitors``: the family of integrity monitors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.early import known_skies
from lanebound.agents.cli.options import AsJson, Assignments, Jobs, Plugins, changes

__all__ = ["assess_monitors", "fit_errors", "monitors"]


def monitors(as_json: AsJson = False, _plugins: Plugins = None) -> None:
    """List the monitors of the family: source, needs and promise of each one.

    Example: lanebound monitors --json
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.integrity.monitoring.family.kinds import FAMILY

    if as_json:
        print_json([
            {"monitor": k.name, "group": k.group, "does": k.summary, "source": k.source, "needs": list(k.needs),
             "promise": k.promise, "config": k.changes}
            for k in FAMILY.values()
        ])  # fmt: skip
        return
    rows = [(k.name, k.summary, k.source, ", ".join(k.needs), k.promise) for k in FAMILY.values()]
    print_table("Monitors", ("monitor", "does", "source", "needs", "promise"), rows)
    typer.echo("Needs: steps are displacements by wheels and gyro or by Doppler, fit is a preset of 'fit-errors'.")
    typer.echo("All on the same epochs: 'lanebound assess monitors --data FOLDER --out DIR', or --sky urban.")


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
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.studies.fit_errors import FitErrorsConfig, class_rows, law_rows, write_preset
    from lanebound.agents.studies.fit_errors import fit_errors as fit

    fitted, found = fit(dataset, sky, FitErrorsConfig.load(changes(assignments)))
    write_preset(out, fitted)
    if as_json:
        print_json({"fitted": fitted.to_dict(), **found})
        return
    print_table("Overbounds of code errors by class", *class_rows(fitted.classes))
    print_table("Laws of all code errors, and the errors themselves", *law_rows(found))
    typer.echo(f"Preset: {out}")


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
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.studies.monitored_drives import campaign_rows
    from lanebound.agents.studies.monitors import MonitorsConfig, monitor_rows, predicted_rows, write_page
    from lanebound.agents.studies.monitors import assess_monitors as assess

    with resumable(lambda: kept_text(out, "parts/*.json", "part")):
        given = changes(assignments, skies=known_skies(sky), monitors=monitor or None, streets=streets)
        config = MonitorsConfig.load(given)
        result = with_bar("parts", lambda on_progress: assess(config, data, out, jobs, on_progress))
        written = write_page(config, result, out)
    if as_json:
        print_json(result)
        return
    for place, found in result["places"].items():
        if found["monitors"]:
            title = f"{place}, {found['epochs']:,} epochs: rate of errors beyond the level over the risk"
            print_table(title, *monitor_rows(config, found))
    for place, tried in result["campaign"].items():
        limit = f"{config.campaign.alert_limit_m:g} m"
        title = f"{place}, faults: noticed, median; vehicles off by more than {limit}, longest time to alert"
        print_table(title, *campaign_rows(tried))
    heads, rows = predicted_rows(result)
    if rows:
        print_table(
            "Predicted HPL within 50 m, P_FA 5e-3, P_MD 5e-5; S3: GPS 50 to 7 %, two systems 100 to 55 %", heads, rows
        )
    typer.echo(f"results.json, {', '.join(path.name for path in written)}: {out}")
