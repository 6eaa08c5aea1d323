"""Generated road maps with a route to drive: an urban grid, a rural ring, a town with country roads.

Each has what misleads matchers: parallel service roads, dual carriageways, close junctions, roundabouts, one-way
streets, missing connections. Nothing of them is from a real map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.map_matching.road_map import LinkKind, RoadMap

__all__ = ["DriveEnvironment", "MapBuilder", "MapWithRoute", "generate_map"]

Array = NDArray[np.float64]


RING_VERTICES_M = 6.0  # spacing of the vertices of a roundabout


@dataclass
class _Way:
    start: int
    end: int
    line: Array
    limit_mps: float
    kind: LinkKind


@dataclass
class MapBuilder:
    """Collects nodes and streets; :meth:`build` makes the map of them. Traffic drives on the right."""

    nodes: list[tuple[float, float]] = field(default_factory=list)
    ways: list[_Way] = field(default_factory=list)
    rings: dict[int, float] = field(default_factory=dict)

    def node(self, east_m: float, north_m: float) -> int:
        """Add a node; returns its number."""
        self.nodes.append((float(east_m), float(north_m)))
        return len(self.nodes) - 1

    def street(
        self,
        start: int,
        end: int,
        *,
        limit_mps: float,
        kind: LinkKind = LinkKind.STREET,
        via: ArrayLike = (),
        one_way: bool = False,
    ) -> None:
        """Add a street between two nodes through the points ``via`` (P, 2), in both directions unless ``one_way``."""
        middle = np.asarray(via, np.float64).reshape(-1, 2)
        line = np.concatenate([[self.nodes[start]], middle, [self.nodes[end]]])
        self.ways.append(_Way(start, end, line, limit_mps, kind))
        if not one_way:
            self.ways.append(_Way(end, start, line[::-1], limit_mps, kind))

    def roundabout(self, node: int, radius_m: float) -> None:
        """Make a roundabout of a node in :meth:`build`: a ring of one-way links between the streets that meet there."""
        self.rings[node] = radius_m

    def build(self) -> RoadMap:
        """The map.

        Raises
        ------
        InputError
            A street is too short for the roundabout at its end.
        """
        for node, radius in self.rings.items():
            self._ring(node, radius)
        self.rings = {}
        used = sorted({end for way in self.ways for end in (way.start, way.end)})
        number = {node: i for i, node in enumerate(used)}
        return RoadMap.of_lines(
            np.array([self.nodes[node] for node in used]),
            [(number[way.start], number[way.end]) for way in self.ways],
            [way.line for way in self.ways],
            limit_mps=[way.limit_mps for way in self.ways],
            kind=[int(way.kind) for way in self.ways],
        )

    def _ring(self, node: int, radius_m: float) -> None:
        """Cut the streets that meet in ``node`` at the radius, and join their ends by links against the clock."""
        centre = np.array(self.nodes[node])
        gates: dict[float, int] = {}
        for way in self.ways:
            for at_start in (True, False):
                if (way.start if at_start else way.end) != node:
                    continue
                line = way.line if at_start else way.line[::-1]
                cut = _cut(line, centre, radius_m)
                off = cut[0] - centre
                angle = round(float(np.arctan2(off[1], off[0])), 3)
                gate = gates.setdefault(angle, -1)
                if gate < 0:
                    gate = gates[angle] = self.node(*cut[0])
                cut[0] = self.nodes[gate]
                way.line = cut if at_start else cut[::-1]
                if at_start:
                    way.start = gate
                else:
                    way.end = gate
        angles = sorted(gates)
        for angle, following in zip(angles, [*angles[1:], angles[0] + 2.0 * np.pi], strict=True):
            pieces = max(2, round((following - angle) * radius_m / RING_VERTICES_M))
            turn = np.linspace(angle, following, pieces + 1)[1:-1]
            via = centre + radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
            last = gates[angles[0] if following > np.pi and following not in gates else following]
            self.street(gates[angle], last, limit_mps=8.3, kind=LinkKind.ROUNDABOUT, via=via, one_way=True)


def _cut(line: Array, centre: Array, radius_m: float) -> Array:
    """The part of a line (P, 2) from the centre of a circle on that lies outside of the circle, from its edge on."""
    inside = np.linalg.norm(line - centre, axis=-1) < radius_m
    if inside.all():
        raise InputError(f"a street must be longer than the radius {radius_m} m of its roundabout: make it longer")
    k = int(np.argmin(inside))
    a, step = line[k - 1] - centre, line[k] - line[k - 1]
    half, square = float(a @ step), float(step @ step)
    share = (-half + np.sqrt(half * half + square * (radius_m**2 - a @ a))) / square
    edge = line[k - 1] + share * step
    rest = line[k:] if np.linalg.norm(line[k] - edge) > 0.5 else line[k + 1 :]
    return np.concatenate([[edge], rest])


Ints = NDArray[np.int64]

BLOCK_M, JITTER_M = 120.0, 12.0  # spacing of the streets of a town
SERVICE_M = 15.0  # from an arterial road to the service road beside it
DUAL_M = 6.0  # from the middle of a dual carriageway to each of its sides
TAPER_M, SPACING_M = 25.0, 20.0  # of roads beside others: length of their ends, distance of points
TOWN_MPS, COUNTRY_MPS, LANE_MPS = 13.4, 22.4, 13.4  # 30 and 50 mph
SHARPEST_RAD = np.deg2rad(150.0)


class DriveEnvironment(StrEnum):
    """Where S5 drove (Table 2)."""

    URBAN = "urban"
    RURAL = "rural"
    MIXED = "mixed"


@dataclass(frozen=True)
class MapWithRoute:
    """A map, and the links of a route in it, one after another; ``closed``: the last leads to the first."""

    road_map: RoadMap
    route: Ints
    closed: bool

    @property
    def length_m(self) -> float:
        """Length of the route."""
        return float(self.road_map.length_m[self.route].sum())


def generate_map(environment: DriveEnvironment, length_m: float, rng: np.random.Generator) -> MapWithRoute:
    """A map of the environment, and a route of at least ``length_m`` (a closed one: of about that length).

    Raises
    ------
    InputError
        ``length_m`` is below 1 km.
    """
    if not length_m >= 1000.0:
        raise InputError(f"length_m must be at least 1000, got {length_m}: a route passes several streets")
    return GENERATORS[environment](length_m, rng)


def _urban(length_m: float, rng: np.random.Generator) -> MapWithRoute:
    builder = MapBuilder()
    _town(builder, 9, (0.0, 0.0), rng)
    road_map = builder.build()
    return MapWithRoute(road_map, _wander(road_map, length_m, rng), closed=False)


def _rural(length_m: float, rng: np.random.Generator) -> MapWithRoute:
    """A closed winding road with a dual carriageway, villages with service roads, and lanes across."""
    builder, corners = MapBuilder(), 16
    turn = 2.0 * np.pi * np.arange(corners) / corners
    radius = length_m / (2.0 * np.pi) * (1.0 + 0.06 * rng.standard_normal(corners))
    around = [builder.node(r * np.sin(t), r * np.cos(t)) for r, t in zip(radius, turn, strict=True)]
    for k, a in enumerate(around):
        b = around[(k + 1) % corners]
        bend = _winding(builder, a, b, rng, 12.0)
        if k % 4 == 1:
            _dual(builder, a, b, bend)
        else:
            builder.street(a, b, limit_mps=COUNTRY_MPS, via=bend)
        if k % 4 == 3:  # a village with a road for its houses beside the main road
            _service(builder, a, b, bend)
    for k in range(0, corners, 2):
        east, north = builder.nodes[around[k]]
        outer = builder.node(1.3 * east, 1.3 * north)
        builder.street(around[k], outer, limit_mps=LANE_MPS, kind=LinkKind.LANE, via=_winding(
            builder, around[k], outer, rng, 8.0))  # fmt: skip
    middle = builder.node(0.0, 0.0)
    for k in range(2, corners, 4):
        builder.street(around[k], middle, limit_mps=LANE_MPS, kind=LinkKind.LANE, via=_winding(
            builder, around[k], middle, rng, 15.0))  # fmt: skip
    for k in (0, 8):
        builder.roundabout(around[k], 18.0)
    road_map = builder.build()
    return MapWithRoute(road_map, _around(road_map, turn, radius), closed=True)


def _mixed(length_m: float, rng: np.random.Generator) -> MapWithRoute:
    """A small town inside a ring road (a dual carriageway), and winding roads to villages."""
    builder, size = MapBuilder(), 6
    grid = _town(builder, size, (0.0, 0.0), rng)
    half = 0.5 * BLOCK_M * (size - 1)
    corners = half * (1.0 + 1.9 * np.column_stack([f(np.arange(8) * np.pi / 4) for f in (np.sin, np.cos)]))
    ring = [builder.node(*corner) for corner in corners]
    for k, a in enumerate(ring):
        b = ring[(k + 1) % 8]
        _dual(builder, a, b, _winding(builder, a, b, rng, 10.0))
    gates = {0: grid[size // 2][-1], 2: grid[-1][size // 2], 4: grid[size // 2][0], 6: grid[0][size // 2]}
    for k, gate in gates.items():
        builder.street(gate, ring[k], limit_mps=TOWN_MPS, via=_winding(builder, gate, ring[k], rng, 5.0))
        builder.roundabout(ring[k], 20.0)
    for k in (1, 3, 5, 7):
        outward = np.array(builder.nodes[ring[k]]) - half
        unit = outward / np.linalg.norm(outward)
        across = np.array([unit[1], -unit[0]])
        centre = half + 2.0 * outward
        village, left, right = (builder.node(*p) for p in (
            centre, centre + 80.0 * (unit - across), centre + 80.0 * (unit + across)))  # fmt: skip
        builder.street(ring[k], village, limit_mps=COUNTRY_MPS, via=_winding(builder, ring[k], village, rng, 20.0))
        for p, q in ((village, left), (left, right), (right, village)):
            builder.street(p, q, limit_mps=LANE_MPS, kind=LinkKind.LANE)
    road_map = builder.build()
    return MapWithRoute(road_map, _wander(road_map, length_m, rng), closed=False)


GENERATORS: dict[DriveEnvironment, Callable[[float, np.random.Generator], MapWithRoute]] = {
    DriveEnvironment.URBAN: _urban,
    DriveEnvironment.RURAL: _rural,
    DriveEnvironment.MIXED: _mixed,
}


def _town(builder: MapBuilder, size: int, corner: tuple[float, float], rng: np.random.Generator) -> list[list[int]]:
    """A grid of streets: some are missing or one-way, every third is an arterial road with a service road beside it."""
    jitter = JITTER_M * rng.uniform(-1.0, 1.0, (size, size, 2))
    nodes = [
        [builder.node(*(np.array(corner) + BLOCK_M * np.array([i, j]) + jitter[i, j])) for j in range(size)]
        for i in range(size)
    ]
    for i in range(size):
        for j in range(size):
            for di, dj in ((1, 0), (0, 1)):
                if i + di >= size or j + dj >= size:
                    continue
                a, b, drawn = nodes[i][j], nodes[i + di][j + dj], rng.random()
                arterial = (j if di else i) % 3 == 0
                if not arterial and drawn < 0.1:
                    continue
                builder.street(a, b, limit_mps=TOWN_MPS, one_way=not arterial and drawn < 0.25)
                if arterial and drawn < 0.35:
                    _service(builder, a, b, np.zeros((0, 2)))
    for _ in range(size // 3):
        i, j = rng.integers(1, size - 1, 2)
        builder.roundabout(nodes[i][j], 16.0)
    return nodes


def _service(builder: MapBuilder, a: int, b: int, bend: Array) -> None:
    """A service road beside the road from ``a`` to ``b``, joined to its nodes."""
    line = np.concatenate([[builder.nodes[a]], bend, [builder.nodes[b]]])
    builder.street(a, b, limit_mps=8.9, kind=LinkKind.SERVICE, via=_beside(line, SERVICE_M))


def _dual(builder: MapBuilder, a: int, b: int, bend: Array) -> None:
    """Two one-way carriageways side by side, with the traffic on the right."""
    line = np.concatenate([[builder.nodes[a]], bend, [builder.nodes[b]]])
    for start, end, way in ((a, b, line), (b, a, line[::-1])):
        via = _beside(way, DUAL_M)
        builder.street(start, end, limit_mps=COUNTRY_MPS, kind=LinkKind.CARRIAGEWAY, via=via, one_way=True)


def _beside(line: Array, right_m: float) -> Array:
    """Points (Q, 2) to the right of a line (P, 2), SPACING_M apart, without TAPER_M at its ends."""
    step = np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=-1)
    arc = np.concatenate([[0.0], np.cumsum(length)])
    count = max(2, round((arc[-1] - 2.0 * TAPER_M) / SPACING_M) + 1)
    at = np.linspace(TAPER_M, arc[-1] - TAPER_M, count)
    place = np.column_stack([np.interp(at, arc, line[:, k]) for k in range(2)])
    unit = np.column_stack([np.interp(at, 0.5 * (arc[1:] + arc[:-1]), step[:, k] / length) for k in range(2)])
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    return np.asarray(place + right_m * np.column_stack([unit[:, 1], -unit[:, 0]]))


def _winding(builder: MapBuilder, a: int, b: int, rng: np.random.Generator, sigma_m: float) -> Array:
    """Points (P, 2) between two nodes, SPACING_M apart, beside the straight line by a smooth random curve."""
    p, q = np.array(builder.nodes[a]), np.array(builder.nodes[b])
    span = q - p
    length = float(np.linalg.norm(span))
    count = max(2, round(length / SPACING_M))
    share = np.arange(1, count) / count
    waves = rng.standard_normal(2) * sigma_m
    off = waves[0] * np.sin(np.pi * share) + 0.5 * waves[1] * np.sin(2.0 * np.pi * share)
    return np.asarray(p + share[:, None] * span + off[:, None] * np.array([span[1], -span[0]]) / length)


def _wander(road_map: RoadMap, length_m: float, rng: np.random.Generator) -> Ints:
    """A random route: at each node a link that was driven least, but no turn back and no sharp turn."""
    heading = _end_headings(road_map)
    driven, out = np.zeros(road_map.links, np.int64), [int(rng.integers(road_map.links))]
    total = float(road_map.length_m[out[0]])
    while total < length_m:
        here = out[-1]
        onward = np.flatnonzero(road_map.link_from == road_map.link_to[here])
        turn = np.abs(np.angle(np.exp(1j * (heading[0, onward] - heading[1, here]))))
        onward = onward[(onward != road_map.twin[here]) & (turn < SHARPEST_RAD)]
        if onward.size == 0:  # a dead end: begin elsewhere
            driven, out, total = np.zeros_like(driven), [int(rng.integers(road_map.links))], 0.0
            total = float(road_map.length_m[out[0]])
            continue
        cost = driven[onward] + 0.5 * rng.random(onward.size)
        chosen = int(onward[np.argmin(cost)])
        driven[chosen] += 1
        if road_map.twin[chosen] >= 0:
            driven[road_map.twin[chosen]] += 1
        out.append(chosen)
        total += float(road_map.length_m[chosen])
    return np.array(out, np.int64)


def _end_headings(road_map: RoadMap) -> Array:
    """Azimuth of each link at its start and at its end, (2, L)."""
    out = np.zeros((2, road_map.links))
    for i in range(road_map.links):
        line = road_map.line(i)
        for k, step in enumerate((line[1] - line[0], line[-1] - line[-2])):
            out[k, i] = np.arctan2(step[0], step[1])
    return out


def _around(road_map: RoadMap, turn: Array, radius_m: Array) -> Ints:
    """The links of the ring road, clockwise, without service roads."""
    places = np.column_stack([radius_m * np.sin(turn), radius_m * np.cos(turn)])
    usable = np.isin(road_map.kind, (LinkKind.STREET, LinkKind.CARRIAGEWAY, LinkKind.ROUNDABOUT))
    out: list[int] = []
    start = int(np.argmin(np.linalg.norm(road_map.node_en_m - places[1], axis=-1)))
    here = start
    for _ in range(4 * turn.size):
        onward = np.flatnonzero((road_map.link_from == here) & usable)
        if out:
            onward = onward[onward != road_map.twin[out[-1]]]
        chosen = int(onward[np.argmax(_clockwise(road_map, onward))])
        out.append(chosen)
        here = int(road_map.link_to[chosen])
        if here == start:
            return np.array(out, np.int64)
    raise AssertionError("the ring road does not close")


def _clockwise(road_map: RoadMap, links: Ints) -> Array:
    """Angle about the origin by which links lead clockwise; streets before the rest of a roundabout."""
    a, b = road_map.node_en_m[road_map.link_from[links]], road_map.node_en_m[road_map.link_to[links]]
    angle = np.arctan2(a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1], (a * b).sum(-1))
    return np.asarray(np.where(road_map.kind[links] == LinkKind.ROUNDABOUT, -10.0 + angle, angle))
