"""Numba kernels that trace rays through a uniform grid of triangles, and fill sky masks (:mod:`.mask_kernel`).

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
from lanebound.integrity.sky.mask_kernel import BLOCKED, FOLIAGE, LOS, REFLECTED, STRONGEST, bin_of
from lanebound.integrity.sky.propagation_kernel import arrival_direction, reflection_coefficients

__all__ = [
    "SIDES",
    "Grid",
    "free_rows",
    "mask_rows",
    "side_corners",
    "trace",
    "trace_rows",
]

EDGE = 1e-12  # edges belong to the triangle, up to rounding
GRAZING = 1e-12  # a ray is parallel to a plane if the sine of the angle between them is smaller
HALVINGS = 7  # leave 3 degrees / 2^7 = 0.02 degrees
LIFT_M = 1e-6  # distance from the wall at which a reflected ray starts
CUT_M = 1e-6  # a plane cuts a triangle that it misses by less
SLACK_M = 1e-4  # by which the cut of a triangle is enlarged before rays are excluded; rounding is far below
PARALLEL_M = 1e-3  # a triangle of less width across a plane lies in the plane
ALIKE, ALIKE_M = 1e-12, 1e-9  # rays in directions, and from points, that differ by less are in one vertical plane


SIDES = 3  # of a triangle


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


class Fan(NamedTuple):
    """The triangles that rays in one vertical half-plane may hit, the nearest cells first.

    item (T,) indices of triangles; least, most (T,): only rays between these tangents of the elevation may hit it; seen
    (T,) number of the last half-plane in which each triangle was looked at; turn (1,) of the present one.
    """

    item: NDArray[np.int64]
    least: NDArray[np.float64]
    most: NDArray[np.float64]
    seen: NDArray[np.int64]
    turn: NDArray[np.int64]


@jit
def _new_fan(triangles):  # type: ignore[no-untyped-def]
    """Scratch for a city of so many triangles."""
    count = np.zeros(triangles, np.int64), np.zeros(triangles, np.int64)
    return Fan(count[0], np.zeros(triangles), np.zeros(triangles), count[1], np.zeros(1, np.int64))


@jit
def _cut(tri, k, x, y, ux, uy):  # type: ignore[no-untyped-def]
    """Box of the cut of triangle k by the vertical plane through (x, y) along the unit vector (ux, uy).

    -> nearest and farthest point along the plane, lowest and highest point [m]; nearest > farthest for no cut.
    """
    ax, ay, az = tri[k, 0] - x, tri[k, 1] - y, tri[k, 2]
    bx, by, bz = ax + tri[k, 3], ay + tri[k, 4], az + tri[k, 5]
    cx, cy, cz = ax + tri[k, 6], ay + tri[k, 7], az + tri[k, 8]
    la, lb, lc = ax * uy - ay * ux, bx * uy - by * ux, cx * uy - cy * ux
    left, right = min(la, lb, lc), max(la, lb, lc)
    near, far, low, high = math.inf, -math.inf, math.inf, -math.inf
    if left > CUT_M or right < -CUT_M:
        return near, far, low, high
    reach = CUT_M if right - left >= PARALLEL_M else math.inf
    a, b, c = (la, ax * ux + ay * uy, az), (lb, bx * ux + by * uy, bz), (lc, cx * ux + cy * uy, cz)
    for p, q in ((a, b), (b, c), (c, a)):
        if abs(p[0]) <= reach:
            near, far, low, high = min(near, p[1]), max(far, p[1]), min(low, p[2]), max(high, p[2])
        if p[0] * q[0] < 0.0:
            share = p[0] / (p[0] - q[0])
            r, z = p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])
            near, far, low, high = min(near, r), max(far, r), min(low, z), max(high, z)
    return near, far, low, high


@jit
def _gather(grid, x, y, z, back, ux, uy, least, most, fan):  # type: ignore[no-untyped-def]
    """Fill ``fan`` with the triangles that rays of a vertical half-plane may hit; their number.

    The rays pass height z at the distance ``back`` behind (x, y), where they begin, rise between the tangents ``least``
    and ``most``, and go along (ux, uy). The plane of an azimuth has few triangles: rays share the walk through cells.
    """
    count = 0
    start, end = _span(x, ux, grid.low[0], grid.high[0], 0.0, math.inf)
    start, end = _span(y, uy, grid.low[1], grid.high[1], start, end)
    if least > 0.0:
        end = min(end, (grid.high[2] - z) / least - back)
    if start > end or grid.item.size == 0:
        return count
    fan.turn[0] += 1
    turn, cell, nx, ny = fan.turn[0], grid.cell, grid.nx, grid.ny
    i = min(max(int((x + start * ux - grid.low[0]) / cell), 0), nx - 1)
    j = min(max(int((y + start * uy - grid.low[1]) / cell), 0), ny - 1)
    step_i, step_j = (1 if ux > 0.0 else -1), (1 if uy > 0.0 else -1)
    next_x = (grid.low[0] + (i + (ux > 0.0)) * cell - x) / ux if ux != 0.0 else math.inf
    next_y = (grid.low[1] + (j + (uy > 0.0)) * cell - y) / uy if uy != 0.0 else math.inf
    delta_x = abs(cell / ux) if ux != 0.0 else math.inf
    delta_y = abs(cell / uy) if uy != 0.0 else math.inf
    here = start
    while True:
        c = i * ny + j
        if z + (back + here) * least - SLACK_M <= grid.roof[c]:
            for m in range(grid.first[c], grid.first[c + 1]):
                k = grid.item[m]
                if fan.seen[k] == turn:
                    continue
                fan.seen[k] = turn
                near, far, low, high = _cut(grid.tri, k, x, y, ux, uy)
                if far < -SLACK_M:  # behind the rays, or not cut
                    continue
                near, far = back + near - SLACK_M, back + far + SLACK_M
                low, high = low - z - SLACK_M, high - z + SLACK_M
                under, over = -math.inf, math.inf  # of a triangle above the begin of the rays
                if near > SLACK_M:
                    under, over = low / (far if low > 0.0 else near), high / (near if high > 0.0 else far)
                if over >= least and under <= most:
                    fan.item[count], fan.least[count], fan.most[count] = k, under, over
                    count += 1
        leave = min(next_x, next_y)
        if leave >= end:
            return count
        here = leave
        if next_x < next_y:
            i += step_i
            next_x += delta_x
            if i < 0 or i >= nx:
                return count
        else:
            j += step_j
            next_y += delta_y
            if j < 0 or j >= ny:
                return count


@jit
def _meet(grid, fan, count, tangent, o, d, any_hit):  # type: ignore[no-untyped-def]
    """:func:`trace` of a ray among the first ``count`` triangles of a fan; ``tangent``: of its elevation."""
    best, which, leaf = math.inf, -1, math.inf
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for n in range(count):
        if not fan.least[n] <= tangent <= fan.most[n]:
            continue
        k = fan.item[n]
        t = _hit(grid.tri, k, o[0], o[1], o[2], d[0], d[1], d[2], length)
        if grid.leaf[k]:
            leaf = min(leaf, t)
        elif t < best:
            best, which = t, k
        if any_hit and t < math.inf:
            break
    return best, which, leaf


class Bounces(NamedTuple):
    """The reflected rays of an azimuth, in the order of their elevations: at most E.

    begin, way (E, 3) point and direction; rise (E,) tangent of the elevation; cell (E,) that the way points to;
    triangle (E,) that reflects; extra (E,) excess path [m]; power (E,) of the reflection [-].
    """

    begin: NDArray[np.float64]
    way: NDArray[np.float64]
    rise: NDArray[np.float64]
    cell: NDArray[np.int64]
    triangle: NDArray[np.int64]
    extra: NDArray[np.float64]
    power: NDArray[np.float64]


@jit
def _new_bounces(n_el):  # type: ignore[no-untyped-def]
    """Scratch for so many elevations."""
    whole, real = np.zeros((2, n_el), np.int64), np.zeros((3, n_el))
    return Bounces(np.zeros((n_el, 3)), np.zeros((n_el, 3)), real[0], whole[0], whole[1], real[1], real[2])


@jit
def _bounce(grid, o, d, t, k, n_az, n_el, permittivity, bounces, count):  # type: ignore[no-untyped-def]
    """Enter the reflection of a ray at triangle k as the next of ``bounces``; their number.

    The direction d is mirrored, ``d' = d - 2 (d.n) n``. A satellite along d' is received with the excess ``t (1 -
    d.d')`` (image method), unless d' points below the horizon.
    """
    nx, ny, nz = grid.tri[k, 9], grid.tri[k, 10], grid.tri[k, 11]
    along = d[0] * nx + d[1] * ny + d[2] * nz
    rx, ry, rz = arrival_direction((d[0], d[1], d[2]), (nx, ny, nz))
    target = bin_of(math.atan2(rx, ry), math.asin(min(1.0, max(-1.0, rz))), n_az, n_el)
    if target < 0:
        return count
    lift = -LIFT_M if along > 0.0 else LIFT_M
    bounces.begin[count, 0] = o[0] + t * d[0] + lift * nx
    bounces.begin[count, 1] = o[1] + t * d[1] + lift * ny
    bounces.begin[count, 2] = o[2] + t * d[2] + lift * nz
    bounces.way[count, 0], bounces.way[count, 1], bounces.way[count, 2] = rx, ry, rz
    flat = math.hypot(rx, ry)
    bounces.rise[count] = rz / flat if flat > 0.0 else math.inf
    bounces.cell[count], bounces.triangle[count], bounces.extra[count] = target, k, 2.0 * t * along * along
    co, cross = reflection_coefficients(abs(along), permittivity[k])
    bounces.power[count] = abs(co) ** 2 + abs(cross) ** 2
    return count + 1


@jit
def _alike(bounces, m, n, z, back):  # type: ignore[no-untyped-def]
    """Whether reflected ray n rises from the image of the antenna, at height z and ``back`` behind, beside ray m."""
    p, q, v, w = bounces.begin[m], bounces.begin[n], bounces.way[m], bounces.way[n]
    turn = abs(v[0] * w[1] - v[1] * w[0])
    apart = max(abs(p[0] - q[0]), abs(p[1] - q[1]))
    same = v[0] * w[0] + v[1] * w[1] > 0.0 and turn <= ALIKE and apart <= ALIKE_M
    return same and bounces.rise[n] >= bounces.rise[m] and abs(z + back * bounces.rise[n] - q[2]) <= SLACK_M / 2.0


@jit
def _drop_hidden(grid, o, bounces, count, fan):  # type: ignore[no-untyped-def]
    """Set the power of reflected rays that hit something to -1; rays at one wall share a fan."""
    m = 0
    while m < count:
        x, y, z, rise = bounces.begin[m, 0], bounces.begin[m, 1], bounces.begin[m, 2], bounces.rise[m]
        back, last = math.hypot(x - o[0], y - o[1]), m + 1
        if rise < math.inf and _alike(bounces, m, m, o[2], back):
            z = o[2]
            while last < count and _alike(bounces, m, last, z, back):
                last += 1
        else:
            back = 0.0
        flat = math.hypot(bounces.way[m, 0], bounces.way[m, 1])
        found = 0
        if rise < math.inf:
            ux, uy = bounces.way[m, 0] / flat, bounces.way[m, 1] / flat
            found = _gather(grid, x, y, z, back, ux, uy, rise, bounces.rise[last - 1], fan)
        for n in range(m, last):
            p, d = bounces.begin[n], bounces.way[n]
            if rise < math.inf:
                solid, _, leaf = _meet(grid, fan, found, bounces.rise[n], p, d, True)
            else:
                solid, _, leaf = trace(grid, p[0], p[1], p[2], d[0], d[1], d[2], True)
            if min(solid, leaf) < math.inf:
                bounces.power[n] = -1.0
        m = last


@jit
def _mask_at(grid, o, direction, n_az, n_el, permittivity, path, excess, found, edge, fan, bounces):  # type: ignore[no-untyped-def]
    """Mask of one antenna o (3,): path and excess, (cells,), for rays to the cell centres ``direction`` (cells, 3).

    ``found`` (cells, 2): triangles of the two reflections of most power, -1 for none; ``permittivity`` (T,) complex, of
    the triangles; edge (n_az,) upper edges. ``fan`` and ``bounces`` are scratch.
    """
    cells = direction.shape[0]
    strength = np.zeros((cells, STRONGEST, 2))
    for c in range(cells):
        excess[c] = math.inf
        found[c] = -1
    for a in range(n_az):
        ux, uy, lowest, highest = _plane_of(direction, a, n_el)
        count, reflected = _gather(grid, o[0], o[1], o[2], 0.0, ux, uy, lowest, highest, fan), 0
        top = -1
        for e in range(n_el):
            c = a * n_el + e
            d = direction[c]
            t, k, leaf = _meet(grid, fan, count, d[2] / math.hypot(d[0], d[1]), o, d, False)
            if k < 0:
                path[c] = LOS if leaf == math.inf else FOLIAGE
                continue
            path[c], top = BLOCKED, e
            if not leaf < t:
                reflected = _bounce(grid, o, d, t, k, n_az, n_el, permittivity, bounces, reflected)
        edge[a] = _edge_of(grid, o, TWO_PI * (a + 0.5) / n_az, top, n_el, fan, count)
        _drop_hidden(grid, o, bounces, reflected, fan)
        for n in range(reflected):
            target, extra = bounces.cell[n], bounces.extra[n]
            if bounces.power[n] >= 0.0:
                excess[target] = min(excess[target], extra)
                _keep_strongest(bounces.triangle[n], bounces.power[n], extra, found[target], strength[target])
    for c in range(cells):
        if excess[c] == math.inf:
            excess[c] = 0.0
        elif path[c] == BLOCKED:
            path[c] = REFLECTED


@jit
def _plane_of(direction, a, n_el):  # type: ignore[no-untyped-def]
    """Unit vector along the plane of azimuth a, and the tangents of the elevations of its lowest and highest cell."""
    d, e = direction[a * n_el], direction[a * n_el + n_el - 1]
    flat = math.hypot(d[0], d[1])
    return d[0] / flat, d[1] / flat, d[2] / flat, e[2] / math.hypot(e[0], e[1])


@jit
def mask_rows(first, last, grid, antenna, direction, n_az, n_el, permittivity, path, excess, found, edge):  # type: ignore[no-untyped-def]
    """Compute the masks of antennas (P, 3).

    path, excess (P, cells) [m]; triangles found (P, cells, 2); edge (P, n_az), ``3 triangle + side`` of the upper edge
    of the highest obstacle in each azimuth; -1 for none.
    """
    fan, bounces = _new_fan(grid.tri.shape[0]), _new_bounces(n_el)
    for p in range(first, last):
        _mask_at(
            grid, antenna[p], direction, n_az, n_el, permittivity, path[p], excess[p], found[p], edge[p], fan, bounces
        )


@jit
def _edge_of(grid, o, azimuth, top, n_el, fan, count):  # type: ignore[no-untyped-def]
    """``3 triangle + side`` of the upper edge of the highest obstacle in an azimuth, whose triangles are in ``fan``.

    ``top`` is the highest blocked cell, -1 for none; the edge lies between its centre and that of the next cell, and is
    found by halving. -1 where nothing is blocked, or the zenith is.
    """
    if top < 0 or top == n_el - 1:
        return -1
    step = 0.5 * math.pi / n_el
    low = (top + 0.5) * step
    high, k = low + step, _solid_at(grid, o, azimuth, low, fan, count)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        there = _solid_at(grid, o, azimuth, middle, fan, count)
        if there >= 0:
            low, k = middle, there
        else:
            high = middle
    if k < 0:  # rounding let the ray pass
        return -1
    return SIDES * k + _side_between(grid.tri[k], o, azimuth, low, high)


@jit
def _ray(azimuth, elevation):  # type: ignore[no-untyped-def]
    flat = math.cos(elevation)
    return math.sin(azimuth) * flat, math.cos(azimuth) * flat, math.sin(elevation)


@jit
def _solid_at(grid, o, azimuth, elevation, fan, count):  # type: ignore[no-untyped-def]
    """The first solid triangle in a direction, of those of a fan; -1 for none."""
    return _meet(grid, fan, count, math.tan(elevation), o, _ray(azimuth, elevation), False)[1]


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
def free_rows(first, last, grid, antenna, direction, n_el, free):  # type: ignore[no-untyped-def]
    """Trace rays from antennas (P, 3) along ``direction`` (cells, 3); write free (P, cells) bool: no hit."""
    fan = _new_fan(grid.tri.shape[0])
    for p in range(first, last):
        o = antenna[p]
        for a in range(direction.shape[0] // n_el):
            ux, uy, lowest, highest = _plane_of(direction, a, n_el)
            count = _gather(grid, o[0], o[1], o[2], 0.0, ux, uy, lowest, highest, fan)
            for c in range(a * n_el, (a + 1) * n_el):
                d = direction[c]
                solid, _, leaf = _meet(grid, fan, count, d[2] / math.hypot(d[0], d[1]), o, d, True)
                free[p, c] = min(solid, leaf) == math.inf
