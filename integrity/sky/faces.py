"""The faces that reflect signals into a street, and the edges that diffract them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records
from lanebound.integrity.sky.raytrace_kernel import EDGE_LINE, FACE, SIDES, STRONGEST, side_corners
from lanebound.integrity.sky.scene import City

__all__ = ["Faces"]

ALIKE = 1e-6  # planes and lines whose figures differ by less are one: the two triangles of a wall


@dataclass(frozen=True)
class Faces:
    """Reflecting faces and diffracting edges by station, lane and direction.

    Attributes
    ----------
    face : (N, L, A E, 2) int32, indices of the table by cell of the sky: the reflections of most power, -1 for none
    edge : (N, L, A) int32, indices of ``edges``: upper edge of the highest solid obstacle by azimuth, -1 for none
    table : (F,) of FACE (:mod:`.raytrace_kernel`): planes in the frame of the city
    edges : (K,) of EDGE_LINE: lines in the frame of the city
    """

    face: NDArray[np.int32]
    edge: NDArray[np.int32]
    table: Records
    edges: Records

    @classmethod
    def none(cls, stations: int = 0, lanes: int = 0, azimuths: int = 0, cells: int = 0) -> Self:
        """No face and no edge; without stations, the faces of a mask that is not made by ray casting."""
        return cls(
            np.full((stations, lanes, cells, STRONGEST), -1, np.int32),
            np.full((stations, lanes, azimuths), -1, np.int32),
            np.zeros(0, FACE),
            np.zeros(0, EDGE_LINE),
        )

    @classmethod
    def of_triangles(cls, city: City, found: NDArray[np.int32], edge: NDArray[np.int32]) -> Self:
        """Faces and edges from indices of triangles of a city; those of one plane and material, or line, become one.

        found (N, L, A E, 2) triangles, edge (N, L, A) ``3 triangle + side``; -1 for none.
        """
        face, planes = _merged(found, lambda used: _planes(city, used))
        line, lines = _merged(edge, lambda used: _lines(city, used))
        table, edges = np.zeros(len(planes), FACE), np.zeros(len(lines), EDGE_LINE)
        table["normal"], table["offset"], table["material"] = planes[:, :3], planes[:, 3], planes[:, 4]
        edges["along"], edges["point"] = lines[:, :3], lines[:, 3:]
        return cls(face, line, table, edges)

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The faces of several masks one after another along the stations."""
        return cls(
            _renumbered([part.face for part in parts], [len(part.table) for part in parts]),
            _renumbered([part.edge for part in parts], [len(part.edges) for part in parts]),
            np.concatenate([part.table for part in parts]),
            np.concatenate([part.edges for part in parts]),
        )

    @classmethod
    def of_arrays(cls, data: Mapping[str, NDArray[Any]]) -> Self:
        """The faces from the arrays of a file, see :meth:`as_arrays`."""
        return cls(
            data["face"],
            data["edge"],
            _table({name: data[f"face_{name}"] for name in FACE.names or ()}, FACE),
            _table({name: data[f"edge_{name}"] for name in EDGE_LINE.names or ()}, EDGE_LINE),
        )

    def as_arrays(self) -> dict[str, Any]:
        """The arrays for a file, by name."""
        table = {f"face_{name}": self.table[name] for name in FACE.names or ()}
        edges = {f"edge_{name}": self.edges[name] for name in EDGE_LINE.names or ()}
        return {"face": self.face, "edge": self.edge, **table, **edges}


def _table(columns: Mapping[str, NDArray[Any]], kind: np.dtype[Any]) -> Records:
    table = np.zeros(len(next(iter(columns.values()))), kind)
    for name, column in columns.items():
        table[name] = column
    return table


def _renumbered(parts: Sequence[NDArray[np.int32]], sizes: Sequence[int]) -> NDArray[np.int32]:
    """Indices of parts in tables of ``sizes``, as indices of the joined table."""
    begin = np.cumsum([0, *sizes])[:-1]
    return np.concatenate([np.where(p < 0, p, p + b).astype(np.int32) for p, b in zip(parts, begin, strict=True)])


def _merged(
    found: NDArray[np.int32], figures: Callable[[NDArray[np.int64]], NDArray[np.float64]]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices of distinct figures in place of ``found``, -1 for none, and the figures (n, ...) of each."""
    used, which = np.unique(found, return_inverse=True)
    which, known = which.reshape(found.shape) - int(np.sum(used < 0)), used[used >= 0].astype(np.int64)
    each = figures(known)
    _, first, alike = np.unique(np.round(each / ALIKE), axis=0, return_index=True, return_inverse=True)
    return np.append(alike.reshape(-1), -1).astype(np.int32)[which], each[first]


def _turned(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (n, 3), of the two directions of each always the same one."""
    return np.where(vectors[:, :1] + 0.5 * vectors[:, 1:2] + 0.25 * vectors[:, 2:] < 0.0, -1.0, 1.0) * vectors


def _planes(city: City, triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Normal, offset and material (n, 5) of triangles."""
    normal = _turned(city.grid.tri[triangles, 9:12])
    offset = np.sum(normal * city.grid.tri[triangles, :3], 1)
    return np.column_stack([normal, offset, city.material[triangles]])


def _lines(city: City, sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Direction and nearest point to the origin (n, 6) of sides ``3 triangle + side``."""
    ends = np.array([side_corners(city.grid.tri[k // SIDES], k % SIDES) for k in sides]).reshape(-1, 2, 3)
    along = ends[:, 1] - ends[:, 0]
    along = _turned(along / np.linalg.norm(along, axis=1, keepdims=True))
    point = ends[:, 0] - np.sum(ends[:, 0] * along, 1, keepdims=True) * along
    return np.column_stack([along, point])
