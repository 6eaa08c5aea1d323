"""A lane at a constant offset from a path, and the advised speed in its bends."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from math import cos, sin, sqrt
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane, LineType
from highway_env.utils import get_class_path
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import ADVICE_STEP_M
from lanebound.envs.worlds.paths import Path, Piece, Pose
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["CurveLane"]


Array = NDArray[np.float64]

LATERAL_MPS2 = 2.0  # comfortable in bends; urban drivers stay within 2 to 2.5
DECELERATION_MPS2 = 1.2


class CurveLane(AbstractLane):  # type: ignore[misc]
    """A lane at a constant offset from a path; longitudinal positions are arc lengths of its centre line.

    A parallel curve at offset o to the right has the arc length ``l = s - o (theta(s) - theta(0))`` and the same
    normals. There is no other approximation: the distance between lanes of one path is exactly constant.

    Parameters
    ----------
    path : the common line of the lanes of a road
    offset_m : offset of the lane's centre to the right of the path
    width_m : width of the lane
    line_types : left and right marking
    speed_limit : legal limit [m/s]; in bends see :meth:`advised_speed`
    """

    def __init__(
        self,
        path: Path,
        offset_m: float,
        width_m: float,
        line_types: tuple[int, int] = (LineType.CONTINUOUS_LINE, LineType.CONTINUOUS_LINE),
        speed_limit: float = 50.0 / 3.6,
    ) -> None:
        if max(offset_m * piece.start for piece in path.pieces) >= 1.0:
            raise InputError(f"offset_m = {offset_m} lies beyond the middle of a bend: widen its radius")
        self.path, self.offset_m, self.width = path, offset_m, width_m
        self.line_types = line_types
        self.speed_limit = speed_limit
        self.forbidden, self.priority = False, 0
        first = path.start.heading
        self._station: list[float] = [
            s - offset_m * (pose.heading - first) for s, pose in zip(path.station, path.pose, strict=True)
        ]
        self.length: float = self._station[-1]
        self._last = len(self._station) - 2
        # about all that on_lane can hold with 1 m of margin, and 1 m for what bulges between samples of the path
        reach = abs(offset_m) + 0.5 * width_m + self.VEHICLE_LENGTH + 2.0
        self._low, self._high = (path.low_m - reach).tolist(), (path.high_m + reach).tolist()

    def moved(self, y_m: float) -> CurveLane:
        """The same lane, farther along y."""
        path = Path.of(self.path.start._replace(y=self.path.start.y + y_m), self.path.pieces)
        lane = CurveLane(path, self.offset_m, self.width, self.line_types, self.speed_limit)
        lane.forbidden, lane.priority = self.forbidden, self.priority
        return lane

    def _into(self, longitudinal: float) -> tuple[int, float]:
        """Cell of the path, and distance along the path in it, for a longitudinal position on the lane.

        Solves ``l = (1 - o kappa) u - o slope u^2 / 2`` with the numerically stable root.
        """
        cell = min(max(bisect_right(self._station, longitudinal) - 1, 0), self._last)
        rest = longitudinal - self._station[cell]
        factor = 1.0 - self.offset_m * self.path.kappa[cell]
        under = factor * factor - 2.0 * self.offset_m * self.path.slope[cell] * rest
        return cell, 2.0 * rest / (factor + sqrt(max(under, 0.0)))

    def _pose(self, longitudinal: float) -> Pose:
        return self.path.at(*self._into(longitudinal))

    def position(self, longitudinal: float, lateral: float) -> Array:
        """Point at a longitudinal position and an offset to the right.  -> (2,) [m]."""
        x, y, heading = self._pose(longitudinal)
        aside = lateral + self.offset_m
        return np.array([x - aside * sin(heading), y + aside * cos(heading)])

    def local_coordinates(self, position: Array) -> tuple[float, float]:
        """Distance along the lane and to the right of it [m]."""
        return self.local_pose(position)[:2]

    def local_pose(self, position: Array) -> tuple[float, float, float]:
        """Distance along the lane and to the right of it [m], and the lane's direction there [rad], not wrapped."""
        path, offset = self.path, self.offset_m
        cell, into, lateral = path.project(float(position[0]), float(position[1]))
        turned = (path.kappa[cell] + 0.5 * path.slope[cell] * into) * into
        return self._station[cell] + into - offset * turned, lateral - offset, path.pose[cell].heading + turned

    def heading_at(self, longitudinal: float) -> float:
        """Direction of the lane [rad], not wrapped."""
        return self._pose(longitudinal).heading

    def curvature_at(self, longitudinal: float) -> float:
        """Curvature of the lane's centre line [1/m], positive to the right: ``kappa / (1 - o kappa)``."""
        cell, into = self._into(longitudinal)
        kappa = self.path.kappa[cell] + self.path.slope[cell] * into
        return kappa / (1.0 - self.offset_m * kappa)

    def width_at(self, longitudinal: float) -> float:
        """Width of the lane [m]."""
        return self.width

    def on_lane(
        self, position: Array, longitudinal: float | None = None, lateral: float | None = None, margin: float = 0.0
    ) -> bool:
        """Whether a point lies on the lane, by the rule of the base class without NumPy."""
        if longitudinal is None or lateral is None:
            longitudinal, lateral = self.local_coordinates(position)
        beside = abs(lateral) <= self.width / 2 + margin
        return beside and -self.VEHICLE_LENGTH <= longitudinal < self.length + self.VEHICLE_LENGTH

    def may_hold(self, x: float, y: float) -> bool:
        """Whether a point lies in the bounding box of the lane; outside :meth:`on_lane` with 1 m margin is False."""
        return bool(self._low[0] <= x <= self._high[0] and self._low[1] <= y <= self._high[1])

    def distance_with_heading(self, position: Array, heading: float | None, heading_weight: float = 1.0) -> float:
        """Distance from the lane and its ends plus the weighted angle to the lane, by the rule of the base class."""
        path, offset = self.path, self.offset_m
        cell, into, lateral = path.project(float(position[0]), float(position[1]))
        turned = (path.kappa[cell] + 0.5 * path.slope[cell] * into) * into
        s = self._station[cell] + into - offset * turned
        distance = abs(lateral - offset) + max(s - self.length, 0.0, -s)
        if heading is None:
            return distance
        angle = wrap_angle(heading - path.pose[cell].heading - turned)
        return distance + heading_weight * abs(angle)

    def advised_speed(self, longitudinal: float) -> float:
        """Largest comfortable speed [m/s] with respect to the bends here and ahead on this lane.

        ``min over s' >= s of sqrt(v(s')^2 + 2 b (s' - s))`` with ``v(s) = min(limit, sqrt(a / |kappa(s)|))``.
        """
        table = _advice(self.path, self.offset_m, self.speed_limit)
        return table[min(max(int(longitudinal / ADVICE_STEP_M), 0), len(table) - 1)]

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> CurveLane:
        """The lane from the output of :meth:`to_config`."""
        return _lane(**config)

    def to_config(self) -> dict[str, Any]:
        """The lane as plain data."""
        return {
            "class_path": get_class_path(_lane),
            "config": {
                "start": list(self.path.start),
                "pieces": [list(piece) for piece in self.path.pieces],
                "offset_m": self.offset_m,
                "width_m": self.width,
                "line_types": list(self.line_types),
                "speed_limit": self.speed_limit,
            },
        }


def _lane(start: Sequence[float], pieces: Sequence[Sequence[float]], **rest: Any) -> CurveLane:
    """A lane from plain data, for highway-env's ``lane_from_config``."""
    path = Path.of(Pose(*start), [Piece(*piece) for piece in pieces])
    return CurveLane(path, **{**rest, "line_types": tuple(rest["line_types"])})


@lru_cache(maxsize=128)
def _advice(path: Path, offset_m: float, speed_limit: float) -> list[float]:
    """Advised speed at every step of a lane, computed backwards from its end."""
    lane = CurveLane(path, offset_m, 1.0, speed_limit=speed_limit)
    stations = np.arange(0.0, lane.length + ADVICE_STEP_M, ADVICE_STEP_M).tolist()
    out, ahead = [], speed_limit
    for s in reversed(stations):
        kappa = abs(lane.curvature_at(s))
        bend = sqrt(LATERAL_MPS2 / kappa) if kappa > 0.0 else speed_limit
        ahead = min(speed_limit, bend, sqrt(ahead * ahead + 2.0 * DECELERATION_MPS2 * ADVICE_STEP_M))
        out.append(ahead)
    return out[::-1]
