"""A road as a smooth reference line with lanes: poses along the road, and projection of positions onto it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["Road"]

Array = NDArray[np.float64]
MAX_SPACING_M = 2.0
NEWTON_STEPS = 5


@dataclass(frozen=True)
class Road:
    """A reference line with lanes.

    Positions are East, North [m]. Lateral offsets are positive to the right of the direction of travel. Lane 0 is the
    rightmost lane. The centre of the lanes lies ``shift_m`` to the right of the reference line: the reference line is
    the centre of a street with two directions if ``shift_m = lane_count * lane_width_m / 2``.

    Attributes
    ----------
    vertices_en_m : (M, 2) points at most 2 m apart; for a closed road the last repeats the first
    tangent_rad : (M,) azimuths of the line at the vertices, continuous (unwrapped)
    arc_at_m : (M,) arc lengths of the vertices, from 0
    """

    vertices_en_m: Array
    tangent_rad: Array
    arc_at_m: Array
    lane_count: int = 1
    lane_width_m: float = 3.5
    shift_m: float = 0.0
    closed: bool = False

    @classmethod
    def through(
        cls,
        points_en_m: ArrayLike,
        *,
        corner_radius_m: float = 15.0,
        closed: bool = False,
        lane_count: int = 1,
        lane_width_m: float = 3.5,
        shift_m: float = 0.0,
        spacing_m: float = 1.0,
    ) -> Road:
        """Build a road along a polyline (P, 2) whose corners are rounded by arcs tangent to both sides.

        The radius of an arc is at most ``corner_radius_m``, and smaller where a side is too short. For a finely sampled
        curve use ``corner_radius_m=np.inf``: the arcs then meet at the middle of each side.

        Raises
        ------
        InputError
            There are fewer than two points (three if closed), points are repeated, the line turns back on itself, or
            the lane geometry is invalid.
        """
        points = require_finite("points_en_m", points_en_m)
        require_shape("points_en_m", points, (None, 2))
        least = 3 if closed else 2
        if points.ndim != 2 or points.shape[0] < least:
            raise InputError(f"points_en_m must be (P, 2) with P >= {least}, got {points.shape}: add points")
        if lane_count < 1:
            raise InputError(f"lane_count must be at least 1, got {lane_count}: use 1 or more")
        require_in_range("lane_width_m", lane_width_m, 0.0, 100.0, low_open=True)
        require_in_range("shift_m", shift_m, -1e4, 1e4)
        require_in_range("spacing_m", spacing_m, 0.0, MAX_SPACING_M, low_open=True)
        if not corner_radius_m > 0.0:
            raise InputError(f"corner_radius_m must be positive, got {corner_radius_m}: use np.inf for the widest arcs")
        vertices, tangent, arc = _rounded(points, corner_radius_m, closed, spacing_m)
        return cls(vertices, tangent, arc, lane_count, lane_width_m, shift_m, closed)

    @classmethod
    def straight(
        cls, length_m: float, heading_rad: float = 0.0, *, lane_count: int = 1, lane_width_m: float = 3.5
    ) -> Road:
        """Build a straight road from the origin."""
        end = (length_m * np.sin(heading_rad), length_m * np.cos(heading_rad))
        return cls.through([(0.0, 0.0), end], lane_count=lane_count, lane_width_m=lane_width_m)

    @property
    def length_m(self) -> float:
        """Arc length of the reference line."""
        return float(self.arc_at_m[-1])

    @property
    def edge_m(self) -> float:
        """Distance from the reference line to the farther edge of the lanes; half the width of the street."""
        return abs(self.shift_m) + 0.5 * self.lane_count * self.lane_width_m

    def lane_lateral_m(self, lane: ArrayLike) -> Array:
        """Lateral offset of lane centres; lanes are clamped to the existing ones.  (...,) -> (...,) [m]."""
        k = np.clip(np.asarray(lane), 0, self.lane_count - 1)
        return np.asarray(self.shift_m + (0.5 * (self.lane_count - 1) - k) * self.lane_width_m, dtype=np.float64)

    def wrap_arc(self, arc_m: ArrayLike) -> Array:
        """Wrap arcs (...,) [m]: modulo the length of a closed road, clamped to the ends of an open road."""
        arc = np.asarray(arc_m, dtype=np.float64)
        return np.asarray(np.remainder(arc, self.length_m) if self.closed else np.clip(arc, 0.0, self.length_m))

    def pose_at(self, arc_m: ArrayLike, lateral_m: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Position and azimuth at an arc length and lateral offset.  (...,) [m] -> (..., 2) [m], (...,) [rad].

        Between vertices the line is a cubic with the tangents of the vertices. An open road continues straight beyond
        its ends.
        """
        requested, lateral = np.broadcast_arrays(
            np.asarray(arc_m, dtype=np.float64), np.asarray(lateral_m, dtype=float)
        )
        arc = self.wrap_arc(requested)
        k = np.clip(np.searchsorted(self.arc_at_m, arc, side="right") - 1, 0, self.arc_at_m.size - 2)
        ds = self.arc_at_m[k + 1] - self.arc_at_m[k]
        u = ((arc - self.arc_at_m[k]) / ds)[..., None]
        t0, t1 = self.tangent_rad[k], self.tangent_rad[k + 1]
        heading = t0 + (t1 - t0) * u[..., 0]
        m0, m1 = (np.stack([np.sin(t), np.cos(t)], -1) * ds[..., None] for t in (t0, t1))
        w = u * u * (3.0 - 2.0 * u)
        p = (1.0 - w) * self.vertices_en_m[k] + w * self.vertices_en_m[k + 1]
        p = p + u * (1.0 - u) * ((1.0 - u) * m0 - u * m1)
        s, c = np.sin(heading), np.cos(heading)
        if not self.closed:
            p = p + (requested - arc)[..., None] * np.stack([s, c], -1)
        return p + lateral[..., None] * np.stack([c, -s], -1), heading

    def project(self, position_en_m: ArrayLike) -> tuple[Array, Array]:
        """Arc length and lateral offset of the nearest point of the line.  (..., 2) [m] -> (...,), (...,) [m].

        Beyond the ends of an open road the arc lies outside [0, length].
        """
        p = require_finite("position_en_m", position_en_m)
        require_shape("position_en_m", p, (2,))
        arc = self.arc_at_m[self._tree.query(p)[1]]
        for _ in range(NEWTON_STEPS):
            foot, heading = self.pose_at(arc)
            s, c = np.sin(heading), np.cos(heading)
            d = p - foot
            slope = 1.0 - self._curvature(arc) * (d[..., 0] * c - d[..., 1] * s)
            step = (d[..., 0] * s + d[..., 1] * c) / np.maximum(slope, 0.2)
            arc = arc + np.clip(step, -MAX_SPACING_M, MAX_SPACING_M)
        if not self.closed:
            first, last = (self._arc_beyond(p, end) for end in (0, -1))
            arc = np.where(first < 0.0, np.minimum(arc, first), arc)
            arc = np.where(last > self.length_m, np.maximum(arc, last), arc)
        foot, heading = self.pose_at(arc)
        d = p - foot
        lateral = d[..., 0] * np.cos(heading) - d[..., 1] * np.sin(heading)
        return (self.wrap_arc(arc) if self.closed else arc), lateral

    def _arc_beyond(self, p: Array, end: int) -> Array:
        """Arc on the straight continuation of the road at one end; points not nearest to this end get an inner arc."""
        t, near = self.tangent_rad[end], self.arc_at_m[self._tree.query(p)[1]]
        d = p - self.vertices_en_m[end]
        at_end = np.abs(near - self.arc_at_m[end]) < 1e-9
        return np.where(at_end, self.arc_at_m[end] + d[..., 0] * np.sin(t) + d[..., 1] * np.cos(t), near)

    def _curvature(self, arc_m: Array) -> Array:
        k = np.searchsorted(self.arc_at_m, self.wrap_arc(arc_m), side="right") - 1
        return np.asarray(self._bend[np.clip(k, 0, self._bend.size - 1)])

    @cached_property
    def _bend(self) -> Array:
        return np.asarray(np.diff(self.tangent_rad) / np.diff(self.arc_at_m))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.vertices_en_m)


def _rounded(points: Array, radius_m: float, closed: bool, spacing_m: float) -> tuple[Array, Array, Array]:
    """Vertices, continuous azimuths and arc lengths of the polyline with rounded corners, each piece sampled evenly."""
    ring = points if not closed or not np.array_equal(points[0], points[-1]) else points[:-1]
    side = (np.roll(ring, -1, 0) - ring) if closed else np.diff(ring, axis=0)
    length = np.hypot(side[:, 0], side[:, 1])
    if (length <= 0.0).any():
        raise InputError(f"points_en_m must not repeat, got point {int(np.argmin(length))} twice: remove it")
    azimuth = np.arctan2(side[:, 0], side[:, 1])
    turn = np.zeros(ring.shape[0])
    inner = slice(0, None) if closed else slice(1, -1)
    turn[inner] = wrap_angle(azimuth - np.roll(azimuth, 1))[0 if closed else 1 :]
    if (np.abs(turn) > np.deg2rad(170.0)).any():
        worst = int(np.argmax(np.abs(turn)))
        raise InputError(f"points_en_m must not turn back, got {np.rad2deg(turn[worst]):.0f} deg at point {worst}")
    tangent_length = _tangent_lengths(turn, length, radius_m, closed)
    return _sample(ring, azimuth, length, turn, tangent_length, spacing_m)


def _tangent_lengths(turn: Array, length: Array, radius_m: float, closed: bool) -> Array:
    """Distance from each point to both ends of its arc: ``r tan(turn / 2)``, at most half of a side."""
    before = np.roll(length, 1) if closed else np.concatenate([[np.inf], length])
    after = length if closed else np.concatenate([length, [np.inf]])
    half = np.tan(0.5 * np.abs(turn))
    wanted = np.where(half > 0.0, min(radius_m, 1e9) * half, 0.0)
    return np.asarray(np.minimum(wanted, 0.5 * np.minimum(before, after)))


def _sample(
    ring: Array, azimuth: Array, length: Array, turn: Array, cut: Array, spacing_m: float
) -> tuple[Array, Array, Array]:
    """Sample sides and arcs in order; each piece has evenly spaced vertices with exact azimuth and arc length."""
    count, sides = ring.shape[0], length.shape[0]
    position = ring[0] + cut[0] * np.array([np.sin(azimuth[0]), np.cos(azimuth[0])])
    heading, arc = azimuth[0], 0.0
    rows: list[tuple[Array, Array, Array]] = [(position[None], np.array([heading]), np.array([0.0]))]
    for k in range(sides):
        following = (k + 1) % count
        for piece, bend in ((length[k] - cut[k] - cut[following], 0.0), (None, turn[following])):
            if piece is None:  # the arc at the next point; an open road has no arcs at its ends
                half = np.tan(0.5 * abs(bend))
                piece = abs(bend) * cut[following] / half if half > 0.0 and cut[following] > 0.0 else 0.0
            if piece <= 1e-9:
                continue
            s = piece * np.linspace(0.0, 1.0, int(np.ceil(piece / spacing_m)) + 1)[1:]
            t = heading + bend * s / piece
            middle = 0.5 * (heading + t)
            chord = s * np.sinc(0.5 * (t - heading) / np.pi)
            p = position + chord[:, None] * np.stack([np.sin(middle), np.cos(middle)], -1)
            rows.append((p, t, arc + s))
            position, heading, arc = p[-1], t[-1], arc + piece
    vertices, tangent, arcs = (np.concatenate(column) for column in zip(*rows, strict=True))
    return vertices, tangent, arcs
