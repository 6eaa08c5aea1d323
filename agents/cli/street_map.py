"""``lanebound map``: a street map of OpenStreetMap, before it is driven, or a city model."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from lanebound.agents.cli.options import AsJson
from lanebound.agents.cli.output import print_json, print_table, resumable, wait_for

MAP, PICTURE = "map.json", "map.png"


def street_map(
    name: Annotated[
        str,
        typer.Argument(
            metavar="MAP",
            help="FILE.osm, .osm.gz or .osm.pbf, a packaged map: berlin_kreuzberg, or a CityGML or CityJSON file.",
        ),
    ],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for {PICTURE} and {MAP}.")] = None,
    as_json: AsJson = False,
) -> None:
    """Read a street map: what it holds, what is assumed and left out, and its closed ways, which UrbanCanyon drives.

    Street maps need the extra maps: pip install 'lanebound\\[maps]'. Of a city model the buildings are shown.

    Example: lanebound map berlin_kreuzberg --out out/map
    """
    from lanebound.agents.serialization import to_json_text
    from lanebound.agents.street_map import about_city_model, about_map, draw_city_model, draw_map
    from lanebound.integrity.sky.maps.city_models import is_city_model
    from lanebound.integrity.sky.maps.files import map_of

    draw: Callable[[Path], Path]
    with resumable(lambda: "nothing is kept"):
        if is_city_model(name):
            found, model = wait_for(lambda: about_city_model(name))
            draw = partial(draw_city_model, model)
        else:
            found, roads = wait_for(lambda: about_map(name))
            draw = partial(draw_map, map_of(name), roads)
        written = []
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            (out / MAP).write_text(to_json_text(found), encoding="utf-8")
            written = [draw(out / PICTURE), out / MAP]
    if as_json:
        print_json(found)
        return
    _print(found)
    for path in written:
        typer.echo(str(path))


def _print(found: dict[str, Any]) -> None:
    street = "ways" in found
    middle = "not known" if found["lat_deg"] is None else f"{found['lat_deg']:.5f}, {found['lon_deg']:.5f}"
    rows = [("middle", middle), *found["found"].items()]
    rows += [("solids of buildings", found["solids"])] if street else []
    rows += [("median height m", found["height_median_m"]), ("largest height m", found["height_max_m"])]
    if street:
        rows += [("junctions", found["junctions"]), ("pieces of streets, by direction", found["pieces"])]
        rows += [("connected ones", found["connected"]), ("pieces that touch a building", found["in_buildings"])]
    print_table(f"{'Street map' if street else 'City model'} {found['map']}", ("", "value"), rows)
    for title, part in (("Assumed", "assumed"), ("Left out", "skipped")):
        if found.get(part):
            print_table(title, ("", "objects"), found[part].items())
    if street:
        ways = [(k, *way.values()) for k, way in enumerate(found["ways"])]
        print_table("Closed ways", ("world.route", "length m", "lanes", "least limit m/s", "highest limit m/s"), ways)
