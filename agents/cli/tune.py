"""``lanebound tune``: figures of agents that are found by driving training seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lanebound.agents.cli.advice import AdvisingGroup

__all__ = ["app"]

app = typer.Typer(cls=AdvisingGroup, help="Find figures of agents on training seeds.", no_args_is_help=True)


@app.callback()
def _tune() -> None:
    """Find figures of agents on training seeds."""


@app.command("cautious")
def cautious(
    name: Annotated[str, typer.Argument(metavar="ID", help="An environment, as 'lanebound envs' lists them.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the episodes; a run goes on where one stopped.")],
    sky: Annotated[str, typer.Option(help="Level of the sky.")] = "dense",
    seeds: Annotated[int, typer.Option(min=1, help="How many, from the first training seed on.")] = 40,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core by default.")] = None,
) -> None:
    """Constant margins to compare the integrity-aware driver with; prints JSON.

    Of a ladder of nine, the least caution that does no more harm; where none does as little, that of its throughput.

    Example: lanebound tune cautious CarFollowing --sky dense --out out/tune
    """
    from lanebound.agents.cli.interrupt import stoppable, wait_for
    from lanebound.agents.cli.output import print_json

    with stoppable(lambda: f"finished episodes are kept in {out}: the same command goes on"):
        print_json(wait_for(lambda: _tuned(name, sky, seeds, out, jobs)))


def _tuned(name: str, sky: str, seeds: int, out: Path, jobs: int | None) -> dict[str, Any]:
    from rich.console import Console
    from rich.progress import Progress

    from lanebound.agents.benchmark.running import Progress as Run
    from lanebound.agents.benchmark.tuning import tune_cautious

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("driving", total=None)

        def told(progress: Run) -> None:
            bar.update(task, completed=progress.done, total=progress.of)

        return tune_cautious(name, sky, seeds, out, jobs, told)
