"""The command line ``lanebound``. Each command lives in its own module and imports what is heavy when it runs."""

from __future__ import annotations

from typing import Annotated

import typer

from lanebound.agents.cli import assess, bench, benchmark, drive, learn, listing, plan, recorded, reproduce, street_map
from lanebound.agents.cli.advice import AdvisingGroup

EXAMPLES = """
[bold]Examples[/bold]

  lanebound config list                        list the presets

  lanebound config show NAME                   print one with units

  lanebound config show NAME --set key=value   the same with a change

  lanebound envs                               list the environments

  lanebound agents                             list the agents

  lanebound drive LaneKeeping --video a.mp4    drive an episode and film it

  lanebound play UrbanCanyon                   drive by keyboard

  lanebound benchmark quick --out out/demo     compare agents seed by seed

  lanebound train lane_keeping_ppo --out out   train a policy

  lanebound curves --out out/curves            draw learning curves of each id

  lanebound reproduce urban-drive --out out    reproduce the tables of S1

  lanebound assess bounding --out out/bounds   count errors above their levels

  lanebound monitors                           list integrity monitors

  lanebound replay data/berlin --out out/b     process a recorded drive

  lanebound record-sky data/berlin --out b.csv   write its sky for drive --sky b.csv

  lanebound map berlin.osm.pbf --out out/map   read a street map for UrbanCanyon

  lanebound plan generated:0 --from 35.664,139.789 --to 35.668,139.795   choose a route by its integrity

  lanebound fit-imu static.csv                 fit the warm-up error of accelerometers

  lanebound bench --json                       measure speed

Help of a command: [bold]lanebound COMMAND --help[/bold]
"""

app = typer.Typer(
    name="lanebound",
    cls=AdvisingGroup,
    help="Driving environments with GNSS integrity: protection levels, agents, benchmarks, recorded drives.",
    epilog=EXAMPLES,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
app.add_typer(listing.config, name="config")
app.add_typer(reproduce.app, name="reproduce")
app.add_typer(assess.app, name="assess")
app.add_typer(learn.tune, name="tune")
for command in (
    bench.bench, benchmark.benchmark, learn.train, learn.evaluate, learn.export, learn.study, learn.curves,
    drive.replay_episode, recorded.replay, recorded.rtk, recorded.fit_imu, recorded.record_sky, listing.envs,
    listing.agents, listing.monitors, assess.fit_errors, drive.drive, drive.play,
):  # fmt: skip
    app.command()(command)
app.command("map")(street_map.street_map)
app.command("plan")(plan.plan)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"lanebound {version('lanebound')}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Options of the program itself."""


def main() -> None:
    """Run the command line."""
    app(prog_name="lanebound")
