"""Intersection of rays with triangles by a grid of cells; ``tests/reference/plain_rays.py`` is the plain form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.raytrace_kernel import Grid, trace_rows

__all__ = ["Hits", "build_grid", "first_hits"]

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
