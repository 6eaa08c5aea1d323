"""The faces that reflect signals into a street, and the edges that diffract them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.records import Records
from lanebound.integrity.sky.raytrace_kernel import FACE, NO_EDGE, STRONGEST
from lanebound.integrity.sky.scene import City

__all__ = ["Faces"]

ALIKE = 1e-6  # planes whose figures differ by less are one: the two triangles of a wall


@dataclass(frozen=True)
class Faces:
    """Reflecting faces and diffracting edges by station, lane and direction.

    Attributes
    ----------
    face : (N, L, A E, 2) int32, indices of the table by cell of the sky: the reflections of most power, -1 for none
    skyline_rad : (N, L, A) float32, elevation of the highest solid obstacle by azimuth, -pi/2 for none
    edge_m : (N, L, A) float32, distance of its upper edge
    table : (F,) of FACE (:mod:`.raytrace_kernel`): planes in the frame of the city
    """

    face: NDArray[np.int32]
    skyline_rad: NDArray[np.float32]
    edge_m: NDArray[np.float32]
    table: Records

    @classmethod
    def none(cls, stations: int = 0, lanes: int = 0, azimuths: int = 0, cells: int = 0) -> Self:
        """No face and no edge; without stations, the faces of a mask that is not made by ray casting."""
        around = stations, lanes, azimuths
        return cls(
            np.full((stations, lanes, cells, STRONGEST), -1, np.int32),
            np.full(around, NO_EDGE, np.float32),
            np.zeros(around, np.float32),
            np.zeros(0, FACE),
        )

    @classmethod
    def of_triangles(
        cls, city: City, found: NDArray[np.int32], skyline_rad: NDArray[np.float32], edge_m: NDArray[np.float32]
    ) -> Self:
        """Faces from indices of triangles of a city; triangles of one plane and material become one face.

        found (N, L, A E, 2), -1 for none; skyline_rad and edge_m (N, L, A).
        """
        used, which = np.unique(found, return_inverse=True)
        which, used = which.reshape(found.shape) - int(np.sum(used < 0)), used[used >= 0]
        normal = city.grid.tri[used, 9:12]
        turned = np.where(normal[:, :1] + 0.5 * normal[:, 1:2] + 0.25 * normal[:, 2:] < 0.0, -1.0, 1.0) * normal
        offset = np.sum(turned * city.grid.tri[used, :3], 1)
        planes = np.column_stack([turned, offset, city.material[used]])
        _, first, plane = np.unique(np.round(planes / ALIKE), axis=0, return_index=True, return_inverse=True)
        table = np.zeros(first.size, FACE)
        table["normal"], table["offset"], table["material"] = turned[first], offset[first], planes[first, 4]
        merged = np.append(plane.reshape(-1), -1).astype(np.int32)
        return cls(merged[which], skyline_rad, edge_m, table)

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The faces of several masks one after another along the stations."""
        begin = np.cumsum([0, *(len(part.table) for part in parts)])
        return cls(
            np.concatenate([np.where(p.face < 0, p.face, p.face + b) for p, b in zip(parts, begin[:-1], strict=True)]),
            np.concatenate([part.skyline_rad for part in parts]),
            np.concatenate([part.edge_m for part in parts]),
            np.concatenate([part.table for part in parts]),
        )

    @classmethod
    def of_arrays(cls, data: Mapping[str, NDArray[Any]]) -> Self:
        """The faces from the arrays of a file, see :meth:`as_arrays`."""
        table = np.zeros(data["face_offset"].shape[0], FACE)
        for name in FACE.names or ():
            table[name] = data[f"face_{name}"]
        return cls(data["face"], data["skyline"], data["edge"], table)

    def as_arrays(self) -> dict[str, Any]:
        """The arrays for a file, by name."""
        table = {f"face_{name}": self.table[name] for name in FACE.names or ()}
        return {"face": self.face, "skyline": self.skyline_rad, "edge": self.edge_m, **table}
