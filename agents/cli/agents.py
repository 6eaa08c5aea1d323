"""``lanebound agents``: the agents, and what each of them does with its observations."""

from __future__ import annotations

import typer

from lanebound.agents.cli.options import AsJson

__all__ = ["agents"]


def agents(as_json: AsJson = False) -> None:
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
    typer.echo("Your own: model.zip (Stable-Baselines3), .onnx, .npz, or package.module:callable in place of a name:")
    typer.echo("'lanebound drive ID --agent NAME', 'lanebound benchmark SUITE --agents A,B'.")


def _tuned() -> str:
    """Environments and skies for which the constant margins were tuned."""
    from lanebound.agents.benchmark.untuned import tuned_places
    from lanebound.agents.cli.static import static_table

    names = {
        line["base"]: line["id"].removeprefix("lanebound/").removesuffix("-v0")
        for line in static_table()["environments"]
    }
    fitted = ", ".join(f"{names.get(base, base)} under {sky} skies" for base, sky in tuned_places())
    return f"The margins of cautious were tuned for {fitted or 'no place'}; elsewhere they are untuned."
