"""Which lanes an ego is to follow: paths over a road network, made when first needed and kept for equal networks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.road import RoadNetwork

from lanebound.envs.batch.lanes import LaneTable, lane_table
from lanebound.envs.batch.lanes_kernel import centre
from lanebound.envs.batch.route_map_kernel import PATH, PIECE, RouteMap
from lanebound.envs.records import LaneIndex
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["Reach", "Routes", "Step", "routes_of"]

CONTINUES_M = 2.5  # lanes that lie closer than this at a joint are one; a roundabout's entry of highway-env has 2.1
OVERLAP_M = 10.0  # by which lanes may overlap, or miss each other, at a joint; highway-env's have up to 5
MAX_LANES = 64  # of one path, against lanes of no length
SPARE_M = 50.0  # of lanes for the sky ahead, beyond the farthest place that is predicted

Step = tuple[str, str, int | None]
Places = list[tuple[float, int]]


class Reach(NamedTuple):
    """How far paths are looked up: behind the start and ahead of the end of the ego's lane, and for the sky [m]."""

    behind_m: float
    ahead_m: float
    sky_m: float


class _Joint(NamedTuple):
    """Where a lane ends in the coordinates of another: along and beside that one [m], and how far it turns [rad]."""

    into_m: float
    aside_m: float
    turn_rad: float

    @property
    def goes_on(self) -> bool:
        """Whether a vehicle that follows one lane comes onto the other without changing lanes or turning back."""
        return abs(self.aside_m) <= CONTINUES_M and self.leads_on

    @property
    def leads_on(self) -> bool:
        """Whether a vehicle may follow the other lane, if need be by changing lanes."""
        return abs(self.into_m) <= OVERLAP_M and abs(self.turn_rad) < 0.5 * pi


class Routes:
    """Paths over one road network: a row for each lane and planned route, found once.

    Parameters
    ----------
    network, table : a road network of highway-env, and its lanes
    reach : how far paths are looked up

    Attributes
    ----------
    map : the paths found so far, as the kernels read them; another one after each path that is found
    """

    def __init__(self, network: RoadNetwork, table: LaneTable, reach: Reach) -> None:
        self.table, self.reach = table, reach
        self._graph, self._network = network.graph, network
        self._rows: dict[tuple[int, tuple[Step, ...]], int] = {}
        self._paths: list[tuple[Any, ...]] = []
        self._pieces: list[tuple[float, float, int]] = []
        self._following: list[int] = []
        self._ahead: list[int] = []
        self._into: dict[str, list[str]] = {}
        for node, roads in network.graph.items():
            for to in roads:
                self._into.setdefault(to, []).append(node)
        self.map = self._arrays()

    def __deepcopy__(self, memo: dict[int, Any]) -> Routes:
        """The same object: paths are added, none is changed."""
        return self

    def row(self, lane: int, route: Sequence[Step] | None = None) -> int:
        """The row of the path from a lane on: along the route, or else into the nearest lane that begins at its end."""
        key = lane, tuple(route) if route else ()
        found = self._rows.get(key)
        if found is None:
            found = self._rows[key] = self._build(*key)
            self.map = self._arrays()
        return found

    def rows(self, route: Sequence[Step]) -> list[int]:
        """The rows of the paths from all lanes along a route."""
        keys = [(lane, tuple(route)) for lane in range(len(self.table.index))]
        for key in keys:
            if key not in self._rows:
                self._rows[key] = self._build(*key)
        self.map = self._arrays()
        return [self._rows[key] for key in keys]

    def all_lanes(self) -> RouteMap:
        """The paths from all lanes without a planned route: row n is that of lane n.

        Raises
        ------
        RuntimeError
            Other paths were asked for first.
        """
        for lane in range(len(self.table.index)):
            if self._rows.setdefault((lane, ()), lane) != lane:
                raise RuntimeError("all_lanes must come before paths of routes")
            if lane == len(self._paths):
                self._build(lane, ())
        self.map = self._arrays()
        return self.map

    def _arrays(self) -> RouteMap:
        columns = (self._paths, PATH), (self._pieces, PIECE), (self._following, np.int64), (self._ahead, np.int64)
        arrays: list[Any] = [np.array(rows, dtype=kind) for rows, kind in columns]
        return RouteMap(*arrays)

    def _build(self, lane: int, route: tuple[Step, ...]) -> int:
        after, lane_end_m = self._follow(lane, route)
        before = self._before(lane)
        rows = [*before, *after]
        ends = [origin + self._length(n) for origin, n in rows]
        for i in range(len(before)):
            ends[i] = min(ends[i], rows[i + 1][0])
        first = len(self._pieces), len(self._following), len(self._ahead)
        self._pieces += [(end, origin, n) for end, (origin, n) in zip(ends, rows, strict=True)]
        self._following += [n for _, n in after]
        self._ahead += self._lanes_ahead(lane, route)
        stations = self._length(lane), lane_end_m, rows[0][0], ends[-1]
        spans = (first[0], len(self._pieces) - 1), (first[1], len(self._following)), (first[2], len(self._ahead))
        self._paths.append((*self._facts(lane), *stations, *(row for span in spans for row in span)))
        return len(self._paths) - 1

    def _length(self, lane: int) -> float:
        return float(self.table.lanes.table["length_m"][lane])

    def _facts(self, lane: int) -> tuple[float, float, float, float]:
        """Share of the lane, whether there are lanes to the left and right, speed limit."""
        start, end, place = self.table.index[lane]
        lanes = self._graph[start][end]
        last, limit = len(lanes) - 1, lanes[place].speed_limit
        left = place > 0 and not lanes[place - 1].forbidden
        right = place < last and not lanes[place + 1].forbidden
        return place / last if last else 0.0, float(left), float(right), inf if limit is None else float(limit)

    # The lanes that are followed

    def _follow(self, lane: int, route: tuple[Step, ...]) -> tuple[Places, float]:
        """The lanes from ``lane`` on, each with the station of its start, and the station where the lane ends."""
        followed, lane_end = [(0.0, lane)], inf
        station = self._length(lane)
        reach = station + self.reach.ahead_m
        while True:
            after, route = self._next(lane, route)
            joint = None if after is None else self._joint(lane, after)
            if lane_end == inf and (joint is None or not joint.goes_on):
                lane_end = station
            far = station >= reach or len(followed) == MAX_LANES
            if far or after is None or joint is None or not joint.leads_on:
                return followed, lane_end
            followed.append((station - joint.into_m, after))
            lane = after
            station += self._length(after) - joint.into_m

    def _next(self, lane: int, route: tuple[Step, ...]) -> tuple[int | None, tuple[Step, ...]]:
        """The lane after this one and what is left of the route there; where the route ends, the nearest lane."""
        index = self.table.index[lane]
        node = index[1]
        roads = self._graph.get(node) or {}
        route = _rest(index, route)
        if route and route[0][0] == node and route[0][1] in roads:
            to, place = route[0][1:]
            return self.table.row[node, to, self._enter(lane, to, place)[0]], route
        if not roads:
            return None, ()
        near = {to: self._enter(lane, to, None) for to in roads}
        to = min(near, key=lambda name: round(near[name][1], 6))
        return self.table.row[node, to, near[to][0]], ()

    def _enter(self, lane: int, to: str, place: int | None) -> tuple[int, float]:
        """Which lane of the road to node ``to`` a vehicle enters from the end of its lane, and how far it lies off."""
        position = np.array(self._end(lane)[:2])
        entered, distance = self._network.next_lane_given_next_road(*self.table.index[lane], to, place, position)
        return int(entered), float(distance)

    def _end(self, lane: int) -> tuple[float, float, float]:
        """The last point of a lane's centreline, and its direction there."""
        x, y, heading, _ = centre(self.table.lanes, lane, self._length(lane))
        return x, y, heading

    def _joint(self, lane: int, after: int) -> _Joint:
        """Where the end of one lane lies on another."""
        x, y, heading = self._end(lane)
        other = self._network.get_lane(self.table.index[after])
        into, aside = other.local_coordinates(np.array([x, y]))
        return _Joint(float(into), float(aside), wrap_angle(float(other.heading_at(into)) - heading))

    def _before(self, lane: int) -> Places:
        """The lanes that lead here without a step, the nearest last, each with the station of its start."""
        out: Places = []
        start = 0.0
        while start > -self.reach.behind_m and len(out) < MAX_LANES:
            begin = self.table.index[lane][0]
            lanes = [
                self.table.row[node, begin, i]
                for node in self._into.get(begin, ())
                for i in range(len(self._graph[node][begin]))
            ]
            joints = {n: self._joint(n, lane) for n in lanes}
            on = [n for n in lanes if joints[n].goes_on]
            if not on:
                break
            best = min(on, key=lambda n: (round(abs(joints[n].aside_m) + abs(joints[n].turn_rad), 6), self._bend(n)))
            start += joints[best].into_m - self._length(best)
            out.append((start, best))
            lane = best
        return out[::-1]

    def _bend(self, lane: int) -> float:
        """By how much a lane changes its direction: of lanes that join equally well the straightest comes first."""
        return round(abs(wrap_angle(self._end(lane)[2] - float(self.table.lanes.table["heading_rad"][lane]))), 6)

    # The lanes by which the sky is predicted

    def _lanes_ahead(self, lane: int, route: tuple[Step, ...]) -> list[int]:
        """The lanes from ``lane`` on by highway-env's rule: along the route, else the first road onward."""
        onward = {step[0]: step[1] for step in route}
        out, left = [lane], self.reach.sky_m + SPARE_M
        while left > 0.0 and len(out) < MAX_LANES:
            node = self.table.index[lane][1]
            roads = [to for to, lanes in self._graph.get(node, {}).items() if lanes]
            if not roads:
                break
            wanted = onward.get(node)
            lane = self._beside(lane, wanted if wanted is not None and wanted in roads else roads[0])
            out.append(lane)
            left -= self._length(lane)
        return out

    def _beside(self, lane: int, to: str) -> int:
        """The lane of the same number on a road with as many lanes, else the lane that begins nearest."""
        start, node, i = self.table.index[lane]
        lanes, others = self._graph[start][node], self._graph[node][to]
        if len(others) != len(lanes):
            last = lanes[i].position(lanes[i].length, 0.0)
            i = int(np.argmin([float(np.linalg.norm(other.position(0.0, 0.0) - last)) for other in others]))
        return self.table.row[node, to, i]


def _rest(index: LaneIndex, route: tuple[Step, ...]) -> tuple[Step, ...]:
    """What of a route lies ahead of a lane: the steps after its road, or from its end on."""
    for i, (start, to, _) in enumerate(route):
        if (start, to) == index[:2]:
            return route[i + 1 :]
        if start == index[1]:
            return route[i:]
    return ()


@lru_cache(maxsize=64)
def _shared(table: LaneTable, reach: Reach) -> list[Routes]:
    """A place for the paths over the networks that share a table."""
    return []


def routes_of(network: RoadNetwork, reach: Reach) -> Routes:
    """The paths over a network, shared by all networks of equal lanes."""
    table = lane_table(network)
    shared = _shared(table, reach)
    if not shared:
        shared.append(Routes(network, table, reach))
        shared[0].all_lanes()
    return shared[0]
