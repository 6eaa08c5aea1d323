"""``lanebound tune``: figures of agents that are found by driving training seeds."""

from __future__ import annotations

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
    sky: Annotated[str, typer.Option(help="Level of the sky.")] = "dense",
    first_seed: Annotated[int, typer.Option(min=0, help="The first; training seeds are 1000 to 1999.")] = 1000,
    seeds: Annotated[int, typer.Option(min=1, help="How many.")] = 20,
    halvings: Annotated[int, typer.Option(min=1, max=8, help="How often the range of caution is halved.")] = 4,
) -> None:
    """Constant margins that do as much harm as the integrity-aware driver; prints JSON.

    Example: lanebound tune cautious CarFollowing --sky dense --seeds 20
    """
    from lanebound.agents.cli.interrupt import stoppable, wait_for
    from lanebound.agents.cli.output import print_json

    with stoppable(lambda: "nothing is kept"):
        print_json(wait_for(lambda: _tuned(name, sky, range(first_seed, first_seed + seeds), halvings)))


def _tuned(name: str, sky: str, seeds: range, halvings: int) -> dict[str, Any]:
    from rich.console import Console
    from rich.progress import Progress

    from lanebound.agents.drivers.tuning import tune_cautious

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("integrity_aware", total=len(seeds) * (halvings + 1))

        def tell(what: str, done: int, of: int) -> None:
            bar.update(task, advance=1, description=what)

        return tune_cautious(name, sky, seeds, halvings, tell)
