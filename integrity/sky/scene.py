"""The obstacles around a street, as triangles that are solid or foliage: the faces that reflect signals into the
street, the edges that diffract them, and the materials of facades.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.sky.mask_kernel import EDGE_LINE, FACE, STRONGEST
from lanebound.integrity.sky.propagation_kernel import permittivity
from lanebound.integrity.sky.raytrace import build_grid
from lanebound.integrity.sky.raytrace_kernel import SIDES, Grid, side_corners

__all__ = ["MATERIAL", "City", "Faces", "Material", "Surface", "clad", "material_table", "permittivities", "prisms"]


ALIKE = 1e-6  # planes and lines whose figures differ by less are one: the two triangles of a wall


@dataclass(frozen=True)
class Faces:
    """Reflecting faces and diffracting edges by station, lane and direction.

    Attributes
    ----------
    face : (N, L, A E, 2) int32, indices of the table by cell of the sky: the reflections of most power, -1 for none
    edge : (N, L, A) int32, indices of ``edges``: upper edge of the highest solid obstacle by azimuth, -1 for none
    table : (F,) of FACE (:mod:`.mask_kernel`): planes in the frame of the city
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

        found (..., A E, 2) triangles, edge (..., A) ``3 triangle + side``; -1 for none.
        """
        face, planes = _merged(found, lambda used: _planes(city, used))
        line, lines = _merged(edge, lambda used: _lines(city, used))
        table, edges = np.zeros(len(planes), FACE), np.zeros(len(lines), EDGE_LINE)
        table["normal"], table["offset"], table["material"] = planes[:, :3], planes[:, 3], planes[:, 4]
        edges["along"], edges["point"] = lines[:, :3], lines[:, 3:]
        return cls(face, line, table, edges)


def _merged(
    found: NDArray[np.int32], figures: Callable[[NDArray[np.int64]], NDArray[np.float64]]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices of distinct figures in place of ``found``, -1 for none, and the figures (n, ...) of each."""
    present = np.zeros(int(found.max(initial=-1)) + 2, dtype=np.bool_)
    present[found + 1] = True
    known = np.flatnonzero(present[1:])
    each = figures(known)
    _, first, alike = np.unique(np.round(each / ALIKE), axis=0, return_index=True, return_inverse=True)
    numbers = np.full(present.size, -1, dtype=np.int32)
    numbers[1 + known] = alike.reshape(-1)
    return numbers[found + 1], each[first]


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


MATERIAL = record(
    relative="relative permittivity [-]",
    conductivity="at 1 GHz [S/m]",
    exponent="of the frequency in GHz, by which the conductivity grows [-]",
    roughness_m="standard deviation of the face's height [m]",
)


class Material(IntEnum):
    """What a face is made of."""

    CONCRETE = 0
    GLASS = 1
    BRICK = 2
    METAL = 3


# Relative permittivity and conductivity ``c f^d``: ITU-R P.2040-3, table 3 (glass, brick, concrete, metal; 1-100 GHz).
# Roughness: chosen, plaster and balconies 20 mm, panes and panels 2 mm, masonry 10 mm.
_FIGURES = {
    Material.CONCRETE: (5.24, 0.0462, 0.7822, 0.020),
    Material.GLASS: (6.31, 0.0036, 1.3394, 0.002),
    Material.BRICK: (3.91, 0.0238, 0.16, 0.010),
    Material.METAL: (1.0, 1.0e7, 0.0, 0.002),
}


def material_table() -> Records:
    """Records MATERIAL in the order of :class:`Material`."""
    return np.array([_FIGURES[m] for m in Material], dtype=MATERIAL)


def permittivities(materials: Records, frequency_hz: float) -> NDArray[np.complex128]:
    """Complex relative permittivity of each material at a frequency (ITU-R P.2040-3, eq 9 and 29).  (M,)."""
    conductivity = materials["conductivity"] * (1e-9 * frequency_hz) ** materials["exponent"]
    return np.array(
        [permittivity(r, c, frequency_hz) for r, c in zip(materials["relative"], conductivity, strict=True)]
    )


def clad(building: NDArray[np.int64], shares: Sequence[float], rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw the material of each building, and give it to its triangles.

    building (T,), -1 for none, which is concrete; shares of the materials in the order of :class:`Material`, one draw
    for each building.  -> (T,) values of Material.
    """
    count = int(building.max(initial=-1)) + 1
    drawn = np.searchsorted(np.cumsum(shares)[:-1] / np.sum(shares), rng.random(count), side="right")
    return np.append(drawn, int(Material.CONCRETE))[building]


Array = NDArray[np.float64]

# Corners 0-3 are the footprint in order, 4-7 the same corners at the top.
_SIDES = ((0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7))
_ENDS = ((4, 5, 6), (4, 6, 7), (0, 2, 1), (0, 3, 2))
_UNNAMED: NDArray[np.int64] = np.zeros(0, dtype=np.int64)


class Surface(IntEnum):
    """Effect of a triangle on a signal: a solid blocks and reflects it, foliage attenuates it."""

    SOLID = 0
    FOLIAGE = 1


@dataclass(frozen=True)
class City:
    """Triangles around a street.

    Attributes
    ----------
    triangles_enu_m : (T, 3, 3) [m], vertices by row
    surface : (T,) uint8, values of :class:`Surface`
    building : (T,) int64, number of the building that a triangle belongs to, -1 for none (the default)
    material : (T,) int64, values of :class:`~lanebound.integrity.sky.scene.Material`; concrete is the default
    """

    triangles_enu_m: Array
    surface: NDArray[np.uint8]
    building: NDArray[np.int64] = field(default_factory=lambda: _UNNAMED)
    material: NDArray[np.int64] = field(default_factory=lambda: _UNNAMED)

    def __post_init__(self) -> None:
        triangles = require_finite("triangles_enu_m", self.triangles_enu_m)
        require_shape("triangles_enu_m", triangles, (3, 3))
        if self.building is _UNNAMED:
            object.__setattr__(self, "building", np.full(triangles.shape[0], -1))
        if self.material is _UNNAMED:
            object.__setattr__(self, "material", np.full(triangles.shape[0], int(Material.CONCRETE)))
        for name, array in (("surface", self.surface), ("building", self.building), ("material", self.material)):
            if triangles.ndim != 3 or array.shape != triangles.shape[:1]:
                raise InputError(
                    f"{name} must have shape ({triangles.shape[0]},), got {array.shape}: one for each triangle"
                )

    def __len__(self) -> int:
        return int(self.surface.shape[0])

    @classmethod
    def empty(cls) -> City:
        """A city without obstacles."""
        return cls(np.zeros((0, 3, 3)), np.zeros(0, dtype=np.uint8))

    @classmethod
    def of(cls, triangles_enu_m: ArrayLike, surface: Surface = Surface.SOLID) -> City:
        """A city of triangles (T, 3, 3) [m] with the same surface."""
        triangles = np.asarray(triangles_enu_m, dtype=np.float64)
        return cls(triangles, np.full(triangles.shape[0], int(surface), dtype=np.uint8))

    @classmethod
    def of_buildings(cls, footprint_en_m: ArrayLike, height_m: ArrayLike) -> City:
        """A city of vertical, numbered buildings on four-cornered footprints (n, 4, 2) [m] with heights (n,) [m]."""
        walls = prisms(footprint_en_m, 0.0, height_m)
        each = len(_SIDES) + len(_ENDS[:2])
        return cls(walls, np.zeros(len(walls), dtype=np.uint8), np.arange(len(walls)) // each)

    def __add__(self, other: City) -> City:
        """The obstacles of both cities; the building numbers of ``other`` continue those of this city."""
        renumbered = np.where(other.building < 0, -1, other.building + self.buildings)
        return City(
            np.concatenate([self.triangles_enu_m, other.triangles_enu_m]),
            np.concatenate([self.surface, other.surface]),
            np.concatenate([self.building, renumbered]),
            np.concatenate([self.material, other.material]),
        )

    def moved(self, east_m: float, north_m: float) -> City:
        """The same city elsewhere."""
        if not (east_m or north_m):
            return self
        return replace(self, triangles_enu_m=self.triangles_enu_m + np.array([east_m, north_m, 0.0]))

    @property
    def buildings(self) -> int:
        """Number of numbered buildings."""
        return int(self.building.max(initial=-1)) + 1

    @property
    def foliage(self) -> NDArray[np.bool_]:
        """Whether each triangle is foliage, (T,)."""
        return np.asarray(self.surface == Surface.FOLIAGE)

    @cached_property
    def digest(self) -> str:
        """Digest of all arrays; equal cities have equal digests."""
        h = hashlib.blake2b(digest_size=16)
        for array in (self.triangles_enu_m, self.surface, self.building, self.material):
            h.update(np.ascontiguousarray(array).tobytes())
        return h.hexdigest()

    @cached_property
    def grid(self) -> Grid:
        """The triangles sorted for ray tracing."""
        return build_grid(self.triangles_enu_m, self.foliage)


def prisms(footprint_en_m: ArrayLike, bottom_m: ArrayLike, top_m: ArrayLike, *, floor: bool = False) -> Array:
    """Build vertical prisms on four-cornered footprints.

    footprint_en_m (n, 4, 2) corners in order, bottom_m and top_m (n,) -> (n k, 3, 3) triangles [m]: four walls and a
    roof (k = 10), and with ``floor`` the underside (k = 12).
    """
    foot = np.asarray(footprint_en_m, dtype=np.float64).reshape(-1, 4, 2)
    n = foot.shape[0]
    heights = np.stack([np.broadcast_to(np.asarray(z, dtype=np.float64), (n,)) for z in (bottom_m, top_m)], 1)
    corners = np.empty((n, 8, 3))
    corners[:, :4, :2] = corners[:, 4:, :2] = foot
    corners[:, :4, 2], corners[:, 4:, 2] = heights[:, :1], heights[:, 1:]
    faces = np.array(_SIDES + (_ENDS if floor else _ENDS[:2]))
    return np.asarray(corners[:, faces].reshape(-1, 3, 3))
