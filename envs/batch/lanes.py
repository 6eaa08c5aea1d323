"""The lanes of a road network as the records of :mod:`.lanes_kernel`, made once for all networks of the same lanes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import ceil, cos, hypot, inf, sin
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.batch import lanes_kernel as lk
from lanebound.envs.batch.conflict_kernel import CROSSING_COS
from lanebound.envs.batch.lanes_kernel import Lanes
from lanebound.envs.batch.next_lane_kernel import STEP, beyond
from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.lanes import CurveLane
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["LaneTable", "lane_table"]

NODE_STEP_M = 2.0  # of sampled centrelines: 1e-5 m of error on a radius of 15 m
REMEMBERED = 64  # networks
JOINED_M = 1.0  # beside a lane that goes on from another; farther, a car changes lanes
NO_ROUTE = np.array([(lk.NONE, lk.NONE)], STEP)

Row = list[Any]
Joint = tuple[int, bool]
_tables: OrderedDict[Any, Any] = OrderedDict()


@dataclass(frozen=True, eq=False)
class LaneTable:
    """The lanes of a network, by row and by highway-env's index.

    Attributes
    ----------
    lanes : the records
    index : of each row; road by road, from the left
    row : of each index
    """

    lanes: Lanes
    index: tuple[LaneIndex, ...]
    row: dict[LaneIndex, int]

    @cached_property
    def has_crossings(self) -> bool:
        """Whether any lanes cross each other."""
        return bool(self.lanes.table["crossed"].any())

    def __deepcopy__(self, memo: dict[int, Any]) -> LaneTable:
        """The table itself: nothing in it changes."""
        return self


def lane_table(network: RoadNetwork) -> LaneTable:
    """The table of a network; networks of equal lanes share one."""
    roads = [(a, b, row) for a, ends in network.graph.items() for b, row in ends.items()]
    parts = [_content(lane) for _, _, row in roads for lane in row]
    goal, objects = getattr(network, "goal", None), getattr(network, "geo_objects", {})
    key: Any = (tuple((a, b, len(row)) for a, b, row in roads), tuple(parts), goal, tuple(objects.items()))
    known = None not in parts
    table = _tables.get(key) if known else None
    if table is None:
        table = _build(roads)
        if goal is not None:
            _show_way(table, goal)
        for (a, b), k in objects.items():
            table.lanes.table["geo_object"][[table.row[a, b, i] for i in range(len(network.graph[a][b]))]] = k
        if known:
            _tables[key] = table
            if len(_tables) > REMEMBERED:
                _tables.popitem(last=False)
    return table


def _content(lane: AbstractLane) -> Any:
    """What a lane of a known class is made of; None for other classes."""
    kind = type(lane)
    facts = lane.speed_limit, lane.forbidden
    if kind is CurveLane:
        return kind, lane.path, lane.offset_m, lane.width, facts
    if kind is CircularLane:
        shape = lane.center.tobytes(), lane.radius, lane.start_phase, lane.length, lane.direction
        return kind, shape, lane.width, facts
    if kind is StraightLane:
        return kind, lane.start.tobytes(), lane.end.tobytes(), lane.width, facts
    if kind is SineLane:
        wave = lane.amplitude, lane.pulsation, lane.phase
        return kind, lane.start.tobytes(), lane.end.tobytes(), wave, lane.width, facts
    return None


def _build(roads: list[tuple[str, str, Row]]) -> LaneTable:
    first = np.cumsum([0, *(len(row) for _, _, row in roads)]).tolist()
    index = tuple((a, b, i) for a, b, row in roads for i in range(len(row)))
    table = np.zeros(len(index), lk.LANE)
    parts = _Parts()
    for k, (_, _, row) in enumerate(roads):
        leading, onward = _joints(roads, first, k)
        joints = parts.joints.add(leading + onward)
        for i, lane in enumerate(row):
            entry = table[first[k] + i]
            entry["side"], entry["road"], entry["count"] = i, first[k], len(row)
            entry["joint_first"], entry["joint_last"] = joints
            entry["joint_onward"] = joints[0] + len(leading)
            _fill(entry, lane, parts)
    table["onward"], table["geo_object"] = _onward(roads, first), lk.NONE
    table["crossed"] = _crossed([lane for _, _, row in roads for lane in row], table["road"])
    return LaneTable(Lanes(table, *parts.arrays), index, {lane: n for n, lane in enumerate(index)})


def _show_way(table: LaneTable, goal: tuple[str, str]) -> None:
    """Fill ``goal_shift`` and ``lost`` of the lanes of a network, as a navigation system has them for a goal.

    From each lane a car goes on to the lane ahead, without a change or, where its lane ends, with one. The way with the
    fewest changes counts, of equal ones that with the earliest.
    """
    lanes, records = table.lanes, table.lanes.table
    first, reached = records["road"], table.row[(*goal, 0)]
    ahead = [beyond(lanes, NO_ROUTE, 0, n) for n in range(len(records))]
    gap_m = [0.0 if m == lk.NONE else _gap_m(lanes, n, m) for n, m in enumerate(ahead)]
    changes = np.where(first == reached, 0.0, inf)
    for _ in records:  # each round finds the ways of one more road
        onward = np.array(
            [inf if m == lk.NONE else changes[m] + (gap > JOINED_M) for m, gap in zip(ahead, gap_m, strict=True)]
        )
        for n in np.flatnonzero(first != reached):
            others = np.arange(first[n], first[n] + records["count"][n])
            far = onward[others] + np.abs(others - n)
            changes[n] = far.min()
            best = others[far == changes[n]]
            records["goal_shift"][n] = best[np.argmax(np.abs(best - n))] - n if changes[n] < inf else 0
    records["lost"] = changes == inf


def _gap_m(lanes: Lanes, n: int, onward: int) -> float:
    """How far the end of a lane lies beside the lane onward [m]."""
    x, y = lk.place(lanes, n, lanes.table["length_m"][n], 0.0)
    return abs(float(lk.local(lanes, onward, x, y)[1]))


def _crossed(lanes: Row, road: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which lanes overlap one of another road at an angle, by points of their centrelines 2 m apart."""
    poses = []
    for lane in lanes:
        stations = np.linspace(0.0, lane.length, ceil(lane.length / NODE_STEP_M) + 1)
        poses.append(np.array([(*lane.position(s, 0.0), lane.heading_at(s)) for s in stations]))
    low, high = (np.array([of(p[:, :2], axis=0) for p in poses]) for of in (np.min, np.max))
    out = np.zeros(len(lanes), dtype=np.bool_)
    for a, b in combinations(range(len(lanes)), 2):
        reach = 0.5 * (lanes[a].width_at(0.0) + lanes[b].width_at(0.0))
        if road[a] == road[b] or np.any(low[a] - high[b] > reach) or np.any(low[b] - high[a] > reach):
            continue
        away = poses[a][:, None, :] - poses[b][None, :, :]
        beside = np.hypot(away[..., 0], away[..., 1]) < reach
        if np.any(beside & (np.cos(away[..., 2]) < CROSSING_COS)):
            out[a] = out[b] = True
    return out


class _Column:
    """Rows that lanes refer to by the first and the one past the last."""

    def __init__(self, kind: Any) -> None:
        self.kind, self.rows = kind, list[Any]()

    def add(self, rows: Iterable[Any]) -> tuple[int, int]:
        begin = len(self.rows)
        self.rows.extend(rows)
        return begin, len(self.rows)

    @property
    def array(self) -> Any:
        return np.array(self.rows, dtype=self.kind)


class _Parts:
    """What is beside the table of lanes; paths are added once."""

    def __init__(self) -> None:
        self.cells, self.nodes, self.near = _Column(lk.CELL), _Column(lk.NODE), _Column(np.int64)
        self.joints, self.advice = _Column(lk.JOINT), _Column(np.float64)
        self._paths: dict[Any, tuple[tuple[int, int], int]] = {}

    def path(self, path: Any) -> tuple[tuple[int, int], int]:
        """First and last cell of a path, and the first entry of its grid."""
        found = self._paths.get(path)
        if found is None:
            poses = path.pose[:-1]
            cells = zip(poses, path.kappa, path.slope, path.span, path.station[:-1], strict=True)
            rows = self.cells.add((*pose, *rest) for pose, *rest in cells)
            grid = self.near.add(np.array(path.near, dtype=np.int64).ravel().tolist())
            found = self._paths[path] = rows, grid[0]
        return found

    @property
    def arrays(self) -> tuple[Any, ...]:
        columns = self.cells, self.nodes, self.near, self.joints, self.advice
        return tuple(column.array for column in columns)


def _fill(entry: Any, lane: AbstractLane, parts: _Parts) -> None:
    """The geometry of a lane."""
    kind = type(lane)
    entry["x_m"], entry["y_m"] = lane.position(0.0, 0.0)
    entry["heading_rad"], entry["length_m"] = lane.heading_at(0.0), lane.length
    entry["width_m"], entry["speed_limit_mps"] = lane.width_at(0.0), lane.speed_limit or 0.0
    entry["forbidden"] = bool(lane.forbidden)
    if kind is StraightLane or kind is SineLane:
        (entry["x_m"], entry["y_m"]), (entry["east"], entry["south"]) = lane.start, lane.direction
    if kind is SineLane:
        entry["kind"], entry["phase_rad"] = lk.SINE, lane.phase
        entry["amplitude_m"], entry["pulsation_radpm"] = lane.amplitude, lane.pulsation
    elif kind is CircularLane:
        entry["kind"], entry["phase_rad"], entry["turn"] = lk.CIRCLE, lane.start_phase, lane.direction
        (entry["centre_x_m"], entry["centre_y_m"]), entry["radius_m"] = lane.center, lane.radius
    elif kind is CurveLane:
        path = lane.path
        (entry["cell_first"], entry["cell_last"]), entry["grid_first"] = parts.path(path)
        entry["kind"], entry["offset_m"] = lk.CURVE, lane.offset_m
        entry["grid_x_m"], entry["grid_y_m"] = path.grid_m
        entry["grid_columns"], entry["grid_rows"] = len(path.near), len(path.near[0])
        speeds = [lane.advised_speed(k * lk.ADVICE_STEP_M) for k in range(int(lane.length / lk.ADVICE_STEP_M) + 2)]
        entry["advice_first"], entry["advice_last"] = parts.advice.add(speeds)
    elif kind is not StraightLane:
        entry["kind"] = lk.SAMPLED
    if kind is SineLane or kind is CircularLane:
        _enclose(entry, lane)
    if kind is not StraightLane and kind is not CircularLane:
        nodes = _nodes(lane)
        entry["node_first"], last = parts.nodes.add(nodes)
        entry["node_count"], entry["node_step_m"] = last - entry["node_first"], lane.length / len(nodes)


def _enclose(entry: Any, lane: AbstractLane) -> None:
    """The squares about a sine or circular lane: all that it holds by a margin of 1 m, and half a metre more."""
    points = np.array(
        [lane.position(s, 0.0) for s in np.linspace(0.0, lane.length, ceil(lane.length / NODE_STEP_M) + 1)]
    )
    slope = float(abs(entry["amplitude_m"] * entry["pulsation_radpm"]))
    reach = 0.5 * entry["width_m"] + 1.5 + lk.PAST_END_M * (1.0 + slope)
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    entry["grid_x_m"], entry["grid_y_m"] = low
    entry["grid_columns"], entry["grid_rows"] = np.ceil((high - low) / lk.SQUARE_M).astype(np.int64)


def _nodes(lane: AbstractLane) -> list[Any]:
    """The centreline in pieces of about ``NODE_STEP_M``, cubic Hermite in the share of the step."""
    count = max(1, ceil(lane.length / NODE_STEP_M))
    step = lane.length / count
    poses = [(*map(float, lane.position(k * step, 0.0)), float(lane.heading_at(k * step))) for k in range(count + 1)]
    out = []
    for k in range(count):
        (xa, ya, ha), (xb, yb, hb) = poses[k], poses[k + 1]
        dx, dy, turn = xb - xa, yb - ya, wrap_angle(hb - ha)
        chord = hypot(dx, dy)
        arc = chord * 0.5 * turn / sin(0.5 * turn) if turn else chord
        ax, ay, bx, by = arc * cos(ha), arc * sin(ha), arc * cos(hb), arc * sin(hb)
        cubic_x = (xa, ax, 3.0 * dx - 2.0 * ax - bx, ax + bx - 2.0 * dx)
        cubic_y = (ya, ay, 3.0 * dy - 2.0 * ay - by, ay + by - 2.0 * dy)
        curvature = turn / arc if arc > 0.0 else 0.0
        out.append((cubic_x, cubic_y, ha, turn, curvature, float(lane.width_at(k * step))))
    return out


def _joints(roads: list[tuple[str, str, Row]], first: list[int], k: int) -> tuple[list[Joint], list[Joint]]:
    """The roads that lead to a road, those that go on from it, and whether all their lanes count (junctions)."""
    start, end, row = roads[k]
    leading = [n for n, (_, b, _) in enumerate(roads) if b == start]
    onward = [n for n, (a, _, _) in enumerate(roads) if a == end]
    junction = len(leading) > 1
    return (
        [(first[n], junction or len(roads[n][2]) != len(row)) for n in leading],
        [(first[n], len(roads[n][2]) != len(row)) for n in onward],
    )


def _onward(roads: list[tuple[str, str, Row]], first: list[int]) -> NDArray[np.int64]:
    """The lane of the same number on the only road that goes on, ``NONE`` where there is none, or more than one."""
    out = []
    for _, end, row in roads:
        after = [n for n, (a, _, _) in enumerate(roads) if a == end]
        for i in range(len(row)):
            on = len(after) == 1 and i < len(roads[after[0]][2])
            out.append(first[after[0]] + i if on else lk.NONE)
    return np.array(out, dtype=np.int64)
