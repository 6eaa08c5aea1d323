"""Conversion of a lane network to :class:`~lanebound.integrity.sky.road.Road`, and the ground without lanes.

Positions are East, North [m]: ``E = x``, ``N = -y`` of highway-env's plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.envs.records import enu_of
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.sky.city import CLEARANCE_M
from lanebound.integrity.sky.road import Road

__all__ = ["Corridor", "CorridorPlot", "Edge", "LaneGround", "corridors", "edges_of", "lane_points"]

Array = NDArray[np.float64]
Edge = tuple[str, str]

SAMPLE_M = 1.0  # between the points that stand for a lane
CENTRE_M = 2.0  # between the points of a centre line
BEYOND_M = 100.0  # length of a street beyond the last station
JOINT_M = 6.0  # largest distance between the centres of consecutive edges, where one lane may begin or end
JOINT_RAD = 0.5
OVERLAP_M = 0.3  # smaller overlaps are ignored


@dataclass(frozen=True)
class Corridor:
    """One edge of a network as a road, and its place in a chain of consecutive edges."""

    edge: Edge
    road: Road
    chain: int = 0
    start_m: float = 0.0


def edges_of(network: RoadNetwork) -> Iterator[tuple[Edge, list[AbstractLane]]]:
    """All edges with their lanes, in the order of the network."""
    for start, ends in network.graph.items():
        for end, lanes in ends.items():
            if lanes:
                yield (start, end), lanes


def lane_points(lane: AbstractLane, longitudinal_m: Array) -> Array:
    """Points of a lane's centre at longitudinal positions.  (n,) [m] -> (n, 2) East, North [m]."""
    return enu_of(np.array([lane.position(float(s), 0.0) for s in longitudinal_m]).reshape(-1, 2))


def corridors(network: RoadNetwork, extent_m: float) -> list[Corridor]:
    """Convert every edge to a road, up to ``extent_m``, in chains of edges with the same direction."""
    roads = {edge: _road(lanes, extent_m) for edge, lanes in edges_of(network)}
    out: list[Corridor] = []
    for number, chain in enumerate(_chains(roads)):
        at = 0.0
        for edge in chain:
            out.append(Corridor(edge, roads[edge], number, at))
            at += roads[edge].length_m
    order = {edge: i for i, edge in enumerate(roads)}
    return sorted(out, key=lambda corridor: order[corridor.edge])


def _road(lanes: list[AbstractLane], extent_m: float) -> Road:
    """The centre of an edge's lanes as a road with the width of all lanes."""
    outer = (lanes[0], lanes[-1])
    longest = max(float(lane.length) for lane in outer)
    share = np.linspace(0.0, min(1.0, (extent_m + BEYOND_M) / longest), max(2, int(min(longest, extent_m) / CENTRE_M)))
    sides = [lane_points(lane, share * float(lane.length)) for lane in outer]
    apart = np.linalg.norm(sides[1] - sides[0], axis=-1).max()
    width = apart + 0.5 * sum(float(lane.width_at(0.0)) for lane in outer)
    return Road.through(
        0.5 * (sides[0] + sides[1]),
        corner_radius_m=np.inf,
        lane_count=len(lanes),
        lane_width_m=float(width) / len(lanes),
    )


def _chains(roads: dict[Edge, Road]) -> list[list[Edge]]:
    """Chains of edges with the smallest bends; each edge is in one chain."""
    following: dict[Edge, Edge] = {}
    taken: set[Edge] = set()
    for edge, road in roads.items():
        options = [(_bend(road, roads[other]), other) for other in roads if other[0] == edge[1] and other not in taken]
        best = min(options, default=(np.inf, edge))
        if best[0] < np.inf:
            following[edge] = best[1]
            taken.add(best[1])
    chains: list[list[Edge]] = []
    done: set[Edge] = set()
    for first in [edge for edge in roads if edge not in taken] + list(roads):
        chain: list[Edge] = []
        here: Edge | None = first
        while here is not None and here not in done:
            done.add(here)
            chain.append(here)
            here = following.get(here)
        if chain:
            chains.append(chain)
    return chains


def _bend(road: Road, onward: Road) -> float:
    """Angle between the end of a road and the start of the next [rad], inf if the roads are not connected."""
    turn = abs(wrap_angle(float(onward.tangent_rad[0] - road.tangent_rad[-1])))
    apart = float(np.linalg.norm(onward.vertices_en_m[0] - road.vertices_en_m[-1]))
    return turn if turn < JOINT_RAD and apart < JOINT_M else np.inf


class LaneGround:
    """The ground of the lanes of a network: points along every lane, 1 m apart, with half of the lane width."""

    def __init__(self, network: RoadNetwork, members: list[Corridor], extent_m: float) -> None:
        chain_of = {corridor.edge: corridor.chain for corridor in members}
        points, half, chain = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for edge, lanes in edges_of(network):
            for lane in lanes:
                reach = min(float(lane.length), extent_m + BEYOND_M)
                s = np.linspace(0.0, reach, max(2, int(np.ceil(reach / SAMPLE_M)) + 1))
                points.append(lane_points(lane, s))
                half.append(np.array([0.5 * float(lane.width_at(float(x))) for x in s]))
                chain.append(np.full(s.size, chain_of[edge]))
        self.points_en_m: Array = np.concatenate(points)
        self.half_m: Array = np.concatenate(half)
        self.chain: NDArray[np.int64] = np.concatenate(chain)
        self._taken: Array = np.zeros((0, 4, 2))
        self._tree = cKDTree(self.points_en_m)
        self._widest_m = float(self.half_m.max(initial=0.0))

    def plot(self, corridor: Corridor) -> CorridorPlot:
        """The ground beside a corridor."""
        return CorridorPlot(self, corridor)

    def clear(self, foot: Array) -> NDArray[np.bool_]:
        """Whether no lane is within 1 m of footprints.  (n, 4, 2) [m] -> (n,)."""
        return ~self._meets(foot, self.half_m + CLEARANCE_M)

    def crossed(self, strip: Array, chain: int) -> NDArray[np.bool_]:
        """Whether a lane of another chain of edges crosses strips.  (n, 4, 2) [m] -> (n,)."""
        return self._meets(strip, np.where(self.chain == chain, -np.inf, self.half_m - OVERLAP_M))

    def claim(self, foot: Array) -> bool:
        """Reserve the ground of one building (4, 2) unless it is occupied; returns whether it was free."""
        if len(self._taken) and _overlap(foot, self._taken).any():
            return False
        self._taken = np.concatenate([self._taken, foot[None]])
        return True

    def _meets(self, foot: Array, reach_m: Array) -> NDArray[np.bool_]:
        """Whether a point is closer than its reach to the rectangles (n, 4, 2).  -> (n,)."""
        if not len(foot):
            return np.zeros(0, dtype=np.bool_)
        radius = np.linalg.norm(foot - foot.mean(1, keepdims=True), axis=-1).max(-1) + self._widest_m + 2 * CLEARANCE_M
        near = self._tree.query_ball_point(foot.mean(1), radius)
        owner = np.repeat(np.arange(len(foot)), [len(k) for k in near])
        index = np.array([i for k in near for i in k], dtype=np.int64)
        hit = _distance(foot[owner], self.points_en_m[index]) < reach_m[index]
        return np.asarray(np.bincount(owner[hit], minlength=len(foot)) > 0)


@dataclass(frozen=True)
class CorridorPlot:
    """The free ground beside a corridor: a :class:`~lanebound.integrity.sky.city.Plot`."""

    ground: LaneGround
    corridor: Corridor

    def clear(self, foot: Array) -> NDArray[np.bool_]:
        """Whether no lane is within 1 m of footprints.  (n, 4, 2) [m] -> (n,)."""
        return self.ground.clear(foot)

    def take(self, foot: Array, strip: Array) -> NDArray[np.bool_]:
        """Whether a building fits: no overlap with lanes and other buildings, and no other road in front of it.

        The buildings beyond another road belong to that road.
        """
        may = self.ground.clear(foot) & ~self.ground.crossed(strip, self.corridor.chain)
        for k in np.flatnonzero(may):
            may[k] = self.ground.claim(foot[k])
        return may


def _overlap(one: Array, many: Array) -> NDArray[np.bool_]:
    """Whether a rectangle (4, 2) overlaps others (n, 4, 2) by more than 0.3 m (separating axis test).  -> (n,)."""
    apart = np.zeros(len(many), dtype=np.bool_)
    for a, b in ((0, 1), (1, 2)):
        for sides in (one[None], many):
            axis = sides[:, b] - sides[:, a]
            axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
            p, q = ((corners * axis[:, None]).sum(-1) for corners in (one[None], many))
            apart |= np.minimum(p.max(-1), q.max(-1)) - np.maximum(p.min(-1), q.min(-1)) < OVERLAP_M
    return ~apart


def _distance(rectangle: Array, point: Array) -> Array:
    """Distance from rectangles (n, 4, 2), corners in order, to points (n, 2).  -> (n,) [m], 0 inside."""
    d = point - rectangle.mean(1)
    square = np.zeros(len(d))
    for a, b in ((0, 1), (1, 2)):
        side = rectangle[:, b] - rectangle[:, a]
        length = np.linalg.norm(side, axis=-1)
        along = np.abs((d * side).sum(-1)) / np.maximum(length, 1e-9)
        square += np.maximum(along - 0.5 * length, 0.0) ** 2
    return np.asarray(np.sqrt(square))
