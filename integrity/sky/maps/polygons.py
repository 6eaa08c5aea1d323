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
NEAREST = 400  # pairs of corners that are tried for the cut to a hole


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
    """Triangles (t, 3, 2), counter-clockwise, of a ring and its holes, as :func:`cleaned` makes them."""
    outline = rings[0]
    for hole in sorted(rings[1:], key=lambda ring: -float(ring[:, 0].max())):
        outline = _joined(outline, hole)
    return np.asarray(outline[clip_ears(outline[:, 0].copy(), outline[:, 1].copy())])


def crossing(line: Array, a: Array, b: Array) -> Array:
    """Where the sides of a line (n, 2) cross a segment; NaN where they do not.  -> (n - 1, 2)."""
    p, r, s = line[:-1], np.diff(line, axis=0), b - a
    turn = r[:, 0] * s[1] - r[:, 1] * s[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((a - p)[:, 0] * s[1] - (a - p)[:, 1] * s[0]) / turn
        u = ((a - p)[:, 0] * r[:, 1] - (a - p)[:, 1] * r[:, 0]) / turn
    meets = (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    return np.where(meets[:, None], p + np.where(meets, t, 0.0)[:, None] * r, np.nan)


def _joined(outline: Array, hole: Array) -> Array:
    """A ring with a cut to a hole and back; of the shortest cuts the first that crosses no side."""
    sides = [(ring, np.roll(ring, -1, 0)) for ring in (outline, hole)]
    begin, end = (np.concatenate(part) for part in zip(*sides, strict=True))
    away = np.linalg.norm(outline[:, None] - hole[None], axis=-1)
    nearest = np.argsort(away, axis=None, kind="stable")[:NEAREST]
    i, j = np.unravel_index(nearest[0], away.shape)
    for pair in nearest:
        a, b = np.unravel_index(pair, away.shape)
        if not _crosses(outline[a], hole[b], begin, end):
            i, j = a, b
            break
    return np.concatenate([outline[: i + 1], hole[j:], hole[: j + 1], outline[i:]])


def _crosses(p: Array, q: Array, begin: Array, end: Array) -> bool:
    """Whether a segment properly crosses one of many (n, 2)."""

    def side(a: Array, b: Array, c: Array) -> Array:
        d, e = b - a, c - a
        return np.asarray(d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0])

    across = side(p, q, begin) * side(p, q, end) < 0.0
    return bool(np.any(across & (side(begin, end, p) * side(begin, end, q) < 0.0)))
