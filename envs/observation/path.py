"""The lanes that the ego is to follow as one line: points ahead of it, and where other vehicles are beside it.

Frame ``xy`` of :mod:`lanebound.envs.records`: headings clockwise seen from above, offsets and curvatures positive to
the right. Stations are longitudinal coordinates of the ego's lane, carried on over the lanes before and after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, hypot, inf, pi, sin
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import CircularLane, StraightLane
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex

__all__ = ["Line", "Path", "PathPoint", "RoadMap", "SampledLine", "line_of", "wrap"]

STEP_M = 2.0  # between nodes of a sampled line: 1e-5 m of error on a radius of 15 m
CONTINUES_M = 2.5  # lanes that lie closer than this at a joint are one; a roundabout's entry of highway-env has 2.1
OVERLAP_M = 10.0  # by which lanes may overlap, or miss each other, at a joint; highway-env's have up to 5
NEAR_CURVED_M, NEAR_STRAIGHT_M = 0.1, 1.0  # last step of a projection: the offset is then wrong by step^2 / 2R
MAX_LANES = 64  # of one path, against lanes of no length
PROJECTIONS = 6

Step = tuple[str, str, int | None]
PathPoint = tuple[float, float, float, float]  # x, y, heading, curvature


class LaneFacts(NamedTuple):
    """What the map says of a lane.

    Attributes
    ----------
    share : number over that of the road's last lane, 0 for a single one
    left_exists, right_exists : 1.0 when a lane that may be entered lies there
    speed_limit_mps : inf when there is none
    """

    share: float
    left_exists: float
    right_exists: float
    speed_limit_mps: float


def wrap(angle_rad: float) -> float:
    """The angle in [-pi, pi)."""
    return (angle_rad + pi) % (2.0 * pi) - pi


class Line:
    """Centreline of one lane, straight, in plain numbers; the base of the others."""

    __slots__ = ("heading", "length", "ux", "uy", "x", "y")

    def __init__(self, lane: Any) -> None:
        self.length = float(lane.length)
        self.x, self.y = (float(v) for v in lane.position(0.0, 0.0))
        self.heading = float(lane.heading_at(0.0))
        self.ux, self.uy = cos(self.heading), sin(self.heading)

    @property
    def end(self) -> PathPoint:
        """Where the lane ends."""
        return self.at(self.length)

    def at(self, s: float) -> PathPoint:
        """The point at station ``s`` [m] of the lane."""
        return self.x + s * self.ux, self.y + s * self.uy, self.heading, 0.0


class _Arc(Line):
    """Centreline of a circular lane."""

    __slots__ = ("curvature", "cx", "cy")

    def __init__(self, lane: Any) -> None:
        super().__init__(lane)
        self.curvature = lane.direction / float(lane.radius)
        self.cx = self.x - self.uy / self.curvature
        self.cy = self.y + self.ux / self.curvature

    def at(self, s: float) -> PathPoint:
        heading = self.heading + s * self.curvature
        x = self.cx + sin(heading) / self.curvature
        return x, self.cy - cos(heading) / self.curvature, heading, self.curvature


class SampledLine(Line):
    """Centreline of any other lane: cubic Hermite between nodes that are asked of the lane when first needed."""

    __slots__ = ("lane", "last", "nodes", "pieces", "step")

    def __init__(self, lane: Any) -> None:
        super().__init__(lane)
        self.lane = lane
        self.last = max(1, ceil(self.length / STEP_M)) - 1
        self.step = self.length / (self.last + 1)
        self.nodes: dict[int, tuple[float, float, float]] = {}
        self.pieces: dict[int, tuple[float, ...]] = {}

    def _node(self, k: int) -> tuple[float, float, float]:
        node = self.nodes.get(k)
        if node is None:
            s = k * self.step
            x, y = self.lane.position(s, 0.0)
            node = self.nodes[k] = (float(x), float(y), float(self.lane.heading_at(s)))
        return node

    def _piece(self, k: int) -> tuple[float, ...]:
        """Coefficients of both cubics in the share of the step, heading at the start, its change, curvature."""
        (xa, ya, ha), (xb, yb, hb) = self._node(k), self._node(k + 1)
        dx, dy, turn = xb - xa, yb - ya, wrap(hb - ha)
        chord = hypot(dx, dy)
        arc = chord * 0.5 * turn / sin(0.5 * turn) if turn else chord
        ax, ay, bx, by = arc * cos(ha), arc * sin(ha), arc * cos(hb), arc * sin(hb)
        cubic_x = (xa, ax, 3.0 * dx - 2.0 * ax - bx, ax + bx - 2.0 * dx)
        cubic_y = (ya, ay, 3.0 * dy - 2.0 * ay - by, ay + by - 2.0 * dy)
        piece = self.pieces[k] = (*cubic_x, *cubic_y, ha, turn, turn / arc if arc > 0.0 else 0.0)
        return piece

    def all_pieces(self) -> NDArray[np.float64]:
        """Every piece in a row: the coefficients of x and of y, heading at the start, its change, curvature."""
        return np.array([self.pieces.get(k) or self._piece(k) for k in range(self.last + 1)])

    def at(self, s: float) -> PathPoint:
        if not 0.0 <= s <= self.length:
            return _drawn_on(self.at(0.0), s) if s < 0.0 else _drawn_on(self.at(self.length), s - self.length)
        k = min(int(s // self.step), self.last)
        x0, x1, x2, x3, y0, y1, y2, y3, heading, turn, curvature = self.pieces.get(k) or self._piece(k)
        u = s / self.step - k
        return x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3)), heading + u * turn, curvature


def line_of(lane: Any) -> Line:
    """The centreline of a lane of highway-env: exact for straight and circular ones, sampled for any other."""
    if type(lane) is StraightLane:
        return Line(lane)
    return _Arc(lane) if type(lane) is CircularLane else SampledLine(lane)


class Joint(NamedTuple):
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


class Path:
    """Centrelines in a row, stations counted from the start of the ego's lane.

    Attributes
    ----------
    lane : what the map says of the ego's lane
    start_m, end_m : stations between which the map was followed
    junction_m : station where the ego's lane ends
    lane_end_m : station where no lane goes on from the last; inf when that lies beyond what was looked up
    following : lanes from the ego's on, in order
    """

    __slots__ = ("_pieces", "end_m", "following", "junction_m", "lane", "lane_end_m", "start_m")

    def __init__(
        self,
        before: Sequence[tuple[float, Line]],
        after: Sequence[tuple[float, Line]],
        following: Sequence[LaneIndex],
        lane_end_m: float,
        lane: LaneFacts,
    ) -> None:
        rows = [*before, *after]
        ends = [origin + line.length for origin, line in rows]
        for i in range(len(before)):
            ends[i] = min(ends[i], rows[i + 1][0])
        self._pieces = [(end, origin, line) for end, (origin, line) in zip(ends, rows, strict=True)]
        self.start_m, self.end_m, self.lane_end_m = rows[0][0], ends[-1], lane_end_m
        self.following, self.junction_m, self.lane = tuple(following), after[0][1].length, lane

    @property
    def pieces(self) -> list[tuple[float, float, Line]]:
        """The lines in order, each with the stations where its part of the path ends and where the line begins."""
        return self._pieces

    def at(self, station_m: float) -> PathPoint:
        """The point at a station; drawn on straight before the first lane and beyond the last."""
        if station_m < self.start_m:
            return _drawn_on(self._pieces[0][2].at(0.0), station_m - self.start_m)
        for end, origin, line in self._pieces:
            if station_m < end:
                return line.at(station_m - origin)
        return _drawn_on(line.end, station_m - end)

    def project(self, x: float, y: float, guess_m: float) -> tuple[float, float] | None:
        """Station and offset to the right of a point, found from a guess by Newton's steps; None when not beside it.

        A step ``along / (1 - curvature offset)`` leaves an error of second order, so the last one is taken unchecked.
        """
        station = guess_m
        for _ in range(PROJECTIONS):
            px, py, heading, curvature = self.at(station)
            dx, dy, c, s = x - px, y - py, cos(heading), sin(heading)
            along, offset = dx * c + dy * s, dy * c - dx * s
            station += along / max(1.0 - curvature * offset, 0.5)
            near = NEAR_CURVED_M if curvature else NEAR_STRAIGHT_M
            if -near < along < near:
                return station, offset
        return None


def _drawn_on(point: PathPoint, distance_m: float) -> PathPoint:
    x, y, heading, _ = point
    return x + distance_m * cos(heading), y + distance_m * sin(heading), heading, 0.0


class RoadMap:
    """Paths over one road network, kept once found.

    Parameters
    ----------
    network : a road network of highway-env, taken as it is for as long as this object lives
    behind_m, ahead_m : how far a path reaches behind the start and ahead of the end of the ego's lane
    """

    def __init__(self, network: Any, behind_m: float, ahead_m: float) -> None:
        self.network, self.behind_m, self.ahead_m = network, behind_m, ahead_m
        self._lines: dict[LaneIndex, Line] = {}
        self._paths: dict[tuple[LaneIndex, tuple[Step, ...]], Path] = {}
        self._into: dict[str, list[str]] = {}
        for node, roads in network.graph.items():
            for to in roads:
                self._into.setdefault(to, []).append(node)

    def path(self, lane_index: LaneIndex, route: Sequence[Step] | None = None) -> Path:
        """The path through a lane: on along the route, or else into the nearest lane that begins where one ends."""
        key = lane_index, tuple(route) if route else ()
        found = self._paths.get(key)
        if found is None:
            found = self._paths[key] = self._build(lane_index, key[1])
        return found

    def line(self, index: LaneIndex) -> Line:
        """The centreline of a lane."""
        line = self._lines.get(index)
        if line is None:
            line = self._lines[index] = line_of(self.network.get_lane(index))
        return line

    def _build(self, index: LaneIndex, route: tuple[Step, ...]) -> Path:
        after, lane_end_m = self._follow(index, route)
        lines = [(origin, self.line(lane)) for origin, lane in after]
        return Path(self._before(index), lines, [lane for _, lane in after], lane_end_m, self._facts(index))

    def _facts(self, index: LaneIndex) -> LaneFacts:
        lanes, place = self.network.graph[index[0]][index[1]], int(index[2])
        last, limit = len(lanes) - 1, lanes[place].speed_limit
        left = place > 0 and not lanes[place - 1].forbidden
        right = place < last and not lanes[place + 1].forbidden
        share = place / last if last else 0.0
        return LaneFacts(share, float(left), float(right), inf if limit is None else float(limit))

    def _follow(self, index: LaneIndex, route: tuple[Step, ...]) -> tuple[list[tuple[float, LaneIndex]], float]:
        """The lanes from ``index`` on, each with the station of its start, and the station where the lane ends."""
        following, lane_end = [(0.0, index)], inf
        station = self.line(index).length
        reach = station + self.ahead_m
        while True:
            after, route = self._next(index, route)
            joint = None if after is None else self._joint(index, after)
            if lane_end == inf and (joint is None or not joint.goes_on):
                lane_end = station
            far = station >= reach or len(following) == MAX_LANES
            if far or after is None or joint is None or not joint.leads_on:
                return following, lane_end
            following.append((station - joint.into_m, after))
            index = after
            station += self.line(after).length - joint.into_m

    def _next(self, index: LaneIndex, route: tuple[Step, ...]) -> tuple[LaneIndex | None, tuple[Step, ...]]:
        """The lane after this one and what is left of the route there; where it says nothing, the nearest lane."""
        node = index[1]
        roads = self.network.graph.get(node) or {}
        route = _rest(index, route)
        if route and route[0][0] == node and route[0][1] in roads:
            to, place = route[0][1:]
            return (node, to, self._enter(index, to, place)[0]), route
        if not roads:
            return None, ()
        near = {to: self._enter(index, to, None) for to in roads}
        to = min(near, key=lambda name: round(near[name][1], 6))
        return (node, to, near[to][0]), ()

    def _enter(self, index: LaneIndex, to: str, place: int | None) -> tuple[int, float]:
        """Which lane of the road to node ``to`` a vehicle enters from the end of its lane, and how far it lies off."""
        position = np.array(self.line(index).end[:2])
        entered, distance = self.network.next_lane_given_next_road(*index, to, place, position)
        return int(entered), float(distance)

    def _joint(self, index: LaneIndex, after: LaneIndex) -> Joint:
        """Where the end of one lane lies on another."""
        x, y, heading, _ = self.line(index).end
        lane = self.network.get_lane(after)
        into, aside = lane.local_coordinates(np.array([x, y]))
        return Joint(float(into), float(aside), wrap(float(lane.heading_at(into)) - heading))

    def _before(self, index: LaneIndex) -> list[tuple[float, Line]]:
        """The lanes that lead here without a step, the nearest last, each with the station of its start."""
        out: list[tuple[float, Line]] = []
        start = 0.0
        while start > -self.behind_m and len(out) < MAX_LANES:
            roads = [(node, index[0]) for node in self._into.get(index[0], ())]
            lanes = [(*road, i) for road in roads for i in range(len(self.network.graph[road[0]][road[1]]))]
            joints = {lane: self._joint(lane, index) for lane in lanes}
            on = [lane for lane in lanes if joints[lane].goes_on]
            if not on:
                break
            best = min(on, key=lambda lane: abs(joints[lane].aside_m) + abs(joints[lane].turn_rad))
            start += joints[best].into_m - self.line(best).length
            out.append((start, self.line(best)))
            index = best
        return out[::-1]


def _rest(index: LaneIndex, route: tuple[Step, ...]) -> tuple[Step, ...]:
    """What of a route lies ahead of a lane: the steps after its road, or from its end on."""
    for i, (start, to, _) in enumerate(route):
        if (start, to) == index[:2]:
            return route[i + 1 :]
        if start == index[1]:
            return route[i:]
    return ()
