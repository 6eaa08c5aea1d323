"""``lanebound tune``: parameters of agents, fitted on training seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.early import known_skies
from lanebound.agents.cli.options import AsJson, Assignments, Cores, EnvId, Jobs, Plugins, changes

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, help="Fit parameters of agents on training seeds.", no_args_is_help=True)


@app.callback()
def _tune() -> None:
    """Fit parameters of agents on training seeds."""


@app.command("cautious")
def cautious(
    name: EnvId,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the episodes; a run is resumed there.")],
    sky: Annotated[str, typer.Option(help="Preset of the sky.")] = "dense",
    seeds: Annotated[int, typer.Option(min=1, help="How many, from the first training seed on.")] = 40,
    jobs: Cores = None,
    _plugins: Plugins = None,
) -> None:
    """Constant margins to compare the integrity-aware driver with; prints JSON.

    Of a ladder of nine, the least caution that does no more harm; where none does as little, that of its throughput.

    Example: lanebound tune cautious CarFollowing --sky dense --out out/tune
    """
    from lanebound.agents.benchmark.tuning import tune_cautious
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar

    with resumable(lambda: kept_text(out, "episodes/*/*/*/*.parquet", "episode")):
        print_json(with_bar("episodes", lambda on_progress: tune_cautious(name, sky, seeds, out, jobs, on_progress)))


@app.command("growth")
def growth(
    names: Annotated[list[str], typer.Argument(metavar="ID...", help="Environments with decisions of one length.")],
    skies: Annotated[list[str] | None, typer.Option("--sky", help="Preset of the sky; may be repeated.")] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Episodes a sky, from the first training seed on.")] = 40,
    _plugins: Plugins = None,
) -> None:
    """How protection levels grow without RTK, for the drivers that predict them; prints JSON.

    Example: lanebound tune growth CarFollowing LaneKeeping --seeds 20
    """
    from lanebound.agents.benchmark.growth_fit import fit_growth, measure_growth
    from lanebound.agents.cli.output import print_json
    from lanebound.agents.cli.progress import with_bar

    chosen = tuple(skies or ("urban", "dense"))
    print_json(fit_growth(*with_bar("episodes", lambda on_progress: measure_growth(names, chosen, seeds, on_progress))))


@app.command("limits")
def limits(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for results.json; a run is resumed there.")],
    env: Annotated[
        list[str] | None,
        typer.Option("--env", metavar="ID", help="This id alone; may be repeated. All eight otherwise."),
    ] = None,
    sky: Annotated[
        list[str] | None,
        typer.Option("--sky", help="Preset of the sky; may be repeated. Otherwise that of each id, and urban."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=2, help="Episodes of each, of training seeds; by default 24.")
    ] = None,
    page: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Page whose tables are written anew.")] = None,
    jobs: Jobs = 1,
    assignments: Assignments = None,
    _plugins: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Limits of an episode's cost and of each group: what integrity_aware keeps in 70 % of its episodes, rounded up.

    Example: lanebound tune limits --out out/cost-limits --env LaneKeeping --seeds 12
    """
    from lanebound.agents.cli.output import show_study
    from lanebound.agents.cli.progress import kept_text, resumable, with_bar
    from lanebound.agents.report.pages import require_page
    from lanebound.agents.studies.cost_limits import SECTIONS, CostLimitsConfig, tables, tune_cost_limits

    if page is not None:
        require_page(page, SECTIONS)
    config = CostLimitsConfig.load(changes(assignments, envs=env, skies=known_skies(sky), seeds=seeds))
    with resumable(lambda: kept_text(out, "parts/*.json", "id and sky")):
        found = with_bar("ids and skies", lambda on_progress: tune_cost_limits(config, out, jobs, on_progress))
    show_study(found, tables(found), out, page, as_json)
