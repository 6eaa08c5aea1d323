"""A road network as quadrilaterals of asphalt, kerb and markings, computed once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.road.lane import LineType, StraightLane
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex
from lanebound.envs.rendering.camera import Camera, quads_along

__all__ = ["Quads", "RoadDrawing", "corridor"]

Array = NDArray[np.float64]

STRAIGHT_STEP_M, CURVED_STEP_M = 25.0, 2.0
DASH_M, PERIOD_M = 3.0, 7.5
MARKING_M = 0.15
KERB_M = 0.35


@dataclass(frozen=True)
class Quads:
    """Quadrilaterals (n, 4, 2) with their bounding circles."""

    corners_m: Array
    middle_m: Array
    radius_m: Array

    @classmethod
    def of(cls, pieces: Sequence[Array]) -> Quads:
        """Concatenate all pieces (k, 4, 2)."""
        corners = np.concatenate([np.zeros((0, 4, 2)), *pieces])
        middle = corners.mean(1)
        return cls(corners, middle, np.linalg.norm(corners - middle[:, None], axis=-1).max(-1, initial=0.0))

    def seen_px(self, camera: Camera) -> Array:
        """The quadrilaterals that may be visible on the map, in pixels."""
        return camera.px(self.corners_m[camera.sees(self.middle_m, self.radius_m)])


@dataclass(frozen=True)
class RoadDrawing:
    """A road network and its drawing, from the lowest to the highest layer."""

    network: Any
    kerb: Quads
    asphalt: Quads
    marking: Quads

    @classmethod
    def of(cls, network: Any) -> RoadDrawing:
        """Compute the drawing of every lane."""
        lanes = [lane for exits in network.graph.values() for edge in exits.values() for lane in edge]
        strips = [(lane, _stations(lane, 0.0, float(lane.length))) for lane in lanes]
        kerb = [_strip(lane, at, KERB_M) for lane, at in strips]
        asphalt = [_strip(lane, at, 0.02) for lane, at in strips]
        return cls(network, Quads.of(kerb), Quads.of(asphalt), Quads.of([q for lane in lanes for q in _markings(lane)]))


def corridor(
    network: Any, start: LaneIndex, route: Sequence[LaneIndex], behind_m: float, ahead_m: float, lateral_m: Array
) -> Array:
    """Lines along a lane and the lanes after it.

    From ``behind_m`` to ``ahead_m`` (both from the start of lane ``start``, the first not before it) at each lateral
    offset: (k,) -> (k, n, 2). The next lanes are those of ``route``, otherwise the only continuation; without a route
    the line ends at a fork.
    """
    pieces: list[Array] = []
    begin, left = max(behind_m, 0.0), ahead_m
    for index in _ahead(network, start, route):
        lane = network.get_lane(index)
        end = min(float(lane.length), left)
        if end > begin:
            at = _stations(lane, begin, end)
            pieces.append(np.stack([_line(lane, at, off) for off in lateral_m]))
        begin, left = 0.0, left - float(lane.length)
        if left <= 0.0:
            break
    return np.concatenate(pieces, 1) if pieces else np.zeros((len(lateral_m), 0, 2))


def _ahead(network: Any, start: LaneIndex, route: Sequence[LaneIndex]) -> Iterator[LaneIndex]:
    """Iterate over the lane, the following lanes of the route, and then the only continuation, until a lane repeats."""
    seen: set[LaneIndex] = set()
    rest = list(route)
    at: LaneIndex | None = start
    while at is not None and at not in seen:
        seen.add(at)
        yield at
        at = _next(network, at, rest)


def _next(network: Any, at: LaneIndex, rest: list[LaneIndex]) -> LaneIndex | None:
    exits = network.graph.get(at[1], {})
    for k, (a, b, lane) in enumerate(rest):
        if a == at[1] and b in exits:
            del rest[: k + 1]
            return a, b, min(lane if lane is not None else at[2], len(exits[b]) - 1)
    if len(exits) != 1:
        return None
    (b, lanes), *_ = exits.items()
    return at[1], b, min(at[2], len(lanes) - 1)


def _stations(lane: Any, begin_m: float, end_m: float) -> Array:
    step = STRAIGHT_STEP_M if type(lane) is StraightLane else CURVED_STEP_M
    return np.linspace(begin_m, end_m, max(int(np.ceil((end_m - begin_m) / step)), 1) + 1)


def _line(lane: Any, at: Array, lateral_m: Array | float) -> Array:
    offsets = np.broadcast_to(lateral_m, at.shape)
    return np.array([lane.position(float(s), float(r)) for s, r in zip(at, offsets, strict=True)], dtype=np.float64)


def _strip(lane: Any, at: Array, beyond_m: float) -> Array:
    half = np.array([0.5 * lane.width_at(float(s)) for s in at]) + beyond_m
    return quads_along(_line(lane, at, -half), _line(lane, at, half))


def _markings(lane: Any) -> Iterator[Array]:
    """The painted lines at the left and right edge of a lane."""
    for side, kind in zip((-0.5, 0.5), lane.line_types, strict=True):
        if kind == LineType.NONE:
            continue
        at = _stations(lane, 0.0, float(lane.length))
        if kind == LineType.STRIPED:
            begin = np.arange(0.0, float(lane.length), PERIOD_M)
            at = np.stack([begin, np.minimum(begin + DASH_M, float(lane.length))], 1).ravel()
        edge = side * np.array([lane.width_at(float(s)) for s in at])
        quads = quads_along(_line(lane, at, edge - 0.5 * MARKING_M), _line(lane, at, edge + 0.5 * MARKING_M))
        yield quads[::2] if kind == LineType.STRIPED else quads
