"""The lanes of a road network as the flat arrays of :mod:`.lanes_kernel`."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs.records import LaneIndex
from lanebound.envs.vector.lanes_kernel import CELL_COLUMNS, Lanes
from lanebound.envs.worlds.lanes import CurveLane
from lanebound.envs.worlds.paths import SQUARE_M
from lanebound.integrity.errors import ConfigError

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
    roads = [row for _, _, row in edges]
    flat = [lane for row in roads for lane in row]
    paths = [_path_of(row) for row in roads]
    joined, whole, first = _joined(edges)
    return Lanes(
        path=np.array([r for r, row in enumerate(roads) for _ in row], dtype=np.int64),
        road=np.array([r for r, row in enumerate(roads) for _ in row], dtype=np.int64),
        offset=np.array([_offset_m(lane) for lane in flat], dtype=np.float64),
        width=np.array([float(lane.width_at(0.0)) for lane in flat]),
        length=np.array([float(lane.length) for lane in flat]),
        limit=np.array([float(lane.speed_limit) for lane in flat]),
        side=np.array([i for row in roads for i in range(len(row))], dtype=np.int64),
        first=np.cumsum([0, *(len(row) for row in roads)])[:-1].astype(np.int64),
        count=np.array([len(row) for row in roads], dtype=np.int64),
        joined_first=first,
        joined=joined,
        joined_whole=whole,
        onward=_onward(network),
        cells=np.concatenate([p[0] for p in paths]),
        cell_first=np.cumsum([0, *(len(p[0]) for p in paths)]).astype(np.int64),
        low=np.array([p[1] for p in paths], dtype=np.float64),
        shape=_shapes([p[2] for p in paths]),
        near=np.concatenate([p[2].ravel() for p in paths]).astype(np.int64),
        square=SQUARE_M,
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
        cells[0, :2] = row[0].start[0], 0.0
        cells[0, 5] = row[0].length
        return cells, (0.0, 0.0), np.zeros((1, 1), dtype=np.int64)
    kinds = ", ".join(sorted({type(lane).__name__ for lane in row}))
    raise ConfigError(f"base must have curved lanes beside one path or straight ones along x, got {kinds}")


def _offset_m(lane: Any) -> float:
    return float(lane.offset_m if type(lane) is CurveLane else lane.start[1])


def _shapes(grids: list[Any]) -> Any:
    starts = np.cumsum([0, *(grid.size for grid in grids)])[:-1]
    return np.array([(*grid.shape, start) for grid, start in zip(grids, starts, strict=True)], dtype=np.int64)


def _joined(edges: list[Any]) -> tuple[Any, Any, Any]:
    """For each road those that lead to it and go on from it, and whether all their lanes count (junctions do)."""
    joined: list[int] = []
    whole: list[bool] = []
    first = [0]
    for start, end, row in edges:
        leading = [k for k, (_, b, _) in enumerate(edges) if b == start]
        onward = [k for k, (a, _, _) in enumerate(edges) if a == end]
        for k, junction in [(k, len(leading) > 1) for k in leading] + [(k, False) for k in onward]:
            joined.append(k)
            whole.append(junction or len(edges[k][2]) != len(row))
        first.append(len(joined))
    return np.array(joined, dtype=np.int64), np.array(whole, dtype=np.bool_), np.array(first, dtype=np.int64)


def _onward(network: RoadNetwork) -> Any:
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
    return np.array(out, dtype=np.int64)
