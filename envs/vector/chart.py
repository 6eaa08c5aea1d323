"""The map of an environment as the arrays of :mod:`.chart_kernel`, asked of the map that single environments use."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork

from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.path import Line, Path, RoadMap, SampledLine
from lanebound.envs.vector.chart_kernel import LINE_COLUMNS, NODE_COLUMNS, Chart
from lanebound.envs.vector.lanes import lane_rows

__all__ = ["chart_of"]


def chart_of(network: RoadNetwork, config: ObservationConfig) -> Chart:
    """The paths that observations show from every lane of a network, without a planned route."""
    roads = RoadMap(network, behind_m=config.range_m, ahead_m=max(config.range_m, *config.preview_m, 0.0))
    rows = lane_rows(network)
    paths = [roads.path(index) for index in rows]
    lines = [roads.line(index) for index in rows]
    place = {id(line): n for n, line in enumerate(lines)}
    pieces = [(end, origin, place[id(line)]) for path in paths for end, origin, line in path.pieces]
    table, nodes = _lines(lines)
    ends = np.cumsum([len(path.pieces) for path in paths])
    widest = max(len(path.following) for path in paths)
    following = np.full((len(rows), widest), -1, dtype=np.int64)
    for lane, path in enumerate(paths):
        following[lane, : len(path.following)] = [rows.index(index) for index in path.following]
    return Chart(
        facts=np.array([_facts(path, int(end)) for path, end in zip(paths, ends, strict=True)]),
        following=following,
        pieces=np.array(pieces, dtype=np.float64),
        lines=table,
        nodes=nodes,
    )


def _facts(path: Path, end: int) -> tuple[float, ...]:
    """In the order of the kernel's columns; the path's pieces are those before row ``end``."""
    return (*path.lane, path.junction_m, path.lane_end_m, path.start_m, path.end_m, end - len(path.pieces), end - 1)


def _lines(lines: list[Line]) -> tuple[Any, Any]:
    """Every line in a row, and the pieces of all curved ones."""
    table, nodes = np.zeros((len(lines), LINE_COLUMNS)), [np.zeros((0, NODE_COLUMNS))]
    count = 0
    for n, line in enumerate(lines):
        table[n, :4] = line.x, line.y, line.heading, line.length
        if isinstance(line, SampledLine):
            pieces = line.all_pieces()
            table[n, 4:] = line.step, count, len(pieces)
            nodes.append(pieces)
            count += len(pieces)
    return table, np.concatenate(nodes)
