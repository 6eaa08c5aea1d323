"""The streets of a map as a graph: junctions, the pieces of streets between them, and the turns that are allowed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps.records import StreetMap, StreetWay

__all__ = ["StreetEdge", "StreetGraph", "distance_m"]

Array = NDArray[np.float64]

BARRED_M = 1e9  # length of an edge that is not used


@dataclass(frozen=True)
class StreetEdge:
    """A piece of a street between two junctions, in one direction of travel.

    Attributes
    ----------
    way : the street
    start, end : numbers of the points of its junctions
    points_en_m : (n, 2) of the middle of the carriageway, in the direction of travel
    lanes, lanes_against : in this direction, and in the other one of the same carriageway
    """

    way: StreetWay
    start: int
    end: int
    points_en_m: Array
    lanes: int
    lanes_against: int

    @cached_property
    def length_m(self) -> float:
        """Length along the middle."""
        return float(np.linalg.norm(np.diff(self.points_en_m, axis=0), axis=1).sum())

    def right_of_middle_m(self, lane: int, width_m: float) -> float:
        """How far the middle of a lane lies to the right of that of the carriageway; lane 0 is the rightmost one.

        width_m : of all lanes of the carriageway
        """
        return width_m * (0.5 * (self.lanes + self.lanes_against - 1) - lane)

    def turns_back(self, onward: StreetEdge) -> bool:
        """Whether another edge is this piece in the other direction."""
        return (
            onward.way is self.way
            and (onward.start, onward.end) == (self.end, self.start)
            and bool(np.array_equal(onward.points_en_m, self.points_en_m[::-1]))
        )


@dataclass(frozen=True)
class StreetGraph:
    """A street map as a graph.

    Attributes
    ----------
    edges : pieces of streets, each direction on its own
    turns : pairs of edges, of which the second may follow the first
    """

    edges: tuple[StreetEdge, ...]
    turns: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, streets: StreetMap) -> StreetGraph:
        """Cut the streets of a map at their common points; nobody turns back on the same piece."""
        uses = Counter(node for way in streets.streets for node in way.nodes)
        ends = {node for way in streets.streets for node in (way.nodes[0], way.nodes[-1])}
        edges: list[StreetEdge] = []
        for way in streets.streets:
            inner = [k for k in range(1, len(way.nodes) - 1) if uses[way.nodes[k]] > 1 or way.nodes[k] in ends]
            for a, b in zip([0, *inner], [*inner, len(way.nodes) - 1], strict=True):
                points, start, end = way.points_en_m[a : b + 1], way.nodes[a], way.nodes[b]
                if np.linalg.norm(np.diff(points, axis=0), axis=1).sum() <= 0.0:
                    continue
                if way.lanes:
                    edges.append(StreetEdge(way, start, end, points, way.lanes, way.lanes_back))
                if way.lanes_back:
                    edges.append(StreetEdge(way, end, start, points[::-1], way.lanes_back, way.lanes))
        return cls(tuple(edges), tuple(_turns(streets, edges)))

    def near(self, places_en_m: ArrayLike, reach_m: float) -> StreetGraph:
        """The part of the graph within a distance of the bounding box of places.  (n, 2) [m]."""
        places = np.asarray(places_en_m, dtype=np.float64)
        low, high = places.min(0) - reach_m, places.max(0) + reach_m
        kept = [
            k for k, edge in enumerate(self.edges) if ((edge.points_en_m >= low) & (edge.points_en_m <= high)).all()
        ]
        new = {k: n for n, k in enumerate(kept)}
        turns = ((new[a], new[b]) for a, b in self.turns if a in new and b in new)
        return StreetGraph(tuple(self.edges[k] for k in kept), tuple(turns))

    @cached_property
    def junctions(self) -> tuple[int, ...]:
        """Numbers of the points at which edges begin or end."""
        return tuple(sorted({node for edge in self.edges for node in (edge.start, edge.end)}))

    @cached_property
    def connected(self) -> frozenset[int]:
        """The largest set of edges of which each can be reached from each by allowed turns."""
        parts = _rustworkx().strongly_connected_components(self._turn_graph)
        longest = max(parts, key=lambda part: (sum(self.edges[k].length_m for k in part), -min(part)), default=())
        return frozenset(longest)

    @cached_property
    def _turn_graph(self) -> Any:
        """Edges as nodes, turns between them as edges that hold the number of the edge that is entered."""
        graph: Any = _rustworkx().PyDiGraph(multigraph=False)
        graph.add_nodes_from(range(len(self.edges)))
        graph.add_edges_from([(a, b, b) for a, b in self.turns])
        return graph

    def way(self, first: int, last: int, without: frozenset[int] = frozenset()) -> list[int] | None:
        """The shortest sequence of edges from one to another, both included; None if there is none.

        without : edges that are not used between them
        """
        cost = self._lengths_m.copy()
        cost[[k for k in without if k != last]] = BARRED_M
        found = _rustworkx().dijkstra_shortest_paths(self._turn_graph, first, last, weight_fn=lambda k: float(cost[k]))
        way = list(found[last]) if last in found else None
        return None if way is None or cost[way[1:]].max(initial=0.0) >= BARRED_M else way

    @cached_property
    def _lengths_m(self) -> Array:
        return np.array([edge.length_m for edge in self.edges])

    def nearest(self, place_en_m: ArrayLike, among: Sequence[int]) -> int:
        """The edge nearest to a place, of some.  (2,) [m]."""
        place = np.asarray(place_en_m, dtype=np.float64)
        return min(among, key=lambda k: (distance_m(self.edges[k].points_en_m, place), k))


def _rustworkx() -> Any:
    """The library of graphs."""
    try:
        import rustworkx
    except ImportError as error:
        raise InputError("a map of streets needs the extra maps: pip install 'lanebound[maps]'") from error
    return rustworkx


def distance_m(line: Array, place: Array) -> float:
    """Distance of a place (2,) from a line (n, 2) [m]."""
    along = np.diff(line, axis=0)
    share = ((place - line[:-1]) * along).sum(1) / np.maximum((along * along).sum(1), 1e-12)
    foot = line[:-1] + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(place - foot, axis=1).min())


def _turns(streets: StreetMap, edges: Sequence[StreetEdge]) -> list[tuple[int, int]]:
    """Pairs of edges, of which the second may follow the first."""
    leaving: dict[int, list[int]] = {}
    for k, edge in enumerate(edges):
        leaving.setdefault(edge.start, []).append(k)
    forbidden, only = set[tuple[int, int, int]](), dict[tuple[int, int], set[int]]()
    for r in streets.restrictions:
        if r.only:
            only.setdefault((r.before, r.node), set()).add(r.after)
        elif r.before != r.after:  # no_u_turn, which would bar straight on at a point within a street
            forbidden.add((r.before, r.node, r.after))
    out = []
    for k, edge in enumerate(edges):
        after = leaving.get(edge.end, [])
        wanted = only.get((edge.way.number, edge.end), set())
        if wanted & {edges[n].way.number for n in after}:  # else the street lies outside of the file
            after = [n for n in after if edges[n].way.number in wanted]
        out += [
            (k, n)
            for n in after
            if (edge.way.number, edge.end, edges[n].way.number) not in forbidden and not edge.turns_back(edges[n])
        ]
    return out
