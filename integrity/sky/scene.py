"""The obstacles around a street, as triangles that are solid or foliage."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.materials import Material
from lanebound.integrity.sky.raytrace import build_grid
from lanebound.integrity.sky.raytrace_kernel import Grid

__all__ = ["City", "Surface", "prisms"]

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
    material : (T,) int64, values of :class:`~lanebound.integrity.sky.materials.Material`; concrete is the default
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

    @property
    def buildings(self) -> int:
        """Number of numbered buildings."""
        return int(self.building.max(initial=-1)) + 1

    @property
    def foliage(self) -> NDArray[np.bool_]:
        """Whether each triangle is foliage, (T,)."""
        return np.asarray(self.surface == Surface.FOLIAGE)

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
