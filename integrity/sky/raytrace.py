"""Intersection of rays with triangles: a plain reference, and fast tracing through a grid of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.raytrace_kernel import EDGE, GRAZING, Grid, trace_rows

__all__ = ["Hits", "build_grid", "first_hits", "first_hits_reference", "moller_trumbore"]

Array = NDArray[np.float64]

MAX_CELLS = 4_000_000


@dataclass(frozen=True)
class Hits:
    """First hits of N rays, each array (N,).

    Attributes
    ----------
    t : ray parameter of the first solid hit, inf for none
    triangle : index of the triangle hit, -1 for none
    foliage_t : ray parameter of the first foliage hit; a value larger than ``t`` has no meaning
    """

    t: Array
    triangle: NDArray[np.int64]
    foliage_t: Array

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Whether no solid triangle is hit.  (N,)."""
        return self.triangle < 0


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


def build_grid(triangles: ArrayLike, foliage: ArrayLike, cell_m: float = 10.0) -> Grid:
    """Sort triangles (T, 3, 3) [m] into square cells; ``foliage`` (T,) is True for foliage. T may be 0.

    Triangles without area are ignored.

    Raises
    ------
    InputError
        An entry is not finite, or a shape is wrong.
    """
    tri = require_finite("triangles", triangles)
    require_shape("triangles", tri, (3, 3))
    leaf = np.asarray(foliage, dtype=np.bool_)
    if tri.ndim != 3 or leaf.shape != tri.shape[:1]:
        raise InputError(f"foliage must have shape ({tri.shape[0]},), got {leaf.shape}: one flag for each triangle")
    v0 = tri[:, 0]
    e1, e2 = tri[:, 1] - v0, tri[:, 2] - v0
    normal = np.cross(e1, e2)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = normal / np.where(size > 0.0, size, 1.0)
    low3, high3 = (tri.min(1), tri.max(1)) if tri.size else (np.zeros((0, 3)), np.zeros((0, 3)))
    margin = 1e-6
    low = low3.min(0, initial=np.inf, where=True) - margin if tri.size else np.zeros(3)
    high = high3.max(0, initial=-np.inf, where=True) + margin if tri.size else np.zeros(3)
    extent = high[:2] - low[:2]
    cell = max(cell_m, float(np.sqrt(extent[0] * extent[1] / MAX_CELLS)))
    nx, ny = (int(np.ceil(x / cell)) or 1 for x in extent)
    used = np.flatnonzero(size[:, 0] > 0.0)
    first, item = _triangles_by_cell(
        low3[used, :2] - margin - low[:2], high3[used, :2] + margin - low[:2], used, cell, nx, ny
    )
    owner = np.repeat(np.arange(nx * ny), np.diff(first))
    floor, roof = np.full(nx * ny, np.inf), np.full(nx * ny, -np.inf)
    np.minimum.at(floor, owner, low3[item, 2] - margin)
    np.maximum.at(roof, owner, high3[item, 2] + margin)
    return Grid(np.hstack([v0, e1, e2, normal, size]), leaf, low, high, cell, nx, ny, first, item, floor, roof)


def _triangles_by_cell(
    low: Array, high: Array, ids: NDArray[np.int64], cell: float, nx: int, ny: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles that touch each cell, in CSR form; ``low`` and ``high`` (n, 2): bounding boxes from the grid corner."""
    size = np.array([nx, ny])
    a = np.clip(np.floor(low / cell).astype(np.int64), 0, size - 1)
    b = np.clip(np.floor(high / cell).astype(np.int64), 0, size - 1)
    wide = b - a + 1
    each = wide[:, 0] * wide[:, 1]
    owner = np.repeat(np.arange(ids.size), each)
    nth = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    i = a[owner, 0] + nth // wide[owner, 1]
    j = a[owner, 1] + nth % wide[owner, 1]
    c = i * ny + j
    order = np.argsort(c, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(c, minlength=nx * ny))]).astype(np.int64)
    return first, ids[owner[order]].astype(np.int64)


def first_hits(grid: Grid, origin: ArrayLike, direction: ArrayLike) -> Hits:
    """Find the first hits of rays through a grid.

    origin (..., 3) and direction (..., 3) are broadcast; N is the number of rays after broadcasting, in C order.

    Raises
    ------
    InputError
        An entry is not finite, or a shape is wrong.
    """
    o, d = require_finite("origin", origin), require_finite("direction", direction)
    require_shape("origin", o, (3,))
    require_shape("direction", d, (3,))
    o, d = (np.ascontiguousarray(x).reshape(-1, 3) for x in np.broadcast_arrays(o, d))
    n = o.shape[0]
    hits = Hits(np.empty(n), np.empty(n, dtype=np.int64), np.empty(n))
    run_rows(trace_rows, n, grid, o, d, hits.t, hits.triangle, hits.foliage_t, row_us=0.5)
    return hits
