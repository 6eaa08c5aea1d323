"""The ego's map in flat arrays: the line that it is to follow from each lane, as :mod:`..observation.path` finds it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["FACTS", "LINE_COLUMNS", "NODE_COLUMNS", "Chart", "path_at", "project"]

# columns of a line: first point, direction, length, step between nodes (0: straight), first node and number of pieces
L_X, L_Y, L_HEADING, L_LENGTH, L_STEP, L_NODE, L_PIECES = range(7)
LINE_COLUMNS = 7
# columns of a piece: coefficients of both cubics, heading at the start, its change, curvature
NODE_COLUMNS = 11
# columns of the facts of a lane
SHARE, LEFT_EXISTS, RIGHT_EXISTS, LIMIT, JUNCTION_M, LANE_END_M, START_M, END_M, FIRST, LAST = range(10)
FACTS = 10
PROJECTIONS, NEAR_CURVED_M, NEAR_STRAIGHT_M = 6, 0.1, 1.0  # of observation/path.py


class Chart(NamedTuple):
    """The paths from L lanes on.

    facts (L, FACTS); following (L, F): rows of the lanes that a path follows, -1 for none; pieces (Q, 3): stations
    where a piece of a path ends and where its line begins, and its line; lines (L, LINE_COLUMNS);
    nodes (M, NODE_COLUMNS).
    """

    facts: NDArray[np.float64]
    following: NDArray[np.int64]
    pieces: NDArray[np.float64]
    lines: NDArray[np.float64]
    nodes: NDArray[np.float64]


@jit
def _on_line(chart, n, s):  # type: ignore[no-untyped-def]
    """Point, direction and curvature at a station of a lane's line; drawn on straight past the ends of a curved one."""
    x, y, heading = chart.lines[n, L_X], chart.lines[n, L_Y], chart.lines[n, L_HEADING]
    step, length = chart.lines[n, L_STEP], chart.lines[n, L_LENGTH]
    if step == 0.0:
        return x + s * math.cos(heading), y + s * math.sin(heading), heading, 0.0
    inside = min(max(s, 0.0), length)
    piece = min(int(inside / step), int(chart.lines[n, L_PIECES]) - 1)
    q, u = chart.nodes[int(chart.lines[n, L_NODE]) + piece], inside / step - piece
    x = q[0] + u * (q[1] + u * (q[2] + u * q[3]))
    y = q[4] + u * (q[5] + u * (q[6] + u * q[7]))
    heading = q[8] + u * q[9]
    if s == inside:
        return x, y, heading, q[10]
    return x + (s - inside) * math.cos(heading), y + (s - inside) * math.sin(heading), heading, 0.0


@jit
def path_at(chart, lane, station):  # type: ignore[no-untyped-def]
    """Point, direction and curvature at a station of the path from a lane on: (x, y, heading, curvature)."""
    first, last = int(chart.facts[lane, FIRST]), int(chart.facts[lane, LAST])
    start = chart.facts[lane, START_M]
    if station < start:
        x, y, heading, _ = _on_line(chart, int(chart.pieces[first, 2]), 0.0)
        return x + (station - start) * math.cos(heading), y + (station - start) * math.sin(heading), heading, 0.0
    for k in range(first, last + 1):
        if station < chart.pieces[k, 0]:
            return _on_line(chart, int(chart.pieces[k, 2]), station - chart.pieces[k, 1])
    n, end = int(chart.pieces[last, 2]), chart.pieces[last, 0]
    x, y, heading, _ = _on_line(chart, n, chart.lines[n, L_LENGTH])
    return x + (station - end) * math.cos(heading), y + (station - end) * math.sin(heading), heading, 0.0


@jit
def project(chart, lane, x, y, guess):  # type: ignore[no-untyped-def]
    """Station and offset of a point from the path of a lane, and whether it is beside it: (s, r, found)."""
    station = guess
    for _ in range(PROJECTIONS):
        px, py, heading, curvature = path_at(chart, lane, station)
        dx, dy, cosine, sine = x - px, y - py, math.cos(heading), math.sin(heading)
        along, offset = dx * cosine + dy * sine, dy * cosine - dx * sine
        station += along / max(1.0 - curvature * offset, 0.5)
        near = NEAR_CURVED_M if curvature != 0.0 else NEAR_STRAIGHT_M
        if -near < along < near:
            return station, offset, True
    return 0.0, 0.0, False
