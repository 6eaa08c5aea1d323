"""The obstacles of a street map: walls and roofs of its buildings, crowns of its trees, bridges above a way."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import StreetConfig
from lanebound.integrity.sky.maps.polygons import crossing, inside, triangulated
from lanebound.integrity.sky.maps.records import Solid, StreetMap, StreetWay, Tree
from lanebound.integrity.sky.scene import City, Surface, prisms

__all__ = ["bridges_above", "city_of", "in_buildings"]

Array = NDArray[np.float64]

CLEARANCE_M = 4.5  # of passages below buildings: as high as vehicles may be (StVZO 4 m) and half a metre
REACH_M = 500.0  # from a way: what is farther is below 10 degrees of elevation up to a height of 88 m
TREE = StreetConfig()  # sizes of trees of generated streets, where the map says nothing
DECK_M = 1.5  # thickness of a bridge, as of generated overpasses
MOST_TESTS = 10**10  # a minute or two; a city of 200,000 buildings has some 10^8
UPPER = np.array([(False, False, True), (False, True, True)])  # corners of the two triangles of a wall
OVER_M = 12.0  # length of a bridge on both sides of the middle of the way below it; chosen


def city_of(streets: StreetMap, way_en_m: Array | None = None) -> City:
    """Buildings and trees of a map; with a way (n, 2) [m] only those within 500 m of its bounding box."""
    low, high = (-np.inf, np.inf) if way_en_m is None else (way_en_m.min(0) - REACH_M, way_en_m.max(0) + REACH_M)
    boxes = streets.boxes_en_m
    near = np.all(boxes[:, 2:] >= low, axis=1) & np.all(boxes[:, :2] <= high, axis=1)
    solids = [streets.solids[k] for k in np.flatnonzero(near)]
    prisms_of = [_prism(one) for one in solids]
    number = np.repeat([one.building for one in solids], list(map(len, prisms_of))).astype(np.int64)
    walls = np.concatenate([np.zeros((0, 3, 3)), *prisms_of])
    houses = City(walls, np.zeros(len(walls), dtype=np.uint8), np.unique(number, return_inverse=True)[1])
    trees = [tree for tree in streets.trees if np.all(_stands(tree) >= low) and np.all(_stands(tree) <= high)]
    return houses + City.of(_crowns(trees), Surface.FOLIAGE)


def _stands(tree: Tree) -> Array:
    return np.array([tree.east_m, tree.north_m])


def _prism(solid: Solid) -> Array:
    """Walls and roof of a building, and its lower face if it does not stand on the ground.  (t, 3, 3)."""
    parts = []
    for ring in solid.rings_en_m:
        onward = ring[np.arange(1, len(ring) + 1) % len(ring)]
        walls = np.empty((len(ring), 2, 3, 3))
        walls[:, 0, :, :2] = np.stack([ring, onward, onward], 1)
        walls[:, 1, :, :2] = np.stack([ring, onward, ring], 1)
        walls[..., 2] = np.where(UPPER, solid.top_m, solid.bottom_m)
        parts.append(walls.reshape(-1, 3, 3))
    cover = triangulated(solid.rings_en_m)
    parts.append(np.insert(cover, 2, solid.top_m, 2))
    if solid.bottom_m > 0.0:
        parts.append(np.insert(cover[:, ::-1], 2, solid.bottom_m, 2))
    return np.concatenate(parts)


def _crowns(trees: Sequence[Tree]) -> Array:
    """Crowns of trees as boxes.  (t, 3, 3)."""
    middle = np.array([(tree.east_m, tree.north_m) for tree in trees]).reshape(-1, 2)
    top = np.array([tree.height_m or TREE.tree_top_m for tree in trees])
    half = 0.5 * np.array([tree.crown_m or TREE.tree_crown_m for tree in trees])
    base = np.minimum(TREE.tree_base_m, 0.5 * top)
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return prisms(middle[:, None] + half[:, None, None] * square, base, top, floor=True)


def bridges_above(streets: StreetMap, way_en_m: Array, ways: Sequence[StreetWay]) -> City:
    """Decks of the bridges that cross a way (n, 2) [m] above the level of its streets, one for each of its sides.

    Streets of the way, and those that meet one of them at a point, do not lie above it.
    """
    decks = [np.zeros((0, 3, 3))]
    level = np.array([way.level for way in ways])
    own = {node for way in ways for node in way.nodes}
    low, high = way_en_m.min(0), way_en_m.max(0)
    for bridge in streets.bridges:
        axis = bridge.points_en_m
        if not own.isdisjoint(bridge.nodes) or (axis.max(0) < low).any() or (axis.min(0) > high).any():
            continue
        for a, b in pairwise(axis):
            at = crossing(way_en_m, a, b)
            for k in np.flatnonzero(np.isfinite(at[:, 0]) & (level < bridge.level)):
                along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
                beside = 0.5 * bridge.width_m * np.array([along[1], -along[0]])
                ends = at[k] - OVER_M * along, at[k] + OVER_M * along
                foot = np.array([ends[0] - beside, ends[0] + beside, ends[1] + beside, ends[1] - beside])
                decks.append(prisms(foot[None], TREE.clearance_m, TREE.clearance_m + DECK_M, floor=True))
    return City.of(np.concatenate(decks))


def in_buildings(points_en_m: ArrayLike, streets: StreetMap) -> NDArray[np.bool_]:
    """Whether places lie in the outline of a building that leaves no passage of 4.5 m below it.  (n, 2) [m] -> (n,).

    Raises
    ------
    InputError
        Large outlines lie one over the other, so that the work would take minutes.
    """
    points = np.asarray(points_en_m, dtype=np.float64)
    hit = np.zeros(len(points), dtype=np.bool_)
    if not points.size:
        return hit
    low, high = streets.boxes_en_m[:, :2], streets.boxes_en_m[:, 2:]
    here = np.flatnonzero(np.all((high >= points.min(0)) & (low <= points.max(0)), axis=1))
    here = here[[streets.solids[k].bottom_m < CLEARANCE_M for k in here]]
    tree, middle, half = cKDTree(points), 0.5 * (low + high), 0.5 * (high - low).max(1)
    count = tree.query_ball_point(middle[here], half[here], p=np.inf, return_length=True)
    here, count = here[count > 0], count[count > 0]
    tests = sum(int(n) * sum(map(len, streets.solids[k].rings_en_m)) for k, n in zip(here, count, strict=True))
    if tests > MOST_TESTS:
        raise InputError(
            f"map must need at most {MOST_TESTS:.0e} tests of places by sides of outlines, got {tests:.0e}: cut a part"
        )
    for k in here:
        near = np.array(tree.query_ball_point(middle[k], half[k], p=np.inf))
        near = near[~hit[near] & np.all((points[near] >= low[k]) & (points[near] <= high[k]), axis=1)]
        if near.size:
            hit[near] = inside(points[near], streets.solids[k].rings_en_m)
    return hit
