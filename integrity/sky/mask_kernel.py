"""Numba kernels of sky masks: what is received from each cell of the sky, at the stations of a street."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import TWO_PI
from lanebound.integrity.core.records import Records, record

__all__ = [
    "BLOCKED",
    "EDGE_LINE",
    "FACE",
    "FOLIAGE",
    "LOS",
    "MASK_RULES",
    "PATH_BITS",
    "RECEPTION",
    "REFLECTED",
    "REFLECTION",
    "STRONGEST",
    "MaskRows",
    "SatelliteRows",
    "bin_of",
    "count_free",
    "find_cells",
    "look_up",
    "look_up_rows",
]

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

RECEPTION = record(
    path=("u1", "value of visibility.SignalPath"),
    excess="extra path of the strongest reflection, 0 for none [m]",
    face=("i4", (STRONGEST,), "indices of the faces that reflect, -1 for none"),
    edge=("i4", "index of the upper edge of the highest obstacle in the satellite's azimuth, -1 for none"),
    planes=(FACE, (STRONGEST,), "of the faces"),
    line=(EDGE_LINE, "of the edge"),
)
"""How the signal of a satellite arrives."""


REFLECTION = record(
    excess=("f4", "extra path of the shortest reflection [m]"),
    face=("i4", (STRONGEST,), "indices of the faces that reflect, -1 for none"),
)
"""What reflects signals of a cell of the sky."""
PATH_BITS = 2  # of the word of a cell


class MaskRows(NamedTuple):
    """A :class:`~lanebound.integrity.sky.visibility.SkyMask`: about 4 bytes for a cell, most of which reflect nothing.

    rules (1,) of MASK_RULES; cell (stations, lanes, cells): the path in the last PATH_BITS, before them the number of
    the cell among the reflecting ones of its station and lane, from 1, or 0; first (stations, lanes): where these begin
    in ``reflection`` (R,) of REFLECTION, which name ``faces`` (F,) of FACE; edge (stations, lanes, azimuths) indices of
    ``edges`` (E,) of EDGE_LINE, -1 for none. Without faces ``edge`` has no stations.
    """

    rules: Records
    cell: NDArray[np.uint16]
    first: NDArray[np.int64]
    reflection: Records
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


@jit
def bin_of(azimuth, elevation, n_az, n_el):  # type: ignore[no-untyped-def]
    """Cell of a direction, -1 below the horizon; the azimuth [rad] need not lie in [0, 2 pi)."""
    if not elevation >= 0.0:
        return -1
    turn = azimuth / TWO_PI
    a = min(int((turn - math.floor(turn)) * n_az), n_az - 1)
    return a * n_el + min(int(elevation / (0.5 * math.pi) * n_el), n_el - 1)


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
    rules, stations = mask.rules[0], mask.cell.shape[0]
    place = arc / rules.spacing
    if rules.closed:
        place -= math.floor(arc / rules.length) * (rules.length / rules.spacing)
        n = int(place + 0.5) % stations
    else:
        n = int(min(max(place, 0.0), stations - 1.0) + 0.5)
    row = min(max(lane, 0), mask.cell.shape[1] - 1)
    for s in range(cells.shape[0]):
        c, signal = cells[s], out[s]
        signal.path, signal.excess = BLOCKED, 0.0
        signal.face[0] = signal.face[1] = signal.edge = -1
        if c < 0:
            continue
        word = int(mask.cell[n, row, c])
        signal.path = word & ((1 << PATH_BITS) - 1)
        if word >> PATH_BITS > 0:
            reflection = mask.reflection[mask.first[n, row] + (word >> PATH_BITS) - 1]
            signal.excess = reflection.excess
            for k in range(STRONGEST):
                face = reflection.face[k]
                signal.face[k] = face
                if face >= 0:
                    signal.planes[k] = mask.faces[face]
        if mask.edge.shape[0] > 0:
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
