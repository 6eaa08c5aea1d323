"""``lanebound curves``: what a policy learns in a few minutes, in each id as it is shipped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.options import AsJson, Assignments, changes

__all__ = ["curves"]


def curves(
    out: Annotated[Path, typer.Option(help="Folder of the trainings and results; a run is resumed there.")],
    env: Annotated[
        list[str] | None,
        typer.Option("--env", metavar="ID", help="This id alone; may be repeated. All eight otherwise."),
    ] = None,
    minutes: Annotated[float | None, typer.Option(min=0.01, help="Of a core for learning in each id; 6.")] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE.md", help="Page whose tables and picture are written anew.")
    ] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Train under the cost limit in each id as it is shipped, and judge the checkpoints on held-out seeds.

    Policies learn with recorded neighbours and are judged with receivers, beside 'nominal' and the shipped 'ppo'.

    Example: lanebound curves --out out/curves --env LaneKeeping --minutes 1
    """
    from lanebound.agents.cli.output import show_study
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.curves import SECTIONS, CurvesConfig, run_curves, save_curves, tables

    if page is not None:
        require_page(page, SECTIONS)
    config = CurvesConfig.load(changes(assignments, envs=env, minutes=minutes))
    with resumable(lambda: f"{kept_text(out, 'parts/*.json', 'id')}; trainings go on from their last checkpoint"):
        found = with_bar("ids", lambda on_progress: run_curves(config, out, on_progress))
        figure = save_curves(found, out if page is None else page.parent)
    show_study(found, tables(found), out, page, as_json)
    if not as_json:
        typer.echo(f"picture: {figure}")
