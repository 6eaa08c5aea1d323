"""Streets as a graph, and closed ways through it: directions, restrictions of turns, and no street through a house."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from osm_files import blocks, node, relation, way

from lanebound.integrity.sky.maps.files import map_of
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.loops import ClosedWay, loops_of, loops_via, through_buildings
from lanebound.integrity.sky.maps.osm import read_osm


def graph_of(tmp_path: Path, **options: str) -> StreetGraph:
    return StreetGraph.of(read_osm(blocks(tmp_path / "map.osm", **options)))


def followed(graph: StreetGraph) -> set[tuple[int, int, int]]:
    """Turns as start, middle, end of two edges of a grid without double edges."""
    return {(graph.edges[a].start, graph.edges[a].end, graph.edges[b].end) for a, b in graph.turns}


def test_a_grid_of_blocks(tmp_path: Path) -> None:
    graph = graph_of(tmp_path)  # 3 x 2 junctions: 1 2 3 below 4 5 6
    assert graph.junctions == (1, 2, 3, 4, 5, 6)
    assert {(edge.start, edge.end) for edge in graph.edges} == {
        pair for a, b in ((1, 2), (2, 3), (4, 5), (5, 6), (1, 4), (2, 5), (3, 6)) for pair in ((a, b), (b, a))
    }
    assert all(edge.length_m == pytest.approx(120.0, abs=0.05) for edge in graph.edges)
    assert (1, 2, 5) in followed(graph)
    assert (1, 2, 1) not in followed(graph)
    assert len(graph.connected) == len(graph.edges)


def test_streets_of_one_direction(tmp_path: Path) -> None:
    graph = graph_of(tmp_path, oneway="yes")
    assert {(edge.start, edge.end) for edge in graph.edges} == {(1, 2), (2, 3), (4, 5), (5, 6), (1, 4), (2, 5), (3, 6)}
    assert len(graph.connected) == 1  # nothing leads back
    back = graph_of(tmp_path, oneway="-1", lanes="2")
    assert {(edge.start, edge.end, edge.lanes, edge.lanes_against) for edge in back.edges} >= {
        (2, 1, 2, 0),
        (5, 2, 2, 0),
    }


def test_restrictions_forbid_turns(tmp_path: Path) -> None:
    members = [("way", 1, "from"), ("node", 2, "via"), ("way", 102, "to")]
    no = relation(9, members, {"type": "restriction", "restriction": "no_left_turn"})
    assert followed(graph_of(tmp_path)) - followed(graph_of(tmp_path, streets=no)) == {(1, 2, 5), (3, 2, 5)}
    only = relation(9, members, {"type": "restriction", "restriction": "only_left_turn"})
    assert followed(graph_of(tmp_path)) - followed(graph_of(tmp_path, streets=only)) == {(1, 2, 3), (3, 2, 1)}


def test_turning_back_is_forbidden_and_not_straight_on_at_a_point_within_a_street(tmp_path: Path) -> None:
    members = [("way", 1, "from"), ("node", 2, "via"), ("way", 1, "to")]
    no = relation(9, members, {"type": "restriction", "restriction": "no_u_turn"})
    assert followed(graph_of(tmp_path, streets=no)) == followed(graph_of(tmp_path))


def test_the_shortest_way(tmp_path: Path) -> None:
    graph = graph_of(tmp_path)
    number = {(edge.start, edge.end): k for k, edge in enumerate(graph.edges)}
    found = graph.way(number[1, 2], number[5, 4])
    assert found == [number[1, 2], number[2, 5], number[5, 4]]
    around = graph.way(number[1, 2], number[5, 4], frozenset({number[2, 5]}))
    assert around == [number[p] for p in ((1, 2), (2, 3), (3, 6), (6, 5), (5, 4))]
    assert graph.way(number[1, 2], number[5, 4], frozenset({number[2, 5], number[2, 3]})) is None


def test_the_part_near_a_place(tmp_path: Path) -> None:
    streets = read_osm(blocks(tmp_path / "map.osm", columns=6))
    graph = StreetGraph.of(streets)
    left = {n: p for street in streets.streets for n, p in zip(street.nodes, street.points_en_m, strict=True)}[1]
    part = graph.near([left], 250.0)
    assert part.junctions == (1, 2, 3, 7, 8, 9)
    assert {round(loop.length_m) for loop in loops_of(streets, part)} == {480, 720}
    nothing = graph.near([left + 9000.0], 250.0)
    assert (nothing.edges, nothing.connected, list(loops_of(streets, nothing))) == ((), frozenset(), [])


def closed(loop: ClosedWay) -> bool:
    edges = loop.edges
    return all(a.end == b.start and not a.turns_back(b) for a, b in pairwise((*edges, edges[0])))


def test_closed_ways_pass_no_junction_twice(tmp_path: Path) -> None:
    streets = read_osm(blocks(tmp_path / "map.osm"))
    graph = StreetGraph.of(streets)
    loops = list(loops_of(streets, graph))
    assert {round(loop.length_m) for loop in loops} == {480, 720}  # each block, and both
    assert len(loops) == 6  # in both directions
    assert loops == list(loops_of(streets, graph))
    for loop in loops:
        assert closed(loop)
        assert len({edge.end for edge in loop.edges}) == len(loop.edges)


def test_closed_ways_by_places(tmp_path: Path) -> None:
    streets = read_osm(blocks(tmp_path / "map.osm"))
    graph = StreetGraph.of(streets)
    left, right = (streets.frame.en_of(*place) for place in (end(streets, 1, 4), end(streets, 3, 6)))
    loops = list(loops_via(streets, graph, [tuple(left), tuple(right)]))
    assert loops
    assert all(closed(loop) and round(loop.length_m) == 720 for loop in loops)
    assert not list(loops_via(streets, graph, [tuple(left), tuple(left)]))


def end(streets: object, a: int, b: int) -> np.ndarray:
    """Latitude and longitude of the middle between two junctions."""
    at = {n: p for street in streets.streets for n, p in zip(street.nodes, street.points_en_m, strict=True)}
    return streets.frame.lat_lon_of(0.5 * (at[a] + at[b]))


def test_streets_through_buildings_are_not_driven(tmp_path: Path) -> None:
    across = [(100, 50.0), (140, 50.0), (140, 70.0), (100, 70.0)]  # over the street from 2 to 5
    nodes = "".join(node(50 + k, *place) for k, place in enumerate(across))
    house = nodes + way(200, [50, 51, 52, 53, 50], {"building": "yes", "height": "12"})
    streets = read_osm(blocks(tmp_path / "map.osm", streets=house))
    graph = StreetGraph.of(streets)
    share = through_buildings(streets, graph.edges)
    for edge, part in zip(graph.edges, share, strict=True):
        assert part == (pytest.approx(20.0 / 120.0, abs=0.02) if {edge.start, edge.end} == {2, 5} else 0.0)
    assert {round(loop.length_m) for loop in loops_of(streets, graph)} == {720}
    opened = read_osm(blocks(tmp_path / "map.osm", streets=house, tunnel="building_passage"))
    assert not through_buildings(opened, StreetGraph.of(opened).edges).any()


def test_the_packaged_map_has_no_street_through_a_building() -> None:
    streets = map_of("berlin_kreuzberg")
    graph = StreetGraph.of(streets)
    assert through_buildings(streets, graph.edges).max() == 0.0
    assert len(graph.connected) > 40
    assert all(closed(loop) for loop in loops_of(streets, graph))
