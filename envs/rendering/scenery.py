"""Buildings, trees and overpasses seen from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from lanebound.envs.records import xy_of
from lanebound.integrity.sky.scene import City

__all__ = ["Scenery"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_AREA_M2 = 0.01  # vertical walls have no area in the plan
CROWN_M2 = 200.0  # smaller foliage is one tree, drawn as a disc; larger foliage is drawn with its outline
OVERHEAD_M = 2.0  # vehicles can drive under a solid whose bottom is above this
MILLIMETRES = 1000.0


@dataclass(frozen=True)
class Scenery:
    """Roofs of one city as triangles in the plane, their outlines, and the crowns of its trees.

    Attributes
    ----------
    city : the city of the drawing
    roof_m : (n, 3, 2); middle_m, radius_m : circles around them, (n, 2) and (n,)
    height_m : (n,) of the whole body; leaves, overhead : (n,) bool
    edge_m : (e, 2, 2) outer edges of the roofs; edge_roof : (e,) the roof that each belongs to
    crown_m : (k, 2) middles of trees; crown_radius_m : (k,) of the disc of the same area
    """

    city: City
    roof_m: Array
    middle_m: Array
    radius_m: Array
    height_m: Array
    leaves: Bools
    overhead: Bools
    edge_m: Array
    edge_roof: NDArray[np.int64]
    crown_m: Array
    crown_radius_m: Array

    @classmethod
    def of(cls, city: City) -> Scenery:
        """Compute the drawing of a city: triangles with common corners are one body, whose upper faces are its roof."""
        triangles = city.triangles_enu_m
        plan = np.asarray(xy_of(triangles[..., :2]), dtype=np.float64)
        corner, body = _bodies(triangles)
        top, bottom = _extent(triangles[..., 2], body)
        area = _area(plan)
        roof = (area > LEAST_AREA_M2) & (triangles[..., 2].mean(1) >= 0.5 * (top + bottom))
        covered = np.bincount(body, np.where(roof, area, 0.0))[body]
        tree = roof & city.foliage & (covered < CROWN_M2)
        roof &= ~tree
        middle = plan[roof].mean(1)
        crown, crown_radius = _crowns(plan[tree].mean(1), area[tree], body[tree])
        return cls(
            city,
            plan[roof],
            middle,
            np.linalg.norm(plan[roof] - middle[:, None], axis=-1).max(-1, initial=0.0),
            top[roof],
            city.foliage[roof],
            (bottom[roof] > OVERHEAD_M) & ~city.foliage[roof],
            *_outline(plan[roof], corner[roof]),
            crown,
            crown_radius,
        )


def _area(plan: Array) -> Array:
    """Area of triangles (t, 3, 2) in the plan, (t,) [m^2]."""
    u, v = plan[:, 1] - plan[:, 0], plan[:, 2] - plan[:, 0]
    return np.asarray(0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def _crowns(middle: Array, area: Array, body: NDArray[np.int64]) -> tuple[Array, Array]:
    """Centre and radius of the disc with the area of each body of triangles, (k, 2) and (k,)."""
    _, label = np.unique(body, return_inverse=True)
    total = np.bincount(label, area)
    weighted = np.stack([np.bincount(label, area * middle[:, axis]) for axis in (0, 1)], -1)
    return weighted / total[:, None], np.sqrt(total / np.pi)


def _bodies(triangles: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of each corner (t, 3), with a tolerance of 1 mm, and of the body of each triangle (t,)."""
    if not len(triangles):
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)
    grid = np.round(triangles.reshape(-1, 3) * MILLIMETRES).astype(np.int64)
    points, corner = np.unique(grid, axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    a, b = corner[:, [0, 1]].ravel(), corner[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(a.size, dtype=np.int8), (a, b)), shape=(len(points), len(points)))
    _, label = connected_components(links, directed=False)
    return corner, np.asarray(label[corner[:, 0]], dtype=np.int64)


def _extent(z: Array, body: NDArray[np.int64]) -> tuple[Array, Array]:
    """Top and bottom of the body of each triangle.  z (t, 3), body (t,) -> (t,) each."""
    count = int(body.max(initial=-1)) + 1
    top, bottom = np.full(count, -np.inf), np.full(count, np.inf)
    np.maximum.at(top, body, z.max(1, initial=-np.inf))
    np.minimum.at(bottom, body, z.min(1, initial=np.inf))
    return top[body], bottom[body]


def _outline(roof: Array, corner: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Edges that belong to only one roof triangle, and the index of this triangle."""
    if not len(roof):
        return np.zeros((0, 2, 2)), np.zeros(0, dtype=np.int64)
    ends = np.stack([corner, np.roll(corner, -1, axis=1)], -1).reshape(-1, 2)
    sides = np.stack([roof, np.roll(roof, -1, axis=1)], 2).reshape(-1, 2, 2)
    _, first, count = np.unique(np.sort(ends, 1), axis=0, return_index=True, return_counts=True)
    alone = np.sort(first[count == 1])
    return sides[alone], np.asarray(alone // 3, dtype=np.int64)
