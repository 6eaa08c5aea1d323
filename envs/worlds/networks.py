"""The roads of the worlds: winding roads through streets, a long road with large radii, and a loop through a city.

A road is determined by its layout number. Several roads lie far apart in one network (:meth:`StreetNetwork.apart`), and
an episode is on one of them. Lane 0 is the leftmost lane, as in highway-env.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import inf

import numpy as np
from highway_env.road.lane import LineType
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.lanes import CurveLane
from lanebound.envs.worlds.paths import Path, Piece, Pose, bend, rounded_polygon, straight
from lanebound.integrity.core.errors import InputError

__all__ = ["Section", "StreetNetwork", "advance", "city_loop", "city_sections", "long_road", "node_at",
           "winding_road"]  # fmt: skip

Array = NDArray[np.float64]
Section = tuple[str, str, float, float, str]
Box = tuple[str, str, list[CurveLane], tuple[float, float, float, float]]

APART_M = 10_000.0  # between sites; no signal depends on where a site is
TURN_LIMIT_RAD = 1.2  # a road that never turns back does not meet itself

# Corners x, y and radius [m] of a loop of 3 km, driven clockwise.
CITY_CORNERS = (
    (0.0, 0.0, 28.0), (520.0, 0.0, 30.0), (540.0, -170.0, 26.0), (900.0, -170.0, 40.0), (960.0, 60.0, 120.0),
    (900.0, 310.0, 26.0), (430.0, 290.0, 30.0), (400.0, 460.0, 24.0), (0.0, 470.0, 26.0), (-70.0, 220.0, 90.0),
)  # fmt: skip
CITY_NODES = ("a", "b", "c", "d")
CITY_JOINTS = (0, 2, 4, 7)  # the sides on whose middles the nodes lie
CITY_TRANSITION_M = 12.0

# What lines the loop, by distances along each edge [m]; kinds of lanebound.integrity.sky.city.SectionKind.
CITY_SECTIONS: tuple[Section, ...] = (
    ("a", "b", 0.0, 180.0, "open"),
    ("a", "b", 180.0, 235.0, "overpass"),
    ("a", "b", 235.0, inf, "dense_canyon"),
    ("b", "c", 0.0, 140.0, "dense_canyon"),
    ("b", "c", 140.0, 300.0, "semi_urban"),
    ("b", "c", 300.0, inf, "open"),
    ("c", "d", 0.0, 250.0, "trees"),
    ("c", "d", 250.0, 370.0, "tunnel"),
    ("c", "d", 370.0, inf, "semi_urban"),
    ("d", "a", 0.0, 330.0, "dense_canyon"),
    ("d", "a", 330.0, 385.0, "overpass"),
    ("d", "a", 385.0, 600.0, "suburban"),
    ("d", "a", 600.0, inf, "open"),
)


class StreetNetwork(RoadNetwork):  # type: ignore[misc]
    """A road network of :class:`CurveLane` with a fast search for the closest lane.

    The result is that of ``RoadNetwork``, including ties: a road is skipped only if the bounding box of its lanes is
    farther than the best lane found, and the distance to a lane is at least that to its box.

    Attributes
    ----------
    goal : the road to which the ego is to drive, None for none
    geo_objects : number of the geo-object, from 0, of which a road is a link; those of one object run beside each other
    sites : the roads of each of several places far from each other, on one of which an episode is; empty for one place
    """

    def __init__(self, goal: tuple[str, str] | None = None) -> None:
        super().__init__()
        self.goal, self.geo_objects = goal, dict[tuple[str, str], int]()
        self.sites: list[list[tuple[str, str]]] = []
        self._boxes: list[Box] = []

    def add_lane(self, _from: str, _to: str, lane: CurveLane) -> None:
        """Append a lane to the right of the existing lanes between two nodes."""
        super().add_lane(_from, _to, lane)
        self._boxes = []

    def add_road(self, edge: tuple[str, str], path: Path, lanes: int, width_m: float) -> None:
        """Add parallel lanes centred on a path, with broken lines between them and solid lines outside."""
        if lanes < 1 or width_m <= 0.0:
            raise InputError(f"a road needs lanes >= 1 and width_m > 0, got {lanes} and {width_m}")
        for k in range(lanes):
            left = LineType.CONTINUOUS_LINE if k == 0 else LineType.STRIPED
            right = LineType.CONTINUOUS_LINE if k == lanes - 1 else LineType.NONE
            self.add_lane(*edge, CurveLane(path, (k - 0.5 * (lanes - 1)) * width_m, width_m, (left, right)))

    def add_beside(
        self, edge: tuple[str, str], path: Path, lanes: range, width_m: float, speed_limit: float
    ) -> None:  # fmt: skip
        """Add lanes beside a path, which is the middle of lane 0: lane k lies ``k width_m`` to its right."""
        for k in lanes:
            left = LineType.CONTINUOUS_LINE if k == lanes[0] else LineType.STRIPED
            right = LineType.CONTINUOUS_LINE if k == lanes[-1] else LineType.NONE
            self.add_lane(*edge, CurveLane(path, k * width_m, width_m, (left, right), speed_limit))

    @classmethod
    def apart(cls, networks: Sequence[StreetNetwork]) -> StreetNetwork:
        """One network of several ones, each at a site of its own; nodes are named as in :func:`node_at`."""
        if len(networks) == 1:
            return networks[0]
        out = cls()
        for k, one in enumerate(networks):
            roads = [(a, b, lanes) for a, ends in one.graph.items() for b, lanes in ends.items()]
            for a, b, lanes in roads:
                for lane in lanes:
                    out.add_lane(node_at(a, k), node_at(b, k), lane.moved(k * APART_M))
            out.sites.append([(node_at(a, k), node_at(b, k)) for a, b, _ in roads])
        return out

    def alone(self, site: int) -> StreetNetwork:
        """The roads of one site; the network itself if there is one."""
        if not self.sites:
            return self
        out = StreetNetwork()
        for a, b in self.sites[site]:
            for lane in self.graph[a][b]:
                out.add_lane(a, b, lane)
        return out

    def _box_up(self) -> None:
        """Compute bounding boxes of the centre lines of each road; a margin of 1 m covers the error of sampling."""
        for a, ends in self.graph.items():
            for b, lanes in ends.items():
                margin = np.array([[abs(lane.offset_m) + 1.0] for lane in lanes])
                low = np.min([lane.path.low_m for lane in lanes] - margin, axis=0).tolist()
                high = np.max([lane.path.high_m for lane in lanes] + margin, axis=0).tolist()
                self._boxes.append((a, b, lanes, (low[0], low[1], high[0], high[1])))

    def get_closest_lane_index(self, position: Array, heading: float | None = None) -> LaneIndex:
        """Index of the lane with the smallest distance (including the weighted angle); nearest boxes are first."""
        if not self._boxes:
            self._box_up()
        x, y = float(position[0]), float(position[1])
        near = [
            (max(x0 - x, x - x1, y0 - y, y - y1, 0.0), k) for k, (_, _, _, (x0, y0, x1, y1)) in enumerate(self._boxes)
        ]
        best, least = (0, 0), inf
        for gap, k in sorted(near) if len(near) > 1 else near:
            if gap > least:
                break
            for i, lane in enumerate(self._boxes[k][2]):
                distance = lane.distance_with_heading(position, heading)
                if distance < least or (distance == least and (k, i) < best):
                    best, least = (k, i), distance
        return (*self._boxes[best[0]][:2], best[1])


def node_at(name: str, site: int) -> str:
    """The name of a node at a site: its own at the first one."""
    return f"{name}@{site}" if site else name


def winding_road(layout: int, lanes: int, width_m: float) -> StreetNetwork:
    """Road of 1.7 to 2.1 km: straights, bends of 40 to 160 m radius, S-bends; edge ("start", "end")."""
    network = StreetNetwork()
    path = _winding(layout, 1700.0, (40.0, 160.0), (0.4, 1.5), (30.0, 120.0))
    network.add_road(("start", "end"), path, lanes, width_m)
    return network


def long_road(layout: int, width_m: float, lanes: int = 1) -> StreetNetwork:
    """Road of 2.6 to 3.1 km: straights and bends of 200 to 600 m radius; edge ("start", "end")."""
    network = StreetNetwork()
    path = _winding(layout, 2600.0, (200.0, 600.0), (0.1, 0.5), (80.0, 300.0))
    network.add_road(("start", "end"), path, lanes, width_m)
    return network


def city_loop(width_m: float, lanes: int = 2) -> StreetNetwork:
    """Clockwise loop around a city, in four edges that are connected on straights: a, b, c, d, a."""
    network = StreetNetwork()
    sides = rounded_polygon([(x, y, r) for x, y, r in CITY_CORNERS], CITY_TRANSITION_M)
    for k, node in enumerate(CITY_NODES):
        first = CITY_JOINTS[k]
        last = CITY_JOINTS[k + 1] if k + 1 < len(CITY_JOINTS) else len(sides)
        pieces = [piece for _, side in sides[first:last] for piece in side]
        path = Path.of(sides[first][0], _joined(pieces))
        network.add_road((node, CITY_NODES[(k + 1) % len(CITY_NODES)]), path, lanes, width_m)
    return network


def city_sections(network: RoadNetwork) -> tuple[Section, ...]:
    """Surroundings of the loop; ends are limited to the lengths of the edges."""
    graph = network.graph
    return tuple((a, b, start, min(end, graph[a][b][0].length), kind) for a, b, start, end, kind in CITY_SECTIONS)


def _joined(pieces: list[Piece]) -> list[Piece]:
    """Join adjacent straights."""
    out: list[Piece] = []
    for piece in pieces:
        if out and piece.start == piece.end == out[-1].start == out[-1].end == 0.0:
            out[-1] = Piece(out[-1].length + piece.length, 0.0, 0.0)
        else:
            out.append(piece)
    return out


@lru_cache(maxsize=128)
def _winding(
    layout: int,
    length_m: float,
    radius_m: tuple[float, float],
    angle_rad: tuple[float, float],
    straight_m: tuple[float, float],
) -> Path:
    """Random road of alternating straights and bends; one of three bends is directly followed by the opposite bend.

    The layout number is the seed; the road does not depend on the seed of an episode. Radii are log-uniform. A bend
    turns back towards the x axis if the angle to it would exceed ``TURN_LIMIT_RAD``.
    """
    rng = np.random.default_rng(layout)
    pieces, heading = straight(80.0), 0.0
    while sum(piece.length for piece in pieces) < length_m - 80.0:
        for _ in range(2 if rng.random() < 1.0 / 3.0 else 1):
            radius = radius_m[0] * (radius_m[1] / radius_m[0]) ** rng.random()
            angle = rng.uniform(*angle_rad)
            sign = -1.0 if heading > 0.0 else 1.0
            if abs(heading) < 0.2:
                sign = 1.0 if rng.random() < 0.5 else -1.0
            angle = sign * min(angle, TURN_LIMIT_RAD - sign * heading)
            pieces += bend(angle, radius, min(0.25 * radius + 10.0, 40.0))
            heading += angle
        pieces += straight(rng.uniform(*straight_m))
    return Path.of(Pose(0.0, 0.0, 0.0), _joined(pieces + straight(80.0)))


def advance(
    network: RoadNetwork, index: LaneIndex, longitudinal_m: float, distance_m: float
) -> tuple[LaneIndex, float]:
    """Lane and longitudinal position at a (signed) distance along a road without forks.

    Beyond the end of the road the position is extrapolated on the last lane.
    """
    s = longitudinal_m + distance_m
    while s >= network.get_lane(index).length and index[1] in network.graph:
        s -= network.get_lane(index).length
        index = (index[1], next(iter(network.graph[index[1]])), index[2])
    while s < 0.0:
        before = [node for node, ends in network.graph.items() if index[0] in ends]
        if not before:
            break
        index = (before[0], index[0], index[2])
        s += network.get_lane(index).length
    return index, s
