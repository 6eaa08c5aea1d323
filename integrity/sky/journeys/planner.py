"""The choice of a route by time, length and the time without a usable position (S2 section 3).

The time without a usable position along a street depends on the gap with which it is entered: how long RTK has not been
likely. So a search works on pairs of a street and a class of gaps; what is said of a route is computed along it with
its true gaps.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_in_range
from lanebound.integrity.sky.availability import LONGEST_GAP_S, WORST_PDOP, AvailabilityModel, gaps_along, likely
from lanebound.integrity.sky.journeys.streets import ACCELERATION_MPS2, BRAKING_MPS2, EdgeStations, turn_s
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.prediction import StreetPrediction

__all__ = ["Planner", "Route", "StreetPlace", "StreetsAhead", "energy_kwh", "place_on"]

Array = NDArray[np.float64]

# Of classes of gaps. A gap is of the nearest one, so that steps are at most twice the time of short streets, up to
# 80 s, by when the probability hardly falls any further; chosen.
GAPS_S = (*np.arange(0.0, 20.0, 1.0).tolist(), *np.arange(20.0, 81.0, 2.0).tolist(), 120.0, 200.0, LONGEST_GAP_S)
WEIGHT = 3.0  # seconds of time that a second without a usable position counts as; chosen
MOST_UNUSABLE = 0.25  # share of the time; chosen: of training cities all streets have 0.5, the best ones 0.12
STEP_S = 0.25  # by which routes of a Pareto front differ at least in the time without a position; chosen
FARTHEST_M = 200.0  # of a place from the nearest street
LEVEL_SHARES = 0.5, 0.9
# A car of 1.5 t: rolling resistance 0.01, drag area 0.65 m2, air of 1.2 kg/m3, driveline 0.9; chosen, usual values
MASS_KG, ROLLING, DRAG_M2, AIR_KGPM3, DRIVELINE, GRAVITY = 1500.0, 0.010, 0.65, 1.2, 0.9, 9.81
JOULES = 3.6e6  # of a kWh


def energy_kwh(length_m: ArrayLike, speed_mps: ArrayLike) -> Array:
    """Energy to drive a length at a constant speed against rolling resistance and drag, without stops.  (...,)."""
    speed = np.asarray(speed_mps, dtype=np.float64)
    force = MASS_KG * GRAVITY * ROLLING + 0.5 * AIR_KGPM3 * DRAG_M2 * speed**2
    return np.asarray(np.asarray(length_m) * force / (DRIVELINE * JOULES))


class StreetPlace(NamedTuple):
    """Where a journey begins or ends: the pieces of the street there, one for each direction, and the share of each."""

    edges: tuple[int, ...]
    shares: tuple[float, ...]


def place_on(graph: StreetGraph, place_en_m: ArrayLike, name: str = "place") -> StreetPlace:
    """The nearest place on a street of the connected part of a map, (2,) [m].

    Raises
    ------
    InputError
        It is farther than 200 m from all of them: outside of the map.
    """
    at = np.asarray(place_en_m, dtype=np.float64)
    known = sorted(graph.connected)
    nearest = graph.nearest(at, known)
    share, away = _foot(graph.edges[nearest].points_en_m, at)
    if away > FARTHEST_M:
        raise InputError(
            f"{name} must lie within {FARTHEST_M:g} m of the connected streets of the map, got {away:.0f} m: it is "
            "outside of the map"
        )
    both = [nearest, *(k for k in known if graph.edges[nearest].turns_back(graph.edges[k]))]
    return StreetPlace(tuple(both), (share, *(1.0 - share for _ in both[1:])))


def _foot(line: Array, place: Array) -> tuple[float, float]:
    """Share of a line's length at the point nearest to a place, and the distance from it [m]."""
    along = np.diff(line, axis=0)
    length = np.linalg.norm(along, axis=1)
    part = np.clip(((place - line[:-1]) * along).sum(1) / np.maximum(length**2, 1e-12), 0.0, 1.0)
    away = np.linalg.norm(place - line[:-1] - part[:, None] * along, axis=1)
    k = int(np.argmin(away))
    return float((length[:k].sum() + part[k] * length[k]) / max(float(length.sum()), 1e-9)), float(away[k])


@dataclass(frozen=True)
class Route:
    """A route and what is predicted of it.

    Attributes
    ----------
    edges : in order
    begin, end : shares of the first edge where it begins and of the last one where it ends
    length_m
    time_s : at the speed limits, with starting, turning and stopping
    unusable_s : expected time without a usable position
    level_m : (2,) median and 90 % quantile of PL_CT over its time
    energy_kwh : :func:`energy_kwh`
    """

    edges: tuple[int, ...]
    begin: float
    end: float
    length_m: float
    time_s: float
    unusable_s: float
    level_m: tuple[float, float]
    energy_kwh: float

    @property
    def unusable_share(self) -> float:
        """Expected share of the time without a usable position."""
        return self.unusable_s / self.time_s


@dataclass(frozen=True)
class StreetsAhead:
    """What is predicted of all streets at one time, by the gap with which a street is entered.

    Attributes
    ----------
    graph, stations, model
    satellites, good : (N,) of stations; whether RTK is likely there
    """

    graph: StreetGraph
    stations: EdgeStations
    model: AvailabilityModel
    satellites: Array
    good: NDArray[np.bool_]

    @classmethod
    def of(
        cls, graph: StreetGraph, stations: EdgeStations, model: AvailabilityModel, seen: StreetPrediction
    ) -> StreetsAhead:
        """The streets with these satellites at their stations."""
        number = seen.satellites.astype(np.float64)
        return cls(graph, stations, model, number, likely(model.fix, number, np.minimum(seen.pdop, WORST_PDOP)))

    def probability(self, rows: NDArray[np.int64], begin_s: float) -> Array:
        """Probability of a usable position at stations in order of travel, entered with a gap.  (n,) -> (n,)."""
        part_s = self.stations.part_s[rows]
        gap = gaps_along(self.good[rows], np.cumsum(part_s) - 0.5 * part_s, begin_s)
        return self.model.probability(self.satellites[rows], gap)

    def exit_gap_s(self, rows: NDArray[np.int64], begin_s: float) -> float:
        """Gap after stations in order of travel."""
        left = np.cumsum(self.stations.part_s[rows][::-1])[::-1]
        found = np.flatnonzero(self.good[rows])
        total = float(left[0]) if rows.size else 0.0
        return float(left[found[-1]] - 0.5 * self.stations.part_s[rows[found[-1]]]) if found.size else begin_s + total

    def described(self, edges: tuple[int, ...], begin: float, end: float) -> Route:
        """A route with what is predicted of it, along its own gaps, from a known place."""
        rows, part_s = self.stations.of_way(self.graph, edges, begin, end)
        if not rows.size:  # shorter than a part of a street
            rows = self.stations.first[list(edges[:1])]
            part_s = self.stations.part_s[rows]
        shares = [(begin if i == 0 else 0.0, end if i == len(edges) - 1 else 1.0) for i in range(len(edges))]
        streets = [self.graph.edges[k] for k in edges]
        length = np.array([(b - a) * one.length_m for (a, b), one in zip(shares, streets, strict=True)])
        speed = np.array([one.way.speed_limit_mps for one in streets])
        gap = gaps_along(self.good[rows], np.cumsum(part_s) - 0.5 * part_s, 0.0)
        chance = self.model.probability(self.satellites[rows], gap)
        weight = part_s / part_s.sum()
        turns = sum(turn_s(a, b) for a, b in pairwise(streets))
        stops = 0.5 * speed[0] / ACCELERATION_MPS2 + 0.5 * speed[-1] / BRAKING_MPS2
        time_s = float((length / speed).sum() + turns + stops)
        return Route(
            edges, begin, end, float(length.sum()), time_s, time_s * float(((1.0 - chance) * weight).sum()),
            _levels(self.model.quantiles(chance), weight), float(energy_kwh(length, speed).sum()),
        )  # fmt: skip

    def described_as(self, route: Route) -> Route:
        """The same way with what is predicted of it here."""
        return self.described(route.edges, route.begin, route.end)

    @cached_property
    def by_class(self) -> tuple[Array, NDArray[np.int64]]:
        """Expected time without a position [s] and class of the gap at the end, by edge and class, (E, G) each."""
        first, part_s = self.stations.first, self.stations.part_s
        gaps, ends = [], []
        for begin_s in GAPS_S:
            for k in range(len(self.graph.edges)):
                rows = np.arange(first[k], first[k + 1])
                own = part_s[rows]
                gaps.append(gaps_along(self.good[rows], np.cumsum(own) - 0.5 * own, begin_s))
                ends.append(_class(self.exit_gap_s(rows, begin_s)))
        chance = self.model.probability(np.tile(self.satellites, len(GAPS_S)), np.concatenate(gaps))
        lost = ((1.0 - chance) * np.tile(part_s, len(GAPS_S))).reshape(len(GAPS_S), -1)
        return np.add.reduceat(lost, first[:-1], axis=1).T, np.array(ends).reshape(len(GAPS_S), -1).T

    @cached_property
    def edge_probability(self) -> Array:
        """Probability of a usable position on each edge, entered with RTK, (E,)."""
        time_s = np.add.reduceat(self.stations.part_s, self.stations.first[:-1])
        return 1.0 - self.by_class[0][:, 0] / time_s


def _class(gap_s: float) -> int:
    """The class of a gap, the nearest one."""
    return int(np.argmin(np.abs(np.array(GAPS_S) - gap_s)))


class _Arc(NamedTuple):
    """A step of the search: where it leads, and its criteria."""

    node: int
    length_m: float
    time_s: float
    unusable_s: float


class Planner:
    """Routes between two places at one time.

    Parameters
    ----------
    ahead : what is predicted of the streets
    origin, destination : places

    Raises
    ------
    InputError
        They are the same place, or no way leads from one to the other.
    """

    def __init__(self, ahead: StreetsAhead, origin: StreetPlace, destination: StreetPlace) -> None:
        self.ahead, self.origin, self.destination = ahead, origin, destination
        if _same(ahead.graph, origin, destination):
            raise InputError("--from and --to must differ, got the same place of a street: choose two places")
        self._arcs = self._search_graph()
        if self._search((0.0, 1.0, 0.0)) is None:
            raise InputError("a way must lead from --from to --to, got none: choose places that streets connect")

    # The graph of the search: nodes are pairs of an edge and a class, the origins after them, and the end

    def _search_graph(self) -> list[list[_Arc]]:
        edges, classes = self.ahead.graph.edges, len(GAPS_S)
        lost, leaves = self.ahead.by_class
        length = np.array([edge.length_m for edge in edges])
        time_s = np.add.reduceat(self.ahead.stations.part_s, self.ahead.stations.first[:-1])
        count = len(edges) * classes
        arcs: list[list[_Arc]] = [[] for _ in range(count + len(self.origin.edges) + 2)]
        goals = dict(zip(self.destination.edges, self.destination.shares, strict=True))
        starts: list[tuple[int, int, float]] = []  # a node, the edge that it leaves, the gap there
        onward: dict[int, list[tuple[int, float]]] = {}
        for a, b in self.ahead.graph.turns:
            onward.setdefault(a, []).append((b, turn_s(edges[a], edges[b])))
        first = self.ahead.satellites[self.ahead.stations.first[:-1]]
        risk = 1.0 - np.stack([self.ahead.model.probability(first, np.full(first.size, gap)) for gap in GAPS_S], 1)
        self._source, self._end = count + len(self.origin.edges), count + len(self.origin.edges) + 1
        for i, (edge, share) in enumerate(zip(self.origin.edges, self.origin.shares, strict=True)):
            arcs[self._source].append(_Arc(count + i, *self._part(edge, share, 1.0, 0.0)))
            starts.append((count + i, edge, self.ahead.exit_gap_s(self.ahead.stations.rows(edge, share, 1.0), 0.0)))
            if edge in goals and goals[edge] > share:
                arcs[self._source].append(_Arc(self._end, *self._part(edge, share, goals[edge], 0.0)))
        leaving = [(k * classes + g, k, int(leaves[k, g])) for k in range(len(edges)) for g in range(classes)]
        for node, edge, into in [*((n, k, _class(gap)) for n, k, gap in starts), *leaving]:
            for b, turn in onward.get(edge, ()):
                more = turn * float(risk[b, into])
                whole = float(length[b]), turn + float(time_s[b]), more + float(lost[b, into])
                arcs[node].append(_Arc(b * classes + into, *whole))
                if b in goals:
                    along_m, along_s, lost_s = self._part(b, 0.0, goals[b], GAPS_S[into])
                    arcs[node].append(_Arc(self._end, along_m, turn + along_s, more + lost_s))
        return arcs

    def _part(self, edge: int, begin: float, end: float, gap_s: float) -> tuple[float, float, float]:
        """Criteria of a part of an edge."""
        rows = self.ahead.stations.rows(edge, begin, end)
        street = self.ahead.graph.edges[edge]
        length = (end - begin) * street.length_m
        time_s = length / street.way.speed_limit_mps
        lost = 1.0 - self.ahead.probability(rows, gap_s) if rows.size else np.zeros(1)
        return length, time_s, time_s * float(lost.mean())

    @cached_property
    def _graph(self) -> Any:
        import rustworkx

        graph: Any = rustworkx.PyDiGraph()
        graph.add_nodes_from(range(len(self._arcs)))
        graph.add_edges_from([(a, arc.node, arc) for a, arcs in enumerate(self._arcs) for arc in arcs])
        return graph

    def _search(self, weights: tuple[float, float, float]) -> tuple[int, ...] | None:
        """The nodes of the way with the least weighted sum of length, time and expected time without a position."""
        import rustworkx

        def cost(arc: _Arc) -> float:
            return weights[0] * arc.length_m + weights[1] * arc.time_s + weights[2] * arc.unusable_s

        found = rustworkx.dijkstra_shortest_paths(self._graph, self._source, target=self._end, weight_fn=cost)
        return tuple(found[self._end]) if self._end in found else None

    # Routes

    def shortest(self) -> Route:
        """The route of least length."""
        return self._best((1.0, 0.0, 0.0))

    def fastest(self) -> Route:
        """The route of least time."""
        return self._best((0.0, 1.0, 0.0))

    def weighted(self, weight: float = WEIGHT) -> Route:
        """The route of least time, where an expected second without a usable position counts ``weight`` more."""
        require_in_range("weight", weight, 0.0, 1e6)
        return self._best((0.0, 1.0, weight))

    def bounded(self, most_unusable: float = MOST_UNUSABLE) -> Route:
        """The fastest route of the front whose expected share without a usable position is bounded.

        If there is none, that of the least share. Routes beside the front are no choice: they have a smaller share only
        because they take longer.
        """
        require_in_range("most_unusable", most_unusable, 0.0, 1.0)
        front = self.front()
        good = [route for route in front if route.unusable_share <= most_unusable]
        return min(good, key=lambda route: route.time_s) if good else min(front, key=lambda r: r.unusable_share)

    def front(self) -> list[Route]:
        """Routes of which none is both slower and expected without a position for longer than another, by time."""
        found = [self._route(nodes) for nodes in self._pareto()]
        kept: list[Route] = []
        for route in sorted(found, key=lambda one: (one.time_s, one.unusable_s, one.edges)):
            if not kept or route.unusable_s < kept[-1].unusable_s - 1e-9:
                kept.append(route)
        return kept

    def _best(self, weights: tuple[float, float, float]) -> Route:
        nodes = self._search(weights)
        assert nodes is not None
        return self._route(nodes)

    def _pareto(self) -> Iterator[tuple[int, ...]]:
        """Ways by label setting over time and expected time without a position, in steps of 0.25 s."""
        labels: list[list[float]] = [[] for _ in self._arcs]  # of settled labels, which arrive by time
        queue: list[tuple[float, float, int, tuple[int, ...]]] = [(0.0, 0.0, self._source, (self._source,))]
        while queue:
            time_s, lost, node, way = heapq.heappop(queue)
            settled = labels[node]
            if settled and lost > settled[-1] - STEP_S:
                continue
            settled.append(lost)
            if node == self._end:
                yield way
                continue
            for arc in self._arcs[node]:
                after = labels[arc.node]
                if not (after and lost + arc.unusable_s > after[-1] - STEP_S):
                    heapq.heappush(queue, (time_s + arc.time_s, lost + arc.unusable_s, arc.node, (*way, arc.node)))

    def _route(self, nodes: Sequence[int]) -> Route:
        """The route of the nodes of a search, which begin at the source and end at the end."""
        classes, count = len(GAPS_S), len(self.ahead.graph.edges) * len(GAPS_S)
        inner = nodes[1:-1]
        if not inner:  # along one edge
            goals = dict(zip(self.destination.edges, self.destination.shares, strict=True))
            edge, share = next(
                (e, s)
                for e, s in zip(self.origin.edges, self.origin.shares, strict=True)
                if e in goals and goals[e] > s
            )
            return self.ahead.described((edge,), share, goals[edge])
        begin = inner[0] - count
        edges = [self.origin.edges[begin], *(node // classes for node in inner[1:])]
        last = self._last(edges[-1])
        return self.ahead.described((*edges, last[0]), self.origin.shares[begin], last[1])

    def _last(self, before: int) -> tuple[int, float]:
        """The edge of the destination that follows another, and its share."""
        onward = {b for a, b in self.ahead.graph.turns if a == before}
        return next((e, s) for e, s in zip(self.destination.edges, self.destination.shares, strict=True) if e in onward)


def _levels(quantiles: Array, weight: Array) -> tuple[float, float]:
    """Median and 90 % quantile of the mixture of distributions with quantiles (n, Q) of even shares."""
    value = quantiles.ravel()
    order = np.argsort(value)
    share = np.cumsum(np.repeat(weight, quantiles.shape[1])[order])
    at = np.searchsorted(share, np.array(LEVEL_SHARES) * share[-1])
    middle, high = value[order][np.minimum(at, value.size - 1)]
    return float(middle), float(high)


def _same(graph: StreetGraph, origin: StreetPlace, destination: StreetPlace) -> bool:
    """Whether two places are less than a metre of one street apart."""
    return origin.edges[0] in destination.edges and (
        abs(origin.shares[0] - destination.shares[destination.edges.index(origin.edges[0])])
        * graph.edges[origin.edges[0]].length_m
        < 1.0
    )
