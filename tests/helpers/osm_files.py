"""Small OpenStreetMap files: nodes on a grid of metres about a place, ways and relations as text."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

from lanebound.integrity.sky.maps.records import MapFrame

PLACE = MapFrame(52.5, 13.4)
Ring = Sequence[tuple[float, float]]


def tagged(tags: Mapping[str, str]) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())


def node(number: int, east_m: float, north_m: float, **tags: str) -> str:
    lat, lon = PLACE.lat_lon_of([east_m, north_m])
    return f'<node id="{number}" version="1" lat="{lat:.9f}" lon="{lon:.9f}">{tagged(tags)}</node>'


def way(number: int, nodes: Sequence[int], tags: Mapping[str, str]) -> str:
    refs = "".join(f'<nd ref="{ref}"/>' for ref in nodes)
    return f'<way id="{number}" version="1">{refs}{tagged(tags)}</way>'


def relation(number: int, members: Sequence[tuple[str, int, str]], tags: Mapping[str, str]) -> str:
    inside = "".join(f'<member type="{kind}" ref="{ref}" role="{role}"/>' for kind, ref, role in members)
    return f'<relation id="{number}" version="1">{inside}{tagged(tags)}</relation>'


def osm(*parts: str) -> str:
    """A file of nodes, ways and relations, in the order that the format asks for."""
    root = ET.fromstring(f'<osm version="0.6">{"".join(parts)}</osm>')
    root[:] = sorted(root, key=lambda one: (("node", "way", "relation").index(one.tag), int(one.get("id", "0"))))
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}'


STREET = node(901, -5000.0, -5000.0) + node(902, -4990.0, -5000.0), way(900, [901, 902], {"highway": "residential"})
"""A street far from all else: a map needs one."""


def with_outlines(
    path: Path, rings: Sequence[Sequence[tuple[float, float]]], tags: Sequence[Mapping[str, str]]
) -> Path:
    """A file with closed ways of tags, and a street that puts its middle at 0, 0."""
    nodes, ways, number = [], [], 1
    for k, (ring, of_ring) in enumerate(zip(rings, tags, strict=True)):
        refs = list(range(number, number + len(ring)))
        nodes += [node(ref, *place) for ref, place in zip(refs, ring, strict=True)]
        ways.append(way(1000 + k, [*refs, refs[0]], of_ring))
        number += len(ring)
    path.write_text(osm(*nodes, node(901, -100.0, 0.0), node(902, 100.0, 0.0), *ways, STREET[1]), encoding="utf-8")
    return path


def square(east_m: float, north_m: float, side_m: float) -> list[tuple[float, float]]:
    """Corners of a square from its lower left one."""
    return [(east_m + side_m * i, north_m + side_m * j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]


def blocks(path: Path, columns: int = 3, rows: int = 2, side_m: float = 120.0, streets: str = "", **tags: str) -> Path:
    """A file with a grid of streets of two directions: ways 1.. along the rows, then 101.. along the columns."""
    ref = {(i, j): 1 + i + columns * j for i in range(columns) for j in range(rows)}
    nodes = [node(n, side_m * i, side_m * j) for (i, j), n in ref.items()]
    named = {"highway": "residential", **tags}
    ways = [way(1 + j, [ref[i, j] for i in range(columns)], named) for j in range(rows)]
    ways += [way(101 + i, [ref[i, j] for j in range(rows)], named) for i in range(columns)]
    path.write_text(osm(*nodes, *ways, streets), encoding="utf-8")
    return path
