"""``lanebound tune``: parameters of agents, fitted on training seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lanebound.agents.cli.advice import AdvisingGroup
from lanebound.agents.cli.options import Cores, EnvId, Plugins

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
