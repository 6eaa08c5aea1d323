"""``lanebound agents``: who can drive, and what each of them does with what it is told."""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["agents"]


def agents(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """List the agents: what they do, read, do on an alert, and which actions they can command.

    Example: lanebound agents --json
    """
    from lanebound.agents.cli.output import print_json, print_table
    from lanebound.agents.drivers import ABOUT

    if as_json:
        print_json([{"agent": name, **about._asdict()} for name, about in ABOUT.items()])
        return
    rows = ((name, *about) for name, about in ABOUT.items())
    print_table("Agents", ("agent", "does", "reads", "on an alert", "actions"), rows)
    typer.echo("Levels: protection levels. Actions: spaces that it can command, see 'lanebound envs'.")
    typer.echo("Figures: in a suite, such as 'careful: {agent: cbf, figures: {over: integrity_aware}}'.")
    typer.echo(_tuned())
    typer.echo("Your own: model.zip (Stable-Baselines3), .onnx, .npz, or package.module:callable; they may be given")
    typer.echo("wherever a name may: 'lanebound drive ID --agent NAME', 'lanebound benchmark SUITE --agents A,B'.")


def _tuned() -> str:
    """Where the constant margins were fitted to the place, and that elsewhere they were not."""
    from lanebound.agents.benchmark.untuned import tuned_places
    from lanebound.agents.cli.listing import LISTING

    names = {line["base"]: line["id"].removeprefix("lanebound/").removesuffix("-v0") for line in LISTING}
    fitted = ", ".join(f"{names.get(base, base)} under {sky} skies" for base, sky in tuned_places())
    return f"The margins of cautious were tuned for {fitted or 'no place'}; elsewhere they are untuned."
