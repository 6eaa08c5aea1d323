"""Polygons with holes: cleaned rings, areas, triangles, and which points lie inside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.maps.polygons_kernel import clip_ears

__all__ = ["MOST_CORNERS", "cleaned", "crossing", "inside", "signed_area", "triangulated"]

Array = NDArray[np.float64]

MOST_CORNERS = 4000  # of one polygon: cutting it takes a time that grows with their square, 0.1 s for these
SAME_M = 0.01
SMALLER = 1e-6  # of holes; chosen, above rounding and far below a millimetre


def signed_area(ring: Array) -> float:
    """Area of a ring (n, 2), positive counter-clockwise [m^2]."""
    x, y = ring[:, 0], ring[:, 1]
    return float(0.5 * (x[:-1] @ y[1:] - y[:-1] @ x[1:] + x[-1] * y[0] - y[-1] * x[0]))


def cleaned(ring: Array, *, clockwise: bool = False) -> Array | None:
    """A ring (n, 2) without repeated points, in the wanted sense; None if less than three points or no area is left."""
    step = ring - ring[np.arange(-1, len(ring) - 1)]
    points = ring[(step * step).sum(1) > SAME_M**2]
    if len(points) < 3 or abs(area := signed_area(points)) < SAME_M:
        return None
    return np.asarray(points if (area < 0.0) == clockwise else points[::-1])


def inside(points: Array, rings: Sequence[Array]) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie in the first ring and in none of the others, which are holes: even-odd rule.  (n,)."""
    x, y = points[:, 0], points[:, 1]
    odd = np.zeros(len(points), dtype=np.bool_)
    for ring in rings:
        for (xa, ya), (xb, yb) in zip(ring, np.roll(ring, -1, 0), strict=True):
            if ya != yb:
                odd ^= ((ya > y) != (yb > y)) & (x < xa + (y - ya) / (yb - ya) * (xb - xa))
    return odd


def triangulated(rings: Sequence[Array]) -> Array:
    """Triangles (t, 3, 2), counter-clockwise, of a ring and its holes, as :func:`cleaned` makes them.

    Cuts and ears are found with holes that are smaller by a millionth, so that holes that touch have a gap.
    """
    small = [ring + SMALLER * (k > 0) * (ring.mean(0) - ring) for k, ring in enumerate(rings)]
    outline, *holes = (np.hstack(both) for both in zip(small, rings, strict=True))
    for hole in sorted(holes, key=lambda ring: float(ring[:, 0].min())):
        outline = _joined(outline, hole)
    return np.asarray(outline[clip_ears(outline[:, 0].copy(), outline[:, 1].copy()), 2:])


def crossing(line: Array, a: Array, b: Array) -> Array:
    """Where the sides of a line (n, 2) cross a segment, both inside of their ends; else NaN.  -> (n - 1, 2)."""
    p, r, s = line[:-1], np.diff(line, axis=0), b - a
    turn = r[:, 0] * s[1] - r[:, 1] * s[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((a - p)[:, 0] * s[1] - (a - p)[:, 1] * s[0]) / turn
        u = ((a - p)[:, 0] * r[:, 1] - (a - p)[:, 1] * r[:, 0]) / turn
    meets = (t > 0.0) & (t < 1.0) & (u > 0.0) & (u < 1.0)
    return np.where(meets[:, None], p + np.where(meets, t, 0.0)[:, None] * r, np.nan)


def _joined(outline: Array, hole: Array) -> Array:
    """A ring (n, 4) with a cut to a hole (m, 4) and back, from the leftmost corner of the hole by two columns.

    D. Eberly, Triangulation by ear clipping, 2002, section 3: cuts cross no other hole if holes are joined from left to
    right. The ray from the corner to the left meets a side; the cut ends at the left end of that side, or at a corner
    before it, the one nearest to the ray by its angle.
    """
    j = int(np.argmin(hole[:, 0]))
    i = _seen_from(outline[:, :2], hole[j, :2])
    return np.concatenate([outline[: i + 1], hole[j:], hole[: j + 1], outline[i:]])


def _seen_from(outline: Array, at: Array) -> int:
    """A corner of a ring (n, 2) that a place (2,) inside of it sees on its left."""
    onward, back = np.roll(outline, -1, 0), np.roll(outline, 1, 0)
    (x, y), (xn, yn) = outline.T, onward.T
    down = np.flatnonzero((y >= at[1]) & (yn <= at[1]) & (y > yn))  # sides with the inside on their right
    meets = x[down] + (at[1] - y[down]) / (yn[down] - y[down]) * (xn[down] - x[down])
    meets[meets > at[0]] = -np.inf
    if not np.isfinite(meets).any():  # a hole that is none
        return int(np.argmin(((outline - at) ** 2).sum(1)))
    side, foot = int(down[np.argmax(meets)]), np.array([meets.max(), at[1]])
    end = side if x[side] < xn[side] else (side + 1) % len(outline)
    if foot[0] == at[0]:
        return end
    tip = outline[end]
    triangle = (at, foot, tip) if at[1] < tip[1] else (foot, at, tip)  # clockwise
    before = np.all([_turn(a, b, outline) <= 0.0 for a, b in zip(triangle, np.roll(triangle, -1, 0), strict=True)], 0)
    to_next, to_back = _turn(outline, onward, at), _turn(back, outline, at)
    convex = _turn(back, outline, onward) > 0.0
    opens = np.where(convex, (to_next >= 0.0) & (to_back >= 0.0), (to_next > 0.0) | (to_back > 0.0))  # to the place
    near = np.flatnonzero(before & opens & (x < at[0]))
    if not near.size:
        return end
    slope = np.abs(y[near] - at[1]) / (at[0] - x[near])
    return int(near[np.lexsort((-x[near], slope))[0]])


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the area of triangles (..., 2), positive where c lies on the left of the line from a to b."""
    d, e = b - a, c - a
    return np.asarray(d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0])
