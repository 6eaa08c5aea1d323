"""Plane curves with piecewise linear curvature: straights, arcs and clothoids.

Frame ``xy`` of highway-env: x forward, y to the right, headings clockwise from x seen from above, curvature positive to
the right. A curve starts and ends with straights, which continue it beyond its ends.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from math import atan2, cos, floor, sin, sqrt, tan
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lanebound.envs.batch.lanes_kernel import SQUARE_M
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["Foot", "Path", "Piece", "Pose", "bend", "rounded_polygon", "s_bend", "straight", "tangent_m"]

CLOTHOID_CELL_M = 1.0  # 3-point Gauss over it is exact to 1e-11 m in all of a corner
MARGIN_M = 40.0
SAMPLE_M = 2.0
MEMORY = 512
GAUSS = ((0.5 - sqrt(0.15), 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.5 + sqrt(0.15), 5.0 / 18.0))


class Pose(NamedTuple):
    """A point and a direction: x, y [m], heading [rad]."""

    x: float
    y: float
    heading: float


class Piece(NamedTuple):
    """A piece of length [m] with a curvature that is linear between two values [1/m]."""

    length: float
    start: float
    end: float


class Foot(NamedTuple):
    """The nearest point of a curve: its cell, the distance in the cell [m], and the offset to the right [m]."""

    cell: int
    into: float
    lateral: float


def straight(length_m: float) -> list[Piece]:
    """A straight piece."""
    return [Piece(length_m, 0.0, 0.0)]


def bend(angle_rad: float, radius_m: float, transition_m: float) -> list[Piece]:
    """A turn to the right (angle > 0) or left: clothoid, arc, clothoid.

    A clothoid of length L between a straight and radius R turns by L / (2 R); the arc turns by the rest. If the angle
    is too small, the clothoids are shortened and there is no arc.
    """
    if radius_m <= 0.0 or transition_m < 0.0 or angle_rad == 0.0:
        raise InputError(
            f"a bend needs radius_m > 0, transition_m >= 0 and an angle, got {radius_m}, {transition_m}, {angle_rad}"
        )
    kappa = (1.0 if angle_rad > 0.0 else -1.0) / radius_m
    transition = min(transition_m, abs(angle_rad) * radius_m)
    arc = abs(angle_rad) * radius_m - transition
    pieces = [Piece(transition, 0.0, kappa), Piece(arc, kappa, kappa), Piece(transition, kappa, 0.0)]
    return [piece for piece in pieces if piece.length > 1e-9]


def s_bend(shift_m: float, radius_m: float, transition_m: float) -> list[Piece]:
    """A bend to the right and one back to the first direction, ``shift_m`` > 0 beside it; the angle by bisection."""
    if not 0.0 < shift_m < radius_m:
        raise InputError(f"an s_bend needs a shift_m within radius_m = {radius_m}, got {shift_m}: widen the radius")
    low, high, pieces = 0.0, 1.2, list[Piece]()
    for _ in range(60):
        angle = 0.5 * (low + high)
        pieces = bend(angle, radius_m, transition_m) + bend(-angle, radius_m, transition_m)
        pose = Pose(0.0, 0.0, 0.0)
        for piece in pieces:
            pose = _advance_far(pose, piece)
        low, high = (angle, high) if pose.y < shift_m else (low, angle)
    return pieces


def rounded_polygon(
    corners: Sequence[tuple[float, float, float]], transition_m: float
) -> list[tuple[Pose, list[Piece]]]:
    """A closed curve along the sides of a polygon with corners (x, y, radius) rounded by bends.

    Each entry has the pose at the middle of a side and the pieces from there to the middle of the next side.
    """
    count = len(corners)
    points = [np.array(corner[:2]) for corner in corners]
    sides = [points[(k + 1) % count] - points[k] for k in range(count)]
    lengths = [float(np.hypot(*side)) for side in sides]
    headings = [atan2(side[1], side[0]) for side in sides]
    out = []
    for k in range(count):
        after = (k + 1) % count
        turn = wrap_angle(headings[after] - headings[k])
        pieces = bend(turn, corners[after][2], transition_m)
        near = tangent_m(pieces, turn)
        ends = 0.5 * lengths[k] - near, 0.5 * lengths[after] - near
        if min(ends) <= 0.0:
            raise InputError(f"corner {after} of the polygon leaves no straight: shorten its radius or its transition")
        middle = 0.5 * (points[k] + points[after])
        pose = Pose(float(middle[0]), float(middle[1]), headings[k])
        out.append((pose, [*straight(ends[0]), *pieces, *straight(ends[1])]))
    return out


def tangent_m(pieces: Sequence[Piece], turn: float) -> float:
    """Distance from a corner to the start of its bend, from the chord (X, Y) of the bend: X - Y / tan(turn)."""
    pose = Pose(0.0, 0.0, 0.0)
    for piece in pieces:
        pose = _advance_far(pose, piece)
    return pose.x - pose.y / tan(turn)


def _advance(pose: Pose, kappa: float, slope: float, into: float) -> Pose:
    """Pose at a distance ``into`` a cell with the curvature ``kappa + slope into``.

    Closed form on straights and arcs: the chord of an arc of angle a is ``s sin(a / 2) / (a / 2)``.
    """
    x, y, heading = pose
    if slope == 0.0:
        half = 0.5 * kappa * into
        chord = into if half == 0.0 else into * sin(half) / half
        return Pose(x + chord * cos(heading + half), y + chord * sin(heading + half), heading + 2.0 * half)
    for share, weight in GAUSS:
        u = share * into
        angle = heading + (kappa + 0.5 * slope * u) * u
        x += weight * into * cos(angle)
        y += weight * into * sin(angle)
    return Pose(x, y, heading + (kappa + 0.5 * slope * into) * into)


def _cells(piece: Piece) -> list[Piece]:
    """Cells of a piece: short cells of a clothoid, one cell for a straight or an arc."""
    if piece.start == piece.end:
        return [piece]
    count = int(np.ceil(piece.length / CLOTHOID_CELL_M))
    kappa = np.linspace(piece.start, piece.end, count + 1).tolist()
    return [Piece(piece.length / count, kappa[k], kappa[k + 1]) for k in range(count)]


def _advance_far(pose: Pose, piece: Piece) -> Pose:
    """Pose at the end of a piece."""
    for cell in _cells(piece):
        pose = _advance(pose, cell.start, (cell.end - cell.start) / cell.length, cell.length)
    return pose


class Path:
    """A curve of pieces that starts at a pose, with poses along it and projection of points onto it.

    Immutable; equal paths are the same object, also after copying and pickling.

    Parameters
    ----------
    start : pose at s = 0
    pieces : in order; the first and the last must be straight

    Raises
    ------
    InputError
        The first or last piece is not straight, or a piece has no length.
    """

    def __init__(self, start: Pose, pieces: tuple[Piece, ...]) -> None:
        if not pieces or any(p.start != 0.0 or p.end != 0.0 for p in (pieces[0], pieces[-1])):
            raise InputError("a path must begin and end on a straight: add a piece of zero curvature")
        if min(piece.length for piece in pieces) <= 0.0:
            raise InputError("every piece of a path needs a length > 0")
        self.start, self.pieces = start, pieces
        cells = [cell for piece in pieces for cell in _cells(piece)]
        self.span = [cell.length for cell in cells]
        self.kappa = [cell.start for cell in cells]
        self.slope = [(cell.end - cell.start) / cell.length for cell in cells]
        self.pose = [start]
        for k in range(len(cells)):
            self.pose.append(_advance(self.pose[k], self.kappa[k], self.slope[k], self.span[k]))
        self.station: list[float] = [0.0, *np.cumsum(self.span).tolist()]
        self.length = self.station[-1]
        self._last = len(cells) - 1
        self._memory: dict[tuple[float, float], Foot] = {}
        self._index()

    @staticmethod
    def of(start: Pose, pieces: Sequence[Piece]) -> Path:
        """The shared path of these pieces."""
        return _shared(Pose(*start), tuple(Piece(*piece) for piece in pieces))

    def __reduce__(self) -> tuple[object, ...]:
        return Path.of, (self.start, self.pieces)

    def __copy__(self) -> Path:
        return self

    def __deepcopy__(self, memo: object) -> Path:
        return self

    def _index(self) -> None:
        """The start cell of a search for each square of the plane around the path."""
        station = np.linspace(0.0, self.length, int(self.length / SAMPLE_M) + 2)
        cell = np.searchsorted(np.array(self.station[1:-1]), station, side="right")
        points = np.array([self.at(k, s - self.station[k])[:2] for k, s in zip(cell.tolist(), station, strict=True)])
        self.low_m, self.high_m = points.min(0), points.max(0)
        self._x0, self._y0 = (self.low_m - MARGIN_M).tolist()
        columns, rows = (np.ceil((self.high_m - self.low_m + 2.0 * MARGIN_M) / SQUARE_M)).astype(int).tolist()
        middle = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1) * SQUARE_M
        middle = middle + (self.low_m - MARGIN_M + 0.5 * SQUARE_M)
        self._near: list[list[int]] = cell[cKDTree(points).query(middle)[1]].tolist()
        self._columns, self._rows = columns - 1, rows - 1

    @property
    def grid_m(self) -> tuple[float, float]:
        """Corner x, y of the squares of :attr:`near` [m], each ``SQUARE_M`` wide."""
        return self._x0, self._y0

    @property
    def near(self) -> list[list[int]]:
        """The start cell of a search, by column and row of squares."""
        return self._near

    def cell_of(self, station_m: float) -> int:
        """The cell of an arc length; the first and last cells extend beyond the ends."""
        return min(max(bisect_right(self.station, station_m) - 1, 0), self._last)

    def at(self, cell: int, into_m: float) -> Pose:
        """Pose at a distance in a cell."""
        return _advance(self.pose[cell], self.kappa[cell], self.slope[cell], into_m)

    def pose_at(self, station_m: float) -> Pose:
        """Pose at an arc length, also beyond the ends."""
        cell = self.cell_of(station_m)
        return self.at(cell, station_m - self.station[cell])

    def curvature_at(self, station_m: float) -> float:
        """Curvature at an arc length [1/m], positive to the right."""
        cell = self.cell_of(station_m)
        return self.kappa[cell] + self.slope[cell] * (station_m - self.station[cell])

    def project(self, x: float, y: float) -> Foot:
        """The nearest point of the path, exact up to rounding, for points closer to this part than to any other."""
        key = (x, y)
        foot = self._memory.get(key)
        if foot is None:
            if len(self._memory) >= MEMORY:
                self._memory.clear()
            foot = self._memory[key] = self._search(x, y)
        return foot

    def _search(self, x: float, y: float) -> Foot:
        """Search from the indexed cell for the cell of the foot; a foot between two cells is their common point."""
        column = min(max(floor((x - self._x0) / SQUARE_M), 0), self._columns)
        row = min(max(floor((y - self._y0) / SQUARE_M), 0), self._rows)
        cell, way = self._near[column][row], 0
        while True:
            into, lateral = self._foot(cell, x, y)
            if into < 0.0 and cell > 0:
                if way > 0:
                    return Foot(cell, 0.0, self._offset(cell, x, y))
                cell, way = cell - 1, -1
            elif into > self.span[cell] and cell < self._last:
                cell = cell + 1
                if way < 0:
                    return Foot(cell, 0.0, self._offset(cell, x, y))
                way = 1
            else:
                return Foot(cell, into, lateral)

    def _offset(self, cell: int, x: float, y: float) -> float:
        """Offset to the right of the first point of a cell."""
        x0, y0, heading = self.pose[cell]
        return (y - y0) * cos(heading) - (x - x0) * sin(heading)

    def _foot(self, cell: int, x: float, y: float) -> tuple[float, float]:
        """Distance in a cell of the foot of the normal, which may lie outside of it, and the offset to the right.

        On an arc both follow from the angle about its centre. On a clothoid Newton's method starts at the result for
        the arc tangent to the start of the cell: with the offset n, the distance t from s to the point changes as
        ``t' = kappa n - 1``.
        """
        x0, y0, heading = self.pose[cell]
        c, s = cos(heading), sin(heading)
        dx, dy = x - x0, y - y0
        along, right = dx * c + dy * s, dy * c - dx * s
        kappa, slope = self.kappa[cell], self.slope[cell]
        if slope != 0.0:
            return self._foot_clothoid(cell, x, y, along / max(1.0 - kappa * right, 0.1))
        if kappa == 0.0:
            return along, right
        a, b = kappa * along, 1.0 - kappa * right
        # 1 - hypot(a, b), without the loss of digits at large radii; the C library's hypot is that of the kernels, and
        # math.hypot rounds otherwise
        gap = (kappa * right * (1.0 + b) - a * a) / (1.0 + abs(complex(a, b)))
        return atan2(a, b) / kappa, gap / kappa

    def _foot_clothoid(self, cell: int, x: float, y: float, into: float) -> tuple[float, float]:
        span, right = self.span[cell], 0.0
        for _ in range(6):
            into = min(max(into, -span), 2.0 * span)
            x0, y0, heading = self.at(cell, into)
            c, s = cos(heading), sin(heading)
            ahead, right = (x - x0) * c + (y - y0) * s, (y - y0) * c - (x - x0) * s
            kappa = self.kappa[cell] + self.slope[cell] * into
            move = ahead / max(1.0 - kappa * right, 0.1)
            into += move
            if abs(move) < 1e-12:
                break
        return into, right


@lru_cache(maxsize=512)  # a corridor with tolls has 40
def _shared(start: Pose, pieces: tuple[Piece, ...]) -> Path:
    return Path(start, pieces)
