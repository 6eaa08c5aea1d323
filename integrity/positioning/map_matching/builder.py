"""Builds road maps: streets of one or two directions, parallel roads, roundabouts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.map_matching.road_map import LinkKind, RoadMap

__all__ = ["MapBuilder"]

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
