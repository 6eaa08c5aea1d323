"""Transformation from metres in the plane to pixels on the map, and shapes in the plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Camera", "oriented_box", "quads_along"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """View of the plane from above; the heading ``up_rad`` points to the top edge (North: x right, y down).

    Attributes
    ----------
    centre_m : (2,) point of the plane at ``anchor_px``
    size_px : width and height of the map
    """

    centre_m: Array
    up_rad: float
    scale_px_per_m: float
    anchor_px: tuple[float, float]
    size_px: tuple[float, float]

    @property
    def matrix(self) -> Array:
        """Rotation and scale from the plane to the screen, (2, 2) [px/m]; heading ``up_rad`` is mapped to (0, -1)."""
        turn = -0.5 * np.pi - self.up_rad
        c, s = np.cos(turn), np.sin(turn)
        return np.asarray(self.scale_px_per_m * np.array([[c, -s], [s, c]]))

    def px(self, xy_m: ArrayLike) -> Array:
        """Pixels of points in the plane.  (..., 2) -> (..., 2)."""
        return np.asarray((np.asarray(xy_m, dtype=np.float64) - self.centre_m) @ self.matrix.T + self.anchor_px)

    @property
    def reach_m(self) -> float:
        """Distance from ``centre_m`` to the farthest corner of the map."""
        w, h = self.size_px
        ax, ay = self.anchor_px
        return float(np.hypot(max(ax, w - ax), max(ay, h - ay)) / self.scale_px_per_m)

    def shows(self, corners_m: Array) -> NDArray[np.bool_]:
        """Which shapes have a corner on the map.  (n, k, 2) -> (n,)."""
        at = self.px(corners_m)
        return np.asarray(((at >= 0.0) & (at <= self.size_px)).all(-1).any(-1))

    def sees(self, middle_m: Array, radius_m: Array) -> NDArray[np.bool_]:
        """Whether circles may be visible on the map.  middle_m (n, 2), radius_m (n,) -> (n,)."""
        gap = middle_m - self.centre_m
        return np.asarray(np.hypot(gap[:, 0], gap[:, 1]) < self.reach_m + radius_m)


def oriented_box(middle_m: ArrayLike, heading_rad: ArrayLike, ahead_m: ArrayLike, side_m: ArrayLike) -> Array:
    """Corners of rectangles with these half lengths and half widths, front left first, clockwise.  (n, 4, 2).

    middle_m (n, 2), the others (n,) or scalars.
    """
    middle = np.asarray(middle_m, dtype=np.float64).reshape(-1, 1, 2)
    h = np.broadcast_to(np.asarray(heading_rad, dtype=np.float64), middle.shape[:1])
    ahead = np.stack([np.cos(h), np.sin(h)], -1)[:, None, :]
    right = np.stack([-np.sin(h), np.cos(h)], -1)[:, None, :]
    a = np.broadcast_to(np.asarray(ahead_m, dtype=np.float64), h.shape)[:, None] * np.array([1.0, 1.0, -1.0, -1.0])
    b = np.broadcast_to(np.asarray(side_m, dtype=np.float64), h.shape)[:, None] * np.array([-1.0, 1.0, 1.0, -1.0])
    return np.asarray(middle + a[..., None] * ahead + b[..., None] * right)


def quads_along(left_m: Array, right_m: Array) -> Array:
    """Quadrilaterals between two lines with n points.  (n, 2) each -> (n - 1, 4, 2)."""
    return np.stack([left_m[:-1], left_m[1:], right_m[1:], right_m[:-1]], 1)
