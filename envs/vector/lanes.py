"""The lanes of a road network as the flat arrays of :mod:`.lanes_kernel`."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs.records import LaneIndex
from lanebound.envs.vector import lanes_kernel as lk
from lanebound.envs.vector.lanes_kernel import CELL_COLUMNS, Lanes
from lanebound.envs.worlds.lanes import ADVICE_STEP_M, CurveLane
from lanebound.integrity.core.errors import ConfigError

__all__ = ["lane_rows", "lanes_of"]

AT_REST = 1e-12  # headings and offsets of parallel straight lanes, equal but for rounding


def lane_rows(network: RoadNetwork) -> list[LaneIndex]:
    """The lane indices of a network in the order of its rows: road by road, from the left."""
    return [(a, b, i) for a, ends in network.graph.items() for b, row in ends.items() for i in range(len(row))]


def lanes_of(network: RoadNetwork) -> Lanes:
    """The arrays of a network of curved lanes, or of one straight road along x.

    Raises
    ------
    ConfigError
        Lanes of other kinds: the engine has no arrays for them.
    """
    edges = [(a, b, row) for a, ends in network.graph.items() for b, row in ends.items()]
    first = np.cumsum([0, *(len(row) for _, _, row in edges)])
    paths = [_path_of(row) for _, _, row in edges]
    joined = [_joined(edges, first, k) for k in range(len(edges))]
    begin = [np.cumsum([0, *sizes]) for sizes in zip(*((len(p[0]), p[2].size) for p in paths), strict=True)]
    ends = np.cumsum([0, *(len(rows) for rows in joined)])
    onward = _onward(network)
    advice = [_advice(lane) for _, _, row in edges for lane in row]
    heard = np.cumsum([0, *(len(speeds) for speeds in advice)])
    table = np.zeros((int(first[-1]), lk.LANE_COLUMNS))
    for k, (_, _, row) in enumerate(edges):
        _, low, grid = paths[k]
        for i, lane in enumerate(row):
            n = int(first[k]) + i
            values = {
                lk.OFFSET: _offset_m(lane), lk.WIDTH: lane.width_at(0.0), lk.LENGTH: lane.length,
                lk.LIMIT: lane.speed_limit or 0.0, lk.SIDE: i, lk.ROAD: first[k], lk.COUNT: len(row),
                lk.ONWARD: onward[n], lk.BEFORE: _index(onward, n),
                lk.JOINED_FIRST: ends[k], lk.JOINED_LAST: ends[k + 1],
                lk.CELL_FIRST: begin[0][k], lk.CELL_LAST: begin[0][k + 1], lk.LOW_X: low[0], lk.LOW_Y: low[1],
                lk.COLUMNS: grid.shape[0], lk.ROWS: grid.shape[1], lk.NEAR_FIRST: begin[1][k],
                lk.STRAIGHT: type(lane) is StraightLane, lk.ADVICE_FIRST: heard[n], lk.ADVICE_LAST: heard[n + 1],
            }  # fmt: skip
            table[n, list(values)] = [float(value) for value in values.values()]
    return Lanes(
        table=table,
        cells=np.concatenate([p[0] for p in paths]),
        near=np.concatenate([p[2].ravel() for p in paths]).astype(np.int64),
        joined=np.array([pair for rows in joined for pair in rows], dtype=np.int64).reshape(-1, 2),
        advice=np.array([speed for speeds in advice for speed in speeds], dtype=np.float64),
    )


def _path_of(row: list[Any]) -> tuple[Any, tuple[float, float], Any]:
    """Cells, corner of the grid and the cell to begin at in each square, of the path that a road's lanes share."""
    if all(type(lane) is CurveLane and lane.path is row[0].path for lane in row):
        path = row[0].path
        columns = [path.kappa, path.slope, path.span, path.station[:-1]]
        cells = np.column_stack([np.array(path.pose[:-1]), np.array(columns).T])
        return cells, path.grid_m, np.array(path.near, dtype=np.int64)
    if all(type(lane) is StraightLane and abs(lane.heading) < AT_REST for lane in row):
        cells = np.zeros((1, CELL_COLUMNS))
        cells[0, [lk.C_X, lk.C_SPAN]] = row[0].start[0], row[0].length
        return cells, (float(row[0].start[0]), 0.0), np.zeros((1, 1), dtype=np.int64)
    kinds = ", ".join(sorted({type(lane).__name__ for lane in row}))
    raise ConfigError(f"base must have curved lanes beside one path or straight ones along x, got {kinds}")


def _offset_m(lane: Any) -> float:
    return float(lane.offset_m if type(lane) is CurveLane else lane.start[1])


def _advice(lane: Any) -> list[float]:
    """Speeds that a lane advises at every step, none on a straight one."""
    if type(lane) is not CurveLane:
        return []
    return [lane.advised_speed(k * ADVICE_STEP_M) for k in range(int(lane.length / ADVICE_STEP_M) + 2)]


def _index(values: list[int], value: int) -> int:
    """Where a value is in a list, -1 for nowhere."""
    return values.index(value) if value in values else -1


def _joined(edges: list[Any], first: Any, k: int) -> list[tuple[int, bool]]:
    """The roads that lead to a road and go on from it, and whether all their lanes count (junctions do)."""
    start, end, row = edges[k]
    leading = [n for n, (_, b, _) in enumerate(edges) if b == start]
    onward = [n for n, (a, _, _) in enumerate(edges) if a == end]
    both = [(n, len(leading) > 1) for n in leading] + [(n, False) for n in onward]
    return [(int(first[n]), junction or len(edges[n][2]) != len(row)) for n, junction in both]


def _onward(network: RoadNetwork) -> list[int]:
    """The lane of the same number on the only road that goes on, -1 where a road ends.

    Raises
    ------
    ConfigError
        A road that forks, or goes on with another number of lanes.
    """
    rows = lane_rows(network)
    out = []
    for _, end, i in rows:
        ends = network.graph.get(end, {})
        if len(ends) > 1 or any(i >= len(row) for row in ends.values()):
            raise ConfigError("base must have roads that go on in one way with as many lanes: choose another id")
        out.append(rows.index((end, next(iter(ends)), i)) if ends else -1)
    return out
