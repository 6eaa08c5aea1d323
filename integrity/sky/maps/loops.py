"""Closed ways through a street graph: around blocks, over streets that are connected by allowed turns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.maps.city import in_buildings
from lanebound.integrity.sky.maps.graph import StreetEdge, StreetGraph, distance_m
from lanebound.integrity.sky.maps.lines import along
from lanebound.integrity.sky.maps.records import StreetMap

__all__ = ["FAR_M", "ClosedWay", "loops_of", "loops_via", "through_buildings"]

Array = NDArray[np.float64]
Place = tuple[float, float]

DRAWS = 200  # pairs of edges between which loops are sought
SAMPLE_M = 2.0
FAR_M = 200.0  # of a place from the street that a way by it takes; chosen, about a block
THROUGH = 0.02  # share of an open street inside of buildings, above which it is not driven; chosen


@dataclass(frozen=True)
class ClosedWay:
    """Edges of a graph, each of which follows the one before it, and the first the last."""

    edges: tuple[StreetEdge, ...]

    @property
    def length_m(self) -> float:
        """Length along the middles of the streets."""
        return sum(edge.length_m for edge in self.edges)


def through_buildings(streets: StreetMap, edges: Sequence[StreetEdge]) -> Array:
    """The share of each piece of a street inside of buildings, (E,); 0 for tunnels and passages, which have a roof."""
    places, owner = [np.zeros((0, 2))], [np.zeros(0, dtype=np.int64)]
    for k, edge in enumerate(edges):
        if not edge.way.covered:
            places.append(along(edge.points_en_m, SAMPLE_M))
            owner.append(np.full(len(places[-1]), k))
    which = np.concatenate(owner)
    hits = np.bincount(which, in_buildings(np.concatenate(places), streets), len(edges))
    return np.asarray(hits / np.maximum(np.bincount(which, minlength=len(edges)), 1))


def loops_of(streets: StreetMap, graph: StreetGraph) -> Iterator[ClosedWay]:
    """Loops between random pairs of edges, always the same, as they are found; none passes a junction twice."""
    edges = _driven(streets, graph)
    rng = named_generator(0, "loops")
    seen = set[frozenset[int]]()
    for _ in range(DRAWS if edges else 0):
        loop = _closed(graph, [int(k) for k in rng.choice(edges, 2)], frozenset(range(len(graph.edges))) - set(edges))
        if loop is not None and (key := frozenset(loop)) not in seen:
            seen.add(key)
            yield ClosedWay(tuple(graph.edges[k] for k in loop))


def loops_via(streets: StreetMap, graph: StreetGraph, places_en_m: Sequence[Place]) -> Iterator[ClosedWay]:
    """Loops by way of places (two or more), over the edges nearest to them, in either direction of each.

    There is none if an edge is farther than 200 m. The directions of n places are tried in 2^n combinations.
    """
    edges = _driven(streets, graph)
    barred = frozenset(range(len(graph.edges))) - set(edges)
    nearest = [graph.nearest(place, edges) for place in places_en_m] if edges else []
    pairs = zip(nearest, places_en_m, strict=True) if edges else ()
    if not edges or any(distance_m(graph.edges[k].points_en_m, np.array(place)) > FAR_M for k, place in pairs):
        return
    for stops in product(*(_both_directions(graph, k, edges) for k in nearest)):
        loop = _closed(graph, list(stops), barred)
        if loop is not None:
            yield ClosedWay(tuple(graph.edges[k] for k in loop))


def _driven(streets: StreetMap, graph: StreetGraph) -> list[int]:
    """Edges of the largest connected part that do not lead through buildings."""
    known = sorted(graph.connected)
    share = through_buildings(streets, [graph.edges[k] for k in known])
    return [k for k, inside in zip(known, share, strict=True) if inside <= THROUGH]


def _both_directions(graph: StreetGraph, k: int, among: Sequence[int]) -> list[int]:
    return [k, *(n for n in among if graph.edges[k].turns_back(graph.edges[n]))]


def _closed(graph: StreetGraph, stops: Sequence[int], barred: frozenset[int]) -> list[int] | None:
    """The shortest closed way over edges in order that passes no junction twice; None if there is none."""
    way = [stops[0]]
    for stop in (*stops[1:], stops[0]):
        passed = {graph.edges[k].end for k in way}
        part = graph.way(way[-1], stop, barred | {k for k, edge in enumerate(graph.edges) if edge.end in passed})
        if part is None or len(part) < 2:
            return None
        way += part[1:]
    return way[:-1]
