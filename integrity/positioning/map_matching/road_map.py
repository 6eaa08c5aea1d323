"""A road map as matchers take it: nodes, directed links with their lines, and a search for the links near positions.

A street with two directions is two links with one line, each the ``twin`` of the other. ``identity`` names a link; it
stays the same when errors are put into a map, so that a match in the wrong map can be compared with the true link.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape

__all__ = ["NO_LINK", "LinkKind", "NearLinks", "RoadMap"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NO_LINK = -1
CELL_M = 25.0
MOST_NODES = 4000  # distances between all nodes are kept: 128 MB


class LinkKind(IntEnum):
    """Kind of a road; for statistics and figures alone."""

    STREET = 0
    SERVICE = 1
    CARRIAGEWAY = 2
    ROUNDABOUT = 3
    LANE = 4


class NearLinks(NamedTuple):
    """The links near B positions, the nearest first, K for each; a missing one is NO_LINK with an infinite distance.

    link (B, K), distance_m (B, K), arc_m (B, K) along the link, foot_en_m (B, K, 2), heading_rad (B, K) of the link.
    """

    link: Ints
    distance_m: Array
    arc_m: Array
    foot_en_m: Array
    heading_rad: Array

    def rows(self, row: int) -> NearLinks:
        """The links near one position, as a batch of 1."""
        one = slice(row, row + 1)
        return NearLinks(
            self.link[one], self.distance_m[one], self.arc_m[one], self.foot_en_m[one], self.heading_rad[one]
        )

    @property
    def there(self) -> Bools:
        """(B, K): there is a link."""
        return np.asarray(self.link != NO_LINK)


class Segments(NamedTuple):
    """Straight pieces (M,) of all links: start, direction (unit), length, link, arc of the start."""

    start_en_m: Array
    unit: Array
    length_m: Array
    link: Ints
    arc_m: Array


@dataclass(frozen=True)
class RoadMap:
    """Nodes (N,) and directed links (L,).

    Attributes
    ----------
    node_en_m : (N, 2) East, North
    link_from, link_to : (L,) nodes at the start and at the end
    first : (L + 1,) the line of link i are the vertices ``first[i]`` to ``first[i + 1] - 1``
    vertex_en_m : (V, 2)
    identity : (L,) names of links
    twin : (L,) link of the opposite direction, NO_LINK without one
    limit_mps : (L,) speed limit
    kind : (L,) codes of LinkKind
    """

    node_en_m: Array
    link_from: Ints
    link_to: Ints
    first: Ints
    vertex_en_m: Array
    identity: Ints
    twin: Ints
    limit_mps: Array
    kind: Ints

    def __post_init__(self) -> None:
        links, nodes = self.link_from.size, self.node_en_m.shape[0]
        require_shape("node_en_m", require_finite("node_en_m", self.node_en_m), (nodes, 2))
        require_shape("vertex_en_m", require_finite("vertex_en_m", self.vertex_en_m), (None, 2))
        if links < 1 or nodes > MOST_NODES:
            raise InputError(
                f"a map must have a link and at most {MOST_NODES} nodes, got {links} links and {nodes} nodes: cut it"
            )
        for name in ("link_from", "link_to"):
            ends = getattr(self, name)
            if ends.min() < 0 or ends.max() >= nodes:
                raise InputError(f"{name} must lie in [0, {nodes - 1}], got {ends.min()} to {ends.max()}: name nodes")
        if (np.diff(self.first) < 2).any() or (self.segments.length_m <= 0.0).any():
            raise InputError("every link must have two vertices, none twice in a row: remove what has no length")

    @classmethod
    def of_lines(
        cls,
        node_en_m: ArrayLike,
        ends: list[tuple[int, int]],
        lines: list[Array],
        *,
        identity: ArrayLike | None = None,
        limit_mps: ArrayLike = 13.9,
        kind: ArrayLike = LinkKind.STREET,
    ) -> RoadMap:
        """A map of links with given ends and lines (P, 2); twins are links with exchanged ends and the same line."""
        links = len(ends)
        pairs = np.asarray(ends, np.int64).reshape(links, 2)
        keys = {(a, b, tuple(map(tuple, line))): i for i, ((a, b), line) in enumerate(zip(ends, lines, strict=True))}
        twin = [
            keys.get((b, a, tuple(map(tuple, line[::-1]))), NO_LINK)
            for (a, b), line in zip(ends, lines, strict=True)
        ]  # fmt: skip
        return cls(
            np.asarray(node_en_m, np.float64), pairs[:, 0], pairs[:, 1],
            np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64),
            np.concatenate(lines).astype(np.float64) if lines else np.zeros((0, 2)),
            np.arange(links) if identity is None else np.asarray(identity, np.int64),
            np.asarray(twin, np.int64), np.broadcast_to(np.asarray(limit_mps, np.float64), links).copy(),
            np.broadcast_to(np.asarray(kind, np.int64), links).copy(),
        )  # fmt: skip

    @property
    def links(self) -> int:
        """Number of links."""
        return int(self.link_from.size)

    def line(self, link: int) -> Array:
        """Vertices (P, 2) of a link."""
        return np.asarray(self.vertex_en_m[self.first[link] : self.first[link + 1]])

    @cached_property
    def segments(self) -> Segments:
        """All straight pieces, link by link."""
        owner = np.repeat(np.arange(self.first.size - 1), np.diff(self.first))
        inside = np.flatnonzero(owner[:-1] == owner[1:])
        start, step = self.vertex_en_m[inside], self.vertex_en_m[inside + 1] - self.vertex_en_m[inside]
        length = np.hypot(step[:, 0], step[:, 1])
        link, total = owner[inside], np.concatenate([[0.0], np.cumsum(length)])
        begins = np.searchsorted(link, np.arange(self.first.size - 1))
        return Segments(
            start, step / np.maximum(length, 1e-12)[:, None], length, link, total[:-1] - total[begins][link]
        )

    @cached_property
    def length_m(self) -> Array:
        """Length of each link (L,)."""
        return np.asarray(np.bincount(self.segments.link, self.segments.length_m, self.links), np.float64)

    # Routes

    @cached_property
    def _routes(self) -> tuple[Array, Ints]:
        """Length of the shortest route between any two nodes (N, N), inf without one, and its last node but one."""
        from scipy.sparse import coo_array  # a third of a second, which only routes need
        from scipy.sparse.csgraph import dijkstra

        nodes, order = self.node_en_m.shape[0], np.argsort(-self.length_m, kind="stable")
        shortest: dict[tuple[int, int], float] = {
            (int(self.link_from[i]), int(self.link_to[i])): float(self.length_m[i]) for i in order
        }
        ends = np.array(list(shortest), np.int64)
        graph = coo_array((np.array(list(shortest.values())), (ends[:, 0], ends[:, 1])), shape=(nodes, nodes))
        found = dijkstra(graph.tocsr(), return_predecessors=True)
        return np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)

    @property
    def node_distance_m(self) -> Array:
        """Length of the shortest route between any two nodes (N, N), inf without one."""
        return self._routes[0]

    @cached_property
    def shortest_link(self) -> dict[tuple[int, int], int]:
        """The shortest link between two nodes that a link joins."""
        order = np.argsort(-self.length_m, kind="stable")
        return {(int(self.link_from[i]), int(self.link_to[i])): int(i) for i in order}

    def route_between(self, a: int, b: int) -> list[int]:
        """Links of the shortest route from node ``a`` to node ``b``; empty when they are the same.

        Raises
        ------
        InputError
            There is no route.
        """
        if not np.isfinite(self.node_distance_m[a, b]):
            raise InputError(f"node {b} must be reachable from node {a}, is not: choose nodes of one network")
        out: list[int] = []
        while b != a:
            before = int(self._routes[1][a, b])
            out.append(self.shortest_link[before, b])
            b = before
        return out[::-1]

    def route_distance_m(
        self, link: Ints, arc_m: Array, to_link: Ints, to_arc_m: Array, backward_m: float = 0.0
    ) -> Array:
        """Length of the shortest drive from a place on one link to a place on another, inf without one.

        All (...,), broadcast. A step back on the same link by at most ``backward_m`` counts as its length: positions of
        a vehicle that stands move back and forth.
        """
        a, b = np.maximum(link, 0), np.maximum(to_link, 0)
        around = self.length_m[a] - arc_m + self.node_distance_m[self.link_to[a], self.link_from[b]] + to_arc_m
        ahead = to_arc_m - arc_m
        same = (a == b) & (ahead >= -backward_m)
        found = np.where(same, np.abs(ahead), around)
        return np.where((link == NO_LINK) | (to_link == NO_LINK), np.inf, found)

    # Links near positions

    def near(self, position_en_m: ArrayLike, radius_m: float, most: int) -> NearLinks:
        """The ``most`` nearest links within ``radius_m`` of positions (B, 2), by the nearest point of their lines."""
        p = require_finite("position_en_m", position_en_m)
        require_shape("position_en_m", p, (None, 2))
        cells = self._cells(float(radius_m))
        piece = cells.pieces[cells.row(p)]
        s, there = self.segments, piece >= 0
        k = np.where(there, piece, 0)
        off = p[:, None, :] - s.start_en_m[k]
        along = np.clip((off * s.unit[k]).sum(-1), 0.0, s.length_m[k])
        away = off - along[..., None] * s.unit[k]
        distance = np.hypot(away[..., 0], away[..., 1])
        distance = np.where(there & (distance <= radius_m), distance, np.inf)
        chosen = _nearest_of_each_link(distance, s.link[k], most)
        rows = np.arange(p.shape[0])[:, None]
        d, piece_of = distance[rows, chosen], k[rows, chosen]
        d = np.where(_first_of_link(d, s.link[piece_of]), d, np.inf)
        found, unit = np.isfinite(d), s.unit[piece_of]
        return NearLinks(
            np.where(found, s.link[piece_of], NO_LINK), d, s.arc_m[piece_of] + along[rows, chosen],
            p[:, None, :] - away[rows, chosen], np.arctan2(unit[..., 0], unit[..., 1]),
        )  # fmt: skip

    def _cells(self, radius_m: float) -> _Cells:
        found = self._by_radius.get(radius_m)
        if found is None:
            found = self._by_radius[radius_m] = _Cells.of(self, radius_m)
        return found

    @cached_property
    def _by_radius(self) -> dict[float, _Cells]:
        return {}


class _Cells(NamedTuple):
    """Squares of CELL_M with the pieces that may be near a position in them: pieces (cells, M), -1 for none."""

    origin_en_m: Array
    shape: tuple[int, int]
    pieces: Ints

    @classmethod
    def of(cls, road_map: RoadMap, radius_m: float) -> _Cells:
        s = road_map.segments
        ends = np.stack([s.start_en_m, s.start_en_m + s.length_m[:, None] * s.unit])
        origin = ends.min((0, 1)) - radius_m - CELL_M
        east, north = (int(n) for n in np.ceil((ends.max((0, 1)) + radius_m - origin) / CELL_M) + 1)
        grid = np.stack(np.meshgrid(np.arange(east), np.arange(north), indexing="ij"), -1).reshape(-1, 2)
        centre, reach = origin + CELL_M * (grid + 0.5), radius_m + CELL_M * np.sqrt(0.5)
        rows, columns = [], []
        for begin in range(0, centre.shape[0], 256):
            off = centre[begin : begin + 256, None, :] - s.start_en_m
            along = np.clip((off * s.unit).sum(-1), 0.0, s.length_m)
            close = np.linalg.norm(off - along[..., None] * s.unit, axis=-1) <= reach
            cell, piece = np.nonzero(close)
            rows.append(cell + begin)
            columns.append(piece)
        row, piece = np.concatenate(rows), np.concatenate(columns)
        count = np.bincount(row, minlength=centre.shape[0])
        pieces = np.full((centre.shape[0] + 1, max(1, int(count.max()))), -1, np.int64)
        pieces[row, np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)] = piece
        return cls(origin, (east, north), pieces)

    def row(self, position_en_m: Array) -> Ints:
        """Row of ``pieces`` (B,); the last row, without pieces, outside of the map."""
        at = np.floor((position_en_m - self.origin_en_m) / CELL_M)
        inside = np.asarray(((at >= 0) & (at < self.shape)).all(-1))
        at = np.where(inside[:, None], at, 0).astype(np.int64)
        return np.where(inside, at[:, 0] * self.shape[1] + at[:, 1], self.pieces.shape[0] - 1)


def _nearest_of_each_link(distance_m: Array, link: Ints, most: int) -> Ints:
    """Columns (B, most) of the nearest piece of each link, the nearest first; too few are filled with far ones."""
    order = np.lexsort((distance_m, link))
    sorted_link = np.take_along_axis(link, order, -1)
    first = np.ones(order.shape, np.bool_)
    first[:, 1:] = sorted_link[:, 1:] != sorted_link[:, :-1]
    rank = np.where(first, np.take_along_axis(distance_m, order, -1), np.inf)
    best = np.argsort(rank, axis=-1, kind="stable")[:, :most]
    return np.take_along_axis(order, best, -1)


def _first_of_link(distance_m: Array, link: Ints) -> Bools:
    """Where a column (B, K) is the first of its link; the others fill places that have no link."""
    same = (link[:, :, None] == link[:, None, :]) & (distance_m[:, None, :] <= distance_m[:, :, None])
    return np.asarray(~np.tril(same, -1).any(-1))
