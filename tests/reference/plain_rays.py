"""Intersection of rays with triangles in plain NumPy, by a test of every triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.sky.raytrace import Hits
from lanebound.integrity.sky.raytrace_kernel import EDGE, GRAZING

__all__ = ["first_hits_reference", "moller_trumbore"]

Array = NDArray[np.float64]


def moller_trumbore(
    origin: ArrayLike, direction: ArrayLike, triangle: ArrayLike
) -> tuple[NDArray[np.bool_], Array, Array, Array]:
    """Intersect rays with triangles: ``o + t d = v0 + u e1 + v e2`` (Moeller & Trumbore 1997; S2 eq 1-2).

    A hit needs t > 0, u >= 0, v >= 0 and u + v <= 1 (edges belong to the triangle, to 1e-12). The direction need not be
    of unit length; t is in units of its length.

    origin (..., 3), direction (..., 3), triangle (..., 3, 3) vertices by row -> hit, t, u, v, each (...,). For a ray
    parallel to the plane t, u and v are inf or meaningless, and hit is False.
    """
    o, d, tri = (np.asarray(x, dtype=np.float64) for x in (origin, direction, triangle))
    v0 = tri[..., 0, :]
    e1, e2 = tri[..., 1, :] - v0, tri[..., 2, :] - v0
    p = np.cross(d, e2)
    det = np.sum(e1 * p, -1)
    normal = np.linalg.norm(np.cross(e1, e2), axis=-1) * np.linalg.norm(d, axis=-1)
    skew = np.abs(det) > GRAZING * normal
    inverse = np.where(skew, 1.0 / np.where(skew, det, 1.0), np.inf)
    s = o - v0
    q = np.cross(s, e1)
    with np.errstate(invalid="ignore"):
        u, v, t = (np.sum(a * b, -1) * inverse for a, b in ((s, p), (d, q), (e2, q)))
        inside = (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE)
        return skew & inside & (t > 0.0), t, u, v


def first_hits_reference(origin: ArrayLike, direction: ArrayLike, triangles: Array, foliage: NDArray[np.bool_]) -> Hits:
    """Find the first hits of N rays by a test of every triangle (T, 3, 3).  origin, direction (N, 3)."""
    o, d = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    hit, t, _, _ = moller_trumbore(o[:, None], d[:, None], triangles[None])
    t = np.where(hit, t, np.inf)
    solid = np.where(foliage, np.inf, t)
    foliage_t = np.where(foliage, t, np.inf).min(-1, initial=np.inf)
    best = solid.min(-1, initial=np.inf)
    which = np.where(np.isfinite(best), solid.argmin(-1) if solid.shape[1] else 0, -1)
    return Hits(best, which.astype(np.int64), foliage_t)
