"""Numba kernels that trace rays through a uniform grid of triangles and compute sky masks.

Letters of Moeller & Trumbore (1997), S2 eq 1-2: origin ``o``, direction ``d``, triangle ``v0, v0 + e1, v0 + e2``, hit
at ``o + t d = v0 + u e1 + v e2``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import TWO_PI
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sky.propagation_kernel import arrival_direction, reflection_coefficients

__all__ = [
    "EDGE_LINE",
    "FACE",
    "MASK_RULES",
    "RECEPTION",
    "STRONGEST",
    "Grid",
    "MaskRows",
    "SatelliteRows",
    "count_free",
    "edge_rows",
    "find_cells",
    "free_rows",
    "look_up",
    "look_up_rows",
    "mask_rows",
    "side_corners",
    "trace",
    "trace_rows",
]

EDGE = 1e-12  # edges belong to the triangle, up to rounding
GRAZING = 1e-12  # a ray is parallel to a plane if the sine of the angle between them is smaller
HALVINGS = 7  # leave 3 degrees / 2^7 = 0.02 degrees
LIFT_M = 1e-6  # distance from the wall at which a reflected ray starts
LOS, FOLIAGE, REFLECTED, BLOCKED = 0, 1, 2, 3  # the values of visibility.SignalPath


MASK_RULES = record(
    spacing="of the stations [m]",
    length="of the street [m]",
    closed=("?", "the street is a loop"),
    azimuths=("i8", "number of bins"),
    elevations=("i8", "number of bins"),
)


FACE = record(
    normal=("f8", (3,), "unit vector ENU [-]"),
    offset="normal . x of the points x of the plane [m]",
    material=("i8", "value of materials.Material"),
)
"""The plane of a reflecting face."""

EDGE_LINE = record(
    point=("f8", (3,), "the point of the line that is nearest to the origin, ENU [m]"),
    along=("f8", (3,), "unit vector ENU along the line [-]"),
)
"""The line of a diffracting edge."""

STRONGEST = 2  # reflections of a cell that are kept
SIDES = 3  # of a triangle

RECEPTION = record(
    path=("u1", "value of visibility.SignalPath"),
    excess="extra path of the strongest reflection, 0 for none [m]",
    face=("i4", (STRONGEST,), "indices of the faces that reflect, -1 for none"),
    edge=("i4", "index of the upper edge of the highest obstacle in the satellite's azimuth, -1 for none"),
    planes=(FACE, (STRONGEST,), "of the faces"),
    line=(EDGE_LINE, "of the edge"),
)
"""How the signal of a satellite arrives."""


class MaskRows(NamedTuple):
    """A :class:`~lanebound.integrity.sky.visibility.SkyMask`.

    rules (1,) of MASK_RULES; path, excess (stations, lanes, cells); face (stations, lanes, cells, 2) indices of
    ``faces`` (F,) of FACE, and edge (stations, lanes, azimuths) of ``edges`` (E,) of EDGE_LINE, -1 for none. Without
    faces these two have no stations.
    """

    rules: Records
    path: NDArray[np.uint8]
    excess: NDArray[np.float32]
    face: NDArray[np.int32]
    edge: NDArray[np.int32]
    faces: Records
    edges: Records


class SatelliteRows(NamedTuple):
    """Satellites of an epoch, as in :class:`~lanebound.integrity.sky.track.SkyView`.

    los (K, S, 3); elevation, azimuth (K, S) [rad]; above (K, S); system (S,).
    """

    los: NDArray[np.float64]
    elevation: NDArray[np.float64]
    azimuth: NDArray[np.float64]
    above: NDArray[np.bool_]
    system: NDArray[np.int64]


class Grid(NamedTuple):
    """Triangles sorted into square cells of the horizontal plane.

    tri (T, 13): corner v0, edges e1 and e2, unit normal n along ``e1 x e2`` (3 each), ``|e1 x e2|``; leaf (T,) True for
    foliage, False for solid; low, high (3,) bounding box [m]; cell size [m]; nx, ny numbers of cells; first (nx ny +
    1,) and item: triangles of each cell (CSR); floor, roof (nx ny,) lowest and highest point of the cell's triangles
    [m].
    """

    tri: NDArray[np.float64]
    leaf: NDArray[np.bool_]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    cell: float
    nx: int
    ny: int
    first: NDArray[np.int64]
    item: NDArray[np.int64]
    floor: NDArray[np.float64]
    roof: NDArray[np.float64]


@jit(inline=True)
def _hit(tri, k, ox, oy, oz, dx, dy, dz, length):  # type: ignore[no-untyped-def]
    """Ray parameter t of the hit on triangle k, inf for a miss; ``length`` is the norm of the direction."""
    e1x, e1y, e1z = tri[k, 3], tri[k, 4], tri[k, 5]
    e2x, e2y, e2z = tri[k, 6], tri[k, 7], tri[k, 8]
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    det = e1x * px + e1y * py + e1z * pz
    size = abs(det)
    sign = 1.0 if det > 0.0 else -1.0
    sx, sy, sz = ox - tri[k, 0], oy - tri[k, 1], oz - tri[k, 2]
    u = sign * (sx * px + sy * py + sz * pz)
    slack = EDGE * size
    t = math.inf
    if u >= -slack and u <= size + slack and size > GRAZING * length * tri[k, 12]:
        qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
        v = sign * (dx * qx + dy * qy + dz * qz)
        if v >= -slack and u + v <= size + slack:
            reach = sign * (e2x * qx + e2y * qy + e2z * qz)
            if reach > 0.0:
                t = reach / size
    return t


@jit
def _span(o, d, low, high, start, end):  # type: ignore[no-untyped-def]
    """Part of [start, end] in which ``o + t d`` lies in [low, high]; it is empty if start > end."""
    if d == 0.0:
        return (start, end) if low <= o <= high else (1.0, 0.0)
    a, b = (low - o) / d, (high - o) / d
    return max(start, min(a, b)), min(end, max(a, b))


@jit
def trace(grid, ox, oy, oz, dx, dy, dz, any_hit):  # type: ignore[no-untyped-def]
    """Trace one ray from cell to cell: (t of the first solid hit, its triangle, t of the first foliage hit).

    Without a hit the values are inf and -1. With ``any_hit`` the search ends at the first hit of either kind.
    """
    best, which, leaf = math.inf, -1, math.inf
    start, end = _span(ox, dx, grid.low[0], grid.high[0], 0.0, math.inf)
    start, end = _span(oy, dy, grid.low[1], grid.high[1], start, end)
    start, end = _span(oz, dz, grid.low[2], grid.high[2], start, end)
    if start > end or grid.item.size == 0:
        return best, which, leaf
    cell, nx, ny = grid.cell, grid.nx, grid.ny
    tri, foliage, first, item, floor, roof = grid.tri, grid.leaf, grid.first, grid.item, grid.floor, grid.roof
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    i = min(max(int((ox + start * dx - grid.low[0]) / cell), 0), nx - 1)
    j = min(max(int((oy + start * dy - grid.low[1]) / cell), 0), ny - 1)
    step_i, step_j = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = (grid.low[0] + (i + (dx > 0.0)) * cell - ox) / dx if dx != 0.0 else math.inf
    next_y = (grid.low[1] + (j + (dy > 0.0)) * cell - oy) / dy if dy != 0.0 else math.inf
    delta_x = abs(cell / dx) if dx != 0.0 else math.inf
    delta_y = abs(cell / dy) if dy != 0.0 else math.inf
    here = start
    while True:
        leave = min(next_x, next_y)
        z0, z1 = oz + here * dz, oz + min(leave, end) * dz
        c = i * ny + j
        if min(z0, z1) <= roof[c] and max(z0, z1) >= floor[c]:
            for m in range(first[c], first[c + 1]):
                k = item[m]
                t = _hit(tri, k, ox, oy, oz, dx, dy, dz, length)
                if foliage[k]:
                    leaf = min(leaf, t)
                elif t < best:
                    best, which = t, k
            if any_hit and min(best, leaf) < math.inf:
                return best, which, leaf
        if best <= leave or leave >= end:
            return best, which, leaf
        here = leave
        if next_x < next_y:
            i += step_i
            next_x += delta_x
            if i < 0 or i >= nx:
                return best, which, leaf
        else:
            j += step_j
            next_y += delta_y
            if j < 0 or j >= ny:
                return best, which, leaf


@jit
def trace_rows(first, last, grid, origin, direction, t, which, leaf):  # type: ignore[no-untyped-def]
    """Trace rays with origin (N, 3) and direction (N, 3); write t (N,), which (N,) and leaf (N,)."""
    for r in range(first, last):
        o, d = origin[r], direction[r]
        t[r], which[r], leaf[r] = trace(grid, o[0], o[1], o[2], d[0], d[1], d[2], False)


@jit
def bin_of(azimuth, elevation, n_az, n_el):  # type: ignore[no-untyped-def]
    """Cell of a direction, -1 below the horizon; the azimuth [rad] need not lie in [0, 2 pi)."""
    if not elevation >= 0.0:
        return -1
    turn = azimuth / TWO_PI
    a = min(int((turn - math.floor(turn)) * n_az), n_az - 1)
    return a * n_el + min(int(elevation / (0.5 * math.pi) * n_el), n_el - 1)


@jit
def _keep_strongest(triangle, power, path, found, strength):  # type: ignore[no-untyped-def]
    """Enter a reflection at ``triangle`` among the strongest of a cell; of equal ones the shorter path is first.

    found (2,) triangles, -1 for none; strength (2, 2): power [-] and excess path [m] of each.
    """
    for k in range(STRONGEST):
        if found[k] < 0 or power > strength[k, 0] or (power == strength[k, 0] and path < strength[k, 1]):
            for later in range(STRONGEST - 1, k, -1):
                found[later] = found[later - 1]
                strength[later] = strength[later - 1]
            found[k] = triangle
            strength[k, 0], strength[k, 1] = power, path
            return


@jit
def _mask_at(grid, ox, oy, oz, direction, n_az, n_el, permittivity, path, excess, found):  # type: ignore[no-untyped-def]
    """Mask of one antenna: path and excess, (cells,), for rays to the cell centres ``direction`` (cells, 3).

    A blocked ray is mirrored at the first solid face, ``d' = d - 2 (d.n) n``. If the ray along d' is free, the signal
    of a satellite in that direction arrives by the reflection with the excess ``t (1 - d.d')`` (image method).
    ``found`` (cells, 2): triangles of the two reflections of most power, -1 for none; ``permittivity`` (T,) complex, of
    the triangles.
    """
    cells = direction.shape[0]
    strength = np.zeros((cells, STRONGEST, 2))
    for c in range(cells):
        excess[c] = math.inf
        found[c] = -1
    for c in range(cells):
        dx, dy, dz = direction[c, 0], direction[c, 1], direction[c, 2]
        t, k, leaf = trace(grid, ox, oy, oz, dx, dy, dz, False)
        if k < 0:
            path[c] = LOS if leaf == math.inf else FOLIAGE
            continue
        path[c] = BLOCKED
        if leaf < t:
            continue
        nx, ny, nz = grid.tri[k, 9], grid.tri[k, 10], grid.tri[k, 11]
        along = dx * nx + dy * ny + dz * nz
        rx, ry, rz = arrival_direction((dx, dy, dz), (nx, ny, nz))
        target = bin_of(math.atan2(rx, ry), math.asin(min(1.0, max(-1.0, rz))), n_az, n_el)
        if target < 0:
            continue
        extra = 2.0 * t * along * along
        lift = -LIFT_M if along > 0.0 else LIFT_M
        x, y, z = ox + t * dx + lift * nx, oy + t * dy + lift * ny, oz + t * dz + lift * nz
        solid, _, leaves = trace(grid, x, y, z, rx, ry, rz, True)
        if min(solid, leaves) < math.inf:
            continue
        excess[target] = min(excess[target], extra)
        co, cross = reflection_coefficients(abs(along), permittivity[k])
        power = abs(co) ** 2 + abs(cross) ** 2
        _keep_strongest(k, power, extra, found[target], strength[target])
    for c in range(cells):
        if excess[c] == math.inf:
            excess[c] = 0.0
        elif path[c] == BLOCKED:
            path[c] = REFLECTED


@jit
def mask_rows(first, last, grid, antenna, direction, n_az, n_el, permittivity, path, excess, found):  # type: ignore[no-untyped-def]
    """Compute the masks of antennas (P, 3): path, excess (P, cells) [m] and triangles found (P, cells, 2)."""
    for p in range(first, last):
        o = antenna[p]
        _mask_at(grid, o[0], o[1], o[2], direction, n_az, n_el, permittivity, path[p], excess[p], found[p])


@jit
def edge_rows(first, last, grid, antenna, n_az, n_el, path, edge):  # type: ignore[no-untyped-def]
    """Find the upper edge of the highest obstacle in each azimuth: edge (P, n_az), ``3 triangle + side``, -1 for none.

    ``path`` (P, cells) of the same antennas gives the highest blocked cell; the edge lies between its centre and that
    of the next cell, and is found by halving. Where the zenith is blocked there is none.
    """
    step = 0.5 * math.pi / n_el
    for p in range(first, last):
        for a in range(n_az):
            azimuth = TWO_PI * (a + 0.5) / n_az
            top = n_el - 1
            while top >= 0 and path[p, a * n_el + top] != BLOCKED and path[p, a * n_el + top] != REFLECTED:
                top -= 1
            edge[p, a] = -1
            if top < 0 or top == n_el - 1:
                continue
            low = (top + 0.5) * step
            high, k = low + step, _solid_at(grid, antenna[p], azimuth, low)
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                there = _solid_at(grid, antenna[p], azimuth, middle)
                if there >= 0:
                    low, k = middle, there
                else:
                    high = middle
            if k >= 0:  # else rounding let the ray pass
                edge[p, a] = SIDES * k + _side_between(grid.tri[k], antenna[p], azimuth, low, high)


@jit
def _ray(azimuth, elevation):  # type: ignore[no-untyped-def]
    flat = math.cos(elevation)
    return math.sin(azimuth) * flat, math.cos(azimuth) * flat, math.sin(elevation)


@jit
def _solid_at(grid, o, azimuth, elevation):  # type: ignore[no-untyped-def]
    """The first solid triangle in a direction, -1 for none."""
    d = _ray(azimuth, elevation)
    return trace(grid, o[0], o[1], o[2], d[0], d[1], d[2], False)[1]


@jit
def side_corners(tri, side):  # type: ignore[no-untyped-def]
    """The two corners of side 0, 1 or 2 of a triangle (row of Grid.tri): from v0 along e1, between the ends, back."""
    v0 = tri[0], tri[1], tri[2]
    v1, v2 = (tri[0] + tri[3], tri[1] + tri[4], tri[2] + tri[5]), (tri[0] + tri[6], tri[1] + tri[7], tri[2] + tri[8])
    if side == 0:
        return v0, v1
    return (v1, v2) if side == 1 else (v2, v0)


@jit
def _side_between(tri, o, azimuth, low, high):  # type: ignore[no-untyped-def]
    """The side of a triangle through which a ray leaves it when it is raised from elevation ``low`` to ``high``.

    The ray passes a side where ``(a x b) . d`` changes its sign, a and b from the antenna to the corners of the side.
    """
    below, above = _ray(azimuth, low), _ray(azimuth, high)
    best, found = math.inf, 0
    for side in range(SIDES):
        p, q = side_corners(tri, side)
        ax, ay, az = p[0] - o[0], p[1] - o[1], p[2] - o[2]
        bx, by, bz = q[0] - o[0], q[1] - o[1], q[2] - o[2]
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        before = cx * below[0] + cy * below[1] + cz * below[2]
        after = cx * above[0] + cy * above[1] + cz * above[2]
        if before * after <= 0.0 and abs(before) < best * abs(before - after):
            best, found = abs(before / (before - after)), side
    return found


@jit
def free_rows(first, last, grid, antenna, direction, free):  # type: ignore[no-untyped-def]
    """Trace rays from antennas (P, 3) along ``direction`` (cells, 3); write free (P, cells) bool: no hit."""
    for p in range(first, last):
        o = antenna[p]
        for c in range(direction.shape[0]):
            d = direction[c]
            solid, _, leaf = trace(grid, o[0], o[1], o[2], d[0], d[1], d[2], True)
            free[p, c] = min(solid, leaf) == math.inf


@jit
def count_free(free, arc, lane, azimuth, elevation, above, spacing, n_az, n_el):  # type: ignore[no-untyped-def]
    """Number of the S satellites with ``above`` in free cells at D places; nearest station, lane clamped.  -> (D,)."""
    stations, lanes = free.shape[0], free.shape[1]
    count = np.zeros(arc.shape[0], dtype=np.int64)
    for s in range(azimuth.shape[0]):
        c = bin_of(azimuth[s], elevation[s], n_az, n_el) if above[s] else -1
        if c < 0:
            continue
        for i in range(arc.shape[0]):
            n = int(min(max(arc[i] / spacing, 0.0), stations - 1.0) + 0.5)
            if free[n, min(max(lane[i], 0), lanes - 1), c]:
                count[i] += 1
    return count


@jit(borrows=True)
def find_cells(rules, azimuth, elevation, cells):  # type: ignore[no-untyped-def]
    """Fill the cell of each satellite (S,) of a mask with ``rules`` (MASK_RULES), -1 below the horizon."""
    for s in range(cells.shape[0]):
        cells[s] = bin_of(azimuth[s], elevation[s], rules.azimuths, rules.elevations)


@jit(borrows=True)
def look_up(mask, cells, arc, lane, out):  # type: ignore[no-untyped-def]
    """Reception ``out`` (S,) of RECEPTION in the cells (S,) of a mask (MaskRows): nearest station, lane clamped."""
    rules, stations = mask.rules[0], mask.path.shape[0]
    place = arc / rules.spacing
    if rules.closed:
        place -= math.floor(arc / rules.length) * (rules.length / rules.spacing)
        n = int(place + 0.5) % stations
    else:
        n = int(min(max(place, 0.0), stations - 1.0) + 0.5)
    row = min(max(lane, 0), mask.path.shape[1] - 1)
    for s in range(cells.shape[0]):
        c, signal = cells[s], out[s]
        signal.path, signal.excess = (mask.path[n, row, c], mask.excess[n, row, c]) if c >= 0 else (BLOCKED, 0.0)
        signal.face[0] = signal.face[1] = signal.edge = -1
        if c < 0 or mask.face.shape[0] == 0:
            continue
        for k in range(STRONGEST):
            face = mask.face[n, row, c, k]
            signal.face[k] = face
            if face >= 0:
                signal.planes[k] = mask.faces[face]
        edge = mask.edge[n, row, c // rules.elevations]
        signal.edge = edge
        if edge >= 0:
            signal.line = mask.edges[edge]


@jit
def look_up_rows(mask, sky, sight, arc, lane, out):  # type: ignore[no-untyped-def]
    """:func:`look_up` for B vehicles: sky of SatelliteRows, sight (B,) row of each in it; out (B, S) of RECEPTION."""
    cells = np.empty(out.shape[1], np.int64)
    for b in range(out.shape[0]):
        k = sight[b]
        find_cells(mask.rules[0], sky.azimuth[k], sky.elevation[k], cells)
        look_up(mask, cells, arc[b], lane[b], out[b])
