"""``lanebound map``: a street map of OpenStreetMap, before it is driven."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lanebound.agents.cli.options import AsJson
from lanebound.agents.cli.output import print_json, print_table, resumable, wait_for

MAP, PICTURE = "map.json", "map.png"


def street_map(
    name: Annotated[
        str, typer.Argument(metavar="MAP", help="FILE.osm, .osm.gz or .osm.pbf, or a packaged map: berlin_kreuzberg.")
    ],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for {PICTURE} and {MAP}.")] = None,
    as_json: AsJson = False,
) -> None:
    """Read a street map: what it holds, what is assumed and left out, and its closed ways, which UrbanCanyon drives.

    Needs the extra maps (pip install 'lanebound[maps]').

    Example: lanebound map berlin_kreuzberg --out out/map
    """
    from lanebound.agents.serialization import to_json_text
    from lanebound.agents.street_map import about_map, draw_map
    from lanebound.integrity.sky.maps.files import map_of

    with resumable(lambda: "nothing is kept"):
        found, roads = wait_for(lambda: about_map(name))
        written = []
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            (out / MAP).write_text(to_json_text(found), encoding="utf-8")
            written = [draw_map(map_of(name), roads, out / PICTURE), out / MAP]
    if as_json:
        print_json(found)
        return
    _print(found)
    for path in written:
        typer.echo(str(path))


def _print(found: dict[str, Any]) -> None:
    rows = [("middle", f"{found['lat_deg']:.5f}, {found['lon_deg']:.5f}"), *found["found"].items()]
    rows += [("solids of buildings", found["solids"]), ("median height m", found["height_median_m"])]
    rows += [("largest height m", found["height_max_m"]), ("junctions", found["junctions"])]
    rows += [("pieces of streets, by direction", found["pieces"]), ("connected ones", found["connected"])]
    rows += [("pieces that touch a building", found["in_buildings"])]
    print_table(f"Street map {found['map']}", ("", "value"), rows)
    for title, part in (("Assumed", "assumed"), ("Left out", "skipped")):
        if found[part]:
            print_table(title, ("", "objects"), found[part].items())
    ways = [(k, *way.values()) for k, way in enumerate(found["ways"])]
    print_table("Closed ways", ("world.route", "length m", "lanes", "least limit m/s", "highest limit m/s"), ways)
