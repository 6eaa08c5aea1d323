"""``lanebound plan``: a journey through a street map, chosen by the integrity that it will have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lanebound.agents.cli.options import AsJson
from lanebound.agents.cli.output import print_json, print_table, resumable, wait_for

if TYPE_CHECKING:
    from lanebound.integrity.sky.journeys.planner import Route

PLAN, PICTURE = "plan.json", "plan.png"


def plan(
    name: Annotated[
        str, typer.Argument(metavar="MAP", help="FILE.osm, .osm.gz or .osm.pbf, a packaged map, or generated:SEED.")
    ],
    origin: Annotated[str, typer.Option("--from", metavar="LAT,LON", help="Where the journey begins, in degrees.")],
    destination: Annotated[str, typer.Option("--to", metavar="LAT,LON", help="Where it ends, in degrees.")],
    depart: Annotated[float, typer.Option(metavar="HOUR", help="Hour of departure, GPS time (UTC).")] = 12.0,
    weight: Annotated[
        float, typer.Option(min=0.0, help="Seconds of time that a second without a usable position counts as.")
    ] = 3.0,
    most_unusable: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share without a position of the chance-constrained route.")
    ] = 0.25,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for {PICTURE} and {PLAN}.")] = None,
    as_json: AsJson = False,
) -> None:
    """Plan a journey before it begins: routes by time, length and the time without a usable position (S2 section 3).

    Needs the extra maps: pip install 'lanebound\\[maps]'.

    Example: lanebound plan generated:0 --from 35.6640,139.7890 --to 35.6685,139.7950 --out out/plan
    """
    from lanebound.agents.journey_plan import draw_journey, place_named, plan_journey
    from lanebound.agents.serialization import to_json_text

    with resumable(lambda: "nothing is kept"):
        ends = place_named(origin, "--from"), place_named(destination, "--to")
        journey = wait_for(lambda: plan_journey(name, *ends, depart, weight, most_unusable))
        found = {"map": name} | journey.to_dict()
        written = []
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            (out / PLAN).write_text(to_json_text(found), encoding="utf-8")
            written = [draw_journey(journey, out / PICTURE, name), out / PLAN]
    if as_json:
        print_json(found)
        return
    heads = ("route", "time s", "length m", "unusable s", "share", "PL_CT median m", "90 % m", "energy kWh")
    rows = [
        (
            title, f"{r.time_s:.0f}", f"{r.length_m:.0f}", f"{r.unusable_s:.1f}", f"{r.unusable_share:.2f}",
            *map(_level, r.level_m), f"{r.energy_kwh:.3f}",
        )
        for title, r in _distinct(journey.routes).items()
    ]  # fmt: skip
    print_table(f"Journey through {name}, departure at {depart:g} h", heads, rows)
    hours = [(f"{hour} h", f"{r.time_s:.0f}", f"{r.unusable_s:.1f}") for hour, r in journey.by_hour.items()]
    print_table("The integrity-aware route by hour of departure", ("departure", "time s", "unusable s"), hours)
    typer.echo(f"Best hour of departure: {journey.best_hour} h")
    for path in written:
        typer.echo(str(path))


def _distinct(routes: Mapping[str, Route]) -> dict[str, Route]:
    """The routes without those that are another one again, whose names the first one takes."""
    found: dict[tuple[int, ...], list[str]] = {}
    for title, route in routes.items():
        found.setdefault(route.edges, []).append(title)
    return {", ".join(titles): routes[titles[0]] for titles in found.values()}


def _level(level_m: float) -> str:
    from lanebound.integrity.sky.availability import NO_LEVEL_M

    return f"{level_m:.2f}" if level_m < NO_LEVEL_M else "none"
