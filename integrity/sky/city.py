"""Streets: buildings, trees, overpasses and tunnels along any road, procedural or from mesh files (OBJ, PLY, GLB, STL).

Building heights are lognormal, as measured for Westminster (median 20.6 m, log sd 0.44) and Guildford (7.1 m, 0.27): C.
Tzaras, B. G. Evans and S. R. Saunders, Electronics Letters 34(13), 1998.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError, require_finite, require_shape
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Surface, prisms

__all__ = [
    "MESH_SUFFIXES",
    "City",
    "CityConfig",
    "Plot",
    "SectionConfig",
    "SectionKind",
    "StreetConfig",
    "Stretch",
    "Surface",
    "build_city",
    "city_from_mesh",
    "line_street",
]


MESH_SUFFIXES = (".obj", ".ply", ".glb", ".stl")
LEAST_AREA_M2 = 1e-10
LARGEST_BYTES = 48 * 2**20  # about 2.5 million triangles of a binary file; reading needs 0.9 GiB


def city_from_mesh(
    path: str | Path,
    *,
    y_up: bool = False,
    origin_enu_m: ArrayLike = (0.0, 0.0, 0.0),
    surface: Surface = Surface.SOLID,
) -> City:
    """Read obstacles from a mesh file in metres: x East, y North, z up.

    Parameters
    ----------
    path : an OBJ, PLY, GLB or STL file
    y_up : the file has x East, y up, z South, as GLB prescribes
    origin_enu_m : (3,) position of the file's origin in the frame of the street
    surface : surface of all triangles

    Faces without area are removed.

    Raises
    ------
    InputError
        The file is missing, of another format, too large, truncated, empty, or without a face of positive area. A
        truncated file is refused because a part of the city would leave too much sky free.
    """
    file = Path(path)
    offset = require_finite("origin_enu_m", origin_enu_m)
    require_shape("origin_enu_m", offset, (3,))
    if file.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"mesh {file} must end in one of {MESH_SUFFIXES}, got {file.suffix!r}: convert it")
    if not file.is_file():
        raise InputError(f"mesh {file} must be a file, which does not exist: check the path")
    if (size := file.stat().st_size) > LARGEST_BYTES:
        raise InputError(f"mesh {file} must have at most {LARGEST_BYTES} bytes, has {size}: cut the city into parts")
    vertices, faces = _load(file)
    if faces.size == 0:
        raise InputError(f"mesh {file} must hold triangles, got none: is the file empty or truncated?")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise InputError(
            f"mesh {file}: faces must refer to vertices 0..{vertices.shape[0] - 1}, got {faces.max()}: is it truncated?"
        )
    corners = require_finite(f"mesh {file.name} vertices", vertices)
    if y_up:
        corners = np.stack([corners[:, 0], -corners[:, 2], corners[:, 1]], -1)
    triangles = (corners + offset)[faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sound = 0.5 * np.linalg.norm(cross, axis=-1) > LEAST_AREA_M2
    if not sound.any():
        raise InputError(
            f"mesh {file} must hold a face of positive area, got {faces.shape[0]} flat ones: check its units"
        )
    return City.of(triangles[sound], surface)


def _load(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of a file, all parts of its scene merged."""
    import trimesh

    try:
        mesh: Any = trimesh.load(file, force="mesh", process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as exc:  # the readers of trimesh raise errors of many types
        raise InputError(f"mesh {file} must be a valid {file.suffix} file, got: {exc or type(exc).__name__}") from exc
    return vertices, faces


Array = NDArray[np.float64]

RIGHT, LEFT = 1.0, -1.0
CLEARANCE_M = 1.0  # no building stands closer than this to any lane of the road
WALL_M = 1.0
PIECE_M = 4.0  # length of the straight pieces of a tunnel
LEAST_FRONTAGE_M = 4.0
TRUNK_M = 0.25  # half a trunk


class Plot(Protocol):
    """The ground beside one road of a network of roads."""

    def clear(self, foot: Array) -> NDArray[np.bool_]:
        """Whether footprints (n, 4, 2) [m] overlap no road.  -> (n,)."""

    def take(self, foot: Array, strip: Array) -> NDArray[np.bool_]:
        """Whether buildings fit on footprints, given the strips between road and building; those that fit are reserved.

        foot (n, 4, 2) [m], strip (n, 4, 2) [m] -> (n,).
        """


class SectionKind(StrEnum):
    """Kind of surroundings along a stretch of road."""

    OPEN = "open"
    SUBURBAN = "suburban"
    SEMI_URBAN = "semi_urban"
    DENSE_CANYON = "dense_canyon"
    OVERPASS = "overpass"
    TUNNEL = "tunnel"
    TREES = "trees"


class StreetConfig(Config):
    """Surroundings of one side of a street. A median height of 0 means no buildings; a spacing of 0 means no object."""

    height_median_m: float = Field(0.0, ge=0, le=500, description="median building height")
    height_log_sd: float = Field(0.3, ge=0, le=2, description="standard deviation of log height [-]")
    height_max_m: float = Field(150.0, gt=0, le=1000, description="upper limit of building heights")
    setback_m: float = Field(4.0, ge=CLEARANCE_M, le=200, description="from the edge of the lanes to the facades")
    setback_spread_m: float = Field(0.0, ge=0, le=50, description="largest additional setback, uniform")
    frontage_m: float = Field(18.0, ge=LEAST_FRONTAGE_M, le=300, description="mean length of a facade")
    depth_m: float = Field(15.0, gt=1, le=200, description="depth of a building")
    gap_probability: float = Field(0.1, ge=0, le=1, description="probability of a gap after a building [-]")
    gap_m: float = Field(5.0, ge=0, le=200, description="mean length of a gap")
    block_m: float = Field(0.0, ge=0, description="distance between side streets, 0 for none")
    cross_street_m: float = Field(10.0, ge=0, le=100, description="width of a side street between facades")
    tree_spacing_m: float = Field(0.0, ge=0, le=200, description="distance between trees, 0 for none")
    tree_base_m: float = Field(
        4.5, ge=0, le=30, description="bottom of the crown; clearance of Japan's Road Structure Order"
    )
    tree_top_m: float = Field(9.0, gt=0, le=60, description="top of the crown")
    tree_crown_m: float = Field(6.0, gt=0, le=30, description="width of the crown")
    tree_offset_m: float = Field(1.5, ge=0, le=50, description="from the edge of the lanes to the trunks")
    slab_spacing_m: float = Field(0.0, ge=0, le=5000, description="distance between overpasses, 0 for none")
    slab_length_m: float = Field(14.0, gt=0, le=500, description="length of an overpass along the road; four lanes")
    clearance_m: float = Field(
        6.0, ge=3, le=50, description="clearance of overpasses and tunnels; above the legal 4.5 m"
    )
    enclosed: bool = Field(False, description="the street is a tunnel")


STREETS: dict[SectionKind, StreetConfig] = {
    SectionKind.OPEN: StreetConfig(),
    # Guildford's heights; detached houses behind front gardens
    SectionKind.SUBURBAN: StreetConfig(
        height_median_m=7.1, height_log_sd=0.27, setback_m=8.0, setback_spread_m=4.0, frontage_m=12.0, depth_m=10.0,
        gap_probability=0.8, gap_m=5.0, block_m=120.0, cross_street_m=12.0,
    ),
    # three to five storeys of 3 m
    SectionKind.SEMI_URBAN: StreetConfig(
        height_median_m=12.0, height_log_sd=0.4, setback_m=5.0, setback_spread_m=2.0, frontage_m=18.0, depth_m=14.0,
        gap_probability=0.3, gap_m=6.0, block_m=100.0, cross_street_m=12.0,
    ),
    # Westminster's spread of heights about eight to nine storeys of 3.3 m, as along an arterial road of central Tokyo
    SectionKind.DENSE_CANYON: StreetConfig(
        height_median_m=28.0, height_log_sd=0.44, setback_m=4.0, setback_spread_m=1.0, frontage_m=22.0, depth_m=20.0,
        gap_probability=0.08, gap_m=3.0, block_m=90.0, cross_street_m=10.0,
    ),
    SectionKind.OVERPASS: StreetConfig(slab_spacing_m=120.0),
    SectionKind.TUNNEL: StreetConfig(enclosed=True),
    SectionKind.TREES: StreetConfig(
        height_median_m=7.1, height_log_sd=0.27, setback_m=9.0, setback_spread_m=3.0, frontage_m=12.0, depth_m=10.0,
        gap_probability=0.7, gap_m=6.0, tree_spacing_m=8.0,
    ),
}  # fmt: skip


class SectionConfig(Config):
    """A stretch of road with one kind of street, or with different kinds on its two sides."""

    kind: SectionKind = Field(SectionKind.OPEN, description="kind of street on both sides of the stretch")
    length_m: float = Field(200.0, ge=10, description="length of the stretch")
    left_kind: SectionKind | None = Field(None, description="kind of street on the left side; none: the same as kind")


class CityConfig(Config):
    """The streets along a road: sections in order, repeated until the road ends."""

    sections: tuple[SectionConfig, ...] = Field(
        (
            SectionConfig(kind=SectionKind.SEMI_URBAN, length_m=400.0),
            SectionConfig(kind=SectionKind.DENSE_CANYON, length_m=300.0),
            SectionConfig(kind=SectionKind.TREES, length_m=150.0),
            SectionConfig(kind=SectionKind.OVERPASS, length_m=50.0),
            SectionConfig(kind=SectionKind.OPEN, length_m=200.0),
        ),
        min_length=1,
        description="stretches in order; the semi-urban and urban Tokyo roads of S2 section 5",
    )
    streets: dict[SectionKind, StreetConfig] = Field({}, description="kinds of street that replace the standard ones")

    @classmethod
    def uniform(cls, kind: SectionKind, **changes: float | bool) -> CityConfig:
        """A single kind of street along the whole road, with ``changes`` to its :class:`StreetConfig`."""
        streets = {kind: STREETS[kind].replace(**changes)} if changes else {}
        return cls(sections=(SectionConfig(kind=kind),), streets=streets)

    def street(self, kind: SectionKind) -> StreetConfig:
        """The street of a kind: the one of ``streets``, otherwise the standard one."""
        return self.streets.get(kind, STREETS[kind])

    def stretches(self, length_m: float) -> list[Stretch]:
        """Divide a road of this length into stretches; neighbours of the same kinds are joined."""
        out: list[Stretch] = []
        at, k = 0.0, 0
        while at < length_m:
            section = self.sections[k % len(self.sections)]
            end = min(at + section.length_m, length_m)
            left = section.left_kind or section.kind
            if out and (out[-1].kind, out[-1].left_kind) == (section.kind, left):
                out[-1] = Stretch(out[-1].start_m, end, section.kind, left)
            else:
                out.append(Stretch(at, end, section.kind, left))
            at, k = end, k + 1
        return out


@dataclass(frozen=True)
class Stretch:
    """A stretch of a road between two arc lengths, and the kinds of street on its right and left."""

    start_m: float
    end_m: float
    kind: SectionKind
    left_kind: SectionKind


def build_city(road: Road, config: CityConfig, rng: np.random.Generator) -> City:
    """Generate the obstacles along a road; the same generator state gives the same city.

    A building that would overlap the road (inside a bend, or where the road crosses itself) is made less deep or is
    left out. Coordinates are in the frame of the road.
    """
    return line_street(road, config.stretches(road.length_m), config, rng)


def line_street(
    road: Road, stretches: Sequence[Stretch], config: CityConfig, rng: np.random.Generator, plot: Plot | None = None
) -> City:
    """Generate obstacles along the given stretches of a road, as :func:`build_city` does for the whole road.

    ``plot`` excludes the ground of other roads; without it there are no other roads.
    """
    solid: list[Array] = [np.zeros((0, 3, 3))]
    foliage: list[Array] = [np.zeros((0, 3, 3))]
    feet: list[Array] = [np.zeros((0, 4, 2))]
    heights: list[Array] = [np.zeros(0)]
    for stretch in stretches:
        whole = config.street(stretch.kind)
        solid += [_slabs(road, stretch, whole, straight=plot is not None), _tunnel(road, stretch, whole, plot)]
        cross = rng.uniform(0.8, 1.2, int((stretch.end_m - stretch.start_m) / max(whole.block_m, 10.0)) + 1)
        for side, kind in ((RIGHT, stretch.kind), (LEFT, stretch.left_kind)):
            street = config.street(kind)
            foot, height = _buildings(road, _blocks(stretch, whole, cross), side, street, rng, plot)
            feet.append(foot)
            heights.append(height)
            foliage.append(_trees(road, stretch, side, street, rng, plot))
    houses = City.of_buildings(np.concatenate(feet), np.concatenate(heights))
    return City.of(np.concatenate(solid)) + houses + City.of(np.concatenate(foliage), Surface.FOLIAGE)


def _blocks(stretch: Stretch, street: StreetConfig, spread: Array) -> list[tuple[float, float]]:
    """Arcs (start, end) between side streets; both sides of the road have side streets at the same places."""
    if street.block_m <= 0.0:
        return [(stretch.start_m, stretch.end_m)]
    blocks, at = [], stretch.start_m
    for factor in spread:
        end = min(at + factor * street.block_m, stretch.end_m)
        if end - at >= LEAST_FRONTAGE_M:
            blocks.append((at, end))
        at = end + street.cross_street_m
    return blocks


def _buildings(
    road: Road,
    blocks: list[tuple[float, float]],
    side: float,
    street: StreetConfig,
    rng: np.random.Generator,
    plot: Plot | None,
) -> tuple[Array, Array]:
    """Footprints (n, 4, 2) and heights (n,) of adjacent buildings along one side, with random gaps."""
    if street.height_median_m <= 0.0:
        return np.zeros((0, 4, 2)), np.zeros(0)
    spans: list[tuple[float, float]] = []
    for start, end in blocks:
        at = start
        while end - at >= LEAST_FRONTAGE_M:
            width = min(max(street.frontage_m * rng.uniform(0.5, 1.5), LEAST_FRONTAGE_M), end - at)
            spans.append((at, at + width))
            at += width + (rng.exponential(street.gap_m) if rng.random() < street.gap_probability else 0.0)
    n = len(spans)
    height = street.height_median_m * np.exp(street.height_log_sd * rng.standard_normal(n))
    setback = street.setback_m + street.setback_spread_m * rng.random(n)
    arcs = np.array(spans).reshape(n, 2)
    foot, fits = _footprints(road, arcs, side, road.edge_m + setback, street.depth_m, plot)
    return foot[fits], np.minimum(height, street.height_max_m)[fits]


def _footprints(
    road: Road, arcs: Array, side: float, offset: Array, depth_m: float, plot: Plot | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Rectangles (n, 4, 2) beside the road with the largest of three depths that fits, and whether one fits (n,)."""
    n = arcs.shape[0]
    foot, fits = np.zeros((n, 4, 2)), np.zeros(n, dtype=np.bool_)
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 3), indexing="ij"), -1).reshape(-1, 1, 2)
    for share in (1.0, 0.5, 0.25):
        unplaced = np.flatnonzero(~fits)
        if unplaced.size == 0:
            break
        front = [road.pose_at(arcs[unplaced, i], side * offset[unplaced])[0] for i in (0, 1)]
        along = front[1] - front[0]
        length = np.hypot(along[:, 0], along[:, 1])[:, None]
        outward = side * np.stack([along[:, 1], -along[:, 0]], -1) / np.where(length > 0.0, length, 1.0)
        back = share * depth_m * outward
        points = front[0] + grid[..., :1] * along + grid[..., 1:] * back
        _, lateral = road.project(points)
        good = (np.abs(lateral).min(0) >= road.edge_m + CLEARANCE_M - 1e-6) & (length[:, 0] >= LEAST_FRONTAGE_M / 2)
        foot[unplaced] = np.stack([front[0], front[1], front[1] + back, front[0] + back], 1)
        if plot is not None:
            kerb = (offset[unplaced] - road.edge_m)[:, None] * outward
            strip = np.stack([front[0], front[1], front[1] - kerb, front[0] - kerb], 1)
            good[good] = plot.take(foot[unplaced[good]], strip[good])
        fits[unplaced] = good
    return foot, fits


def _trees(
    road: Road, stretch: Stretch, side: float, street: StreetConfig, rng: np.random.Generator, plot: Plot | None
) -> Array:
    """Crowns as a row of boxes with random variations of place and size."""
    if street.tree_spacing_m <= 0.0:
        return np.zeros((0, 3, 3))
    arc = np.arange(stretch.start_m + 0.5 * street.tree_spacing_m, stretch.end_m, street.tree_spacing_m)
    arc = arc + 0.2 * street.tree_spacing_m * rng.uniform(-1.0, 1.0, arc.size)
    size = rng.uniform(0.75, 1.25, arc.size)
    half = 0.5 * street.tree_crown_m * size
    at = side * (road.edge_m + street.tree_offset_m)
    foot = _across(road, arc - half, arc + half, at, half)
    top = street.tree_base_m + (street.tree_top_m - street.tree_base_m) * size
    stands = slice(None) if plot is None else plot.clear(_across(road, arc - TRUNK_M, arc + TRUNK_M, at, TRUNK_M))
    return prisms(foot[stands], street.tree_base_m, top[stands], floor=True)


def _slabs(road: Road, stretch: Stretch, street: StreetConfig, *, straight: bool) -> Array:
    """Overpasses across the road, 1.5 m thick, evenly spaced; with ``straight`` their sides are parallel in a bend."""
    if street.slab_spacing_m <= 0.0:
        return np.zeros((0, 3, 3))
    length = stretch.end_m - stretch.start_m
    count = max(1, round(length / street.slab_spacing_m))
    middle = stretch.start_m + length * (np.arange(count) + 0.5) / count
    half = 0.5 * min(street.slab_length_m, length / count)
    wide = road.edge_m + 30.0
    foot = _across(road, middle - half, middle + half, 0.0, wide)
    if straight:
        p, heading = road.pose_at(middle)
        ahead = half * np.stack([np.sin(heading), np.cos(heading)], -1)
        right = wide * np.stack([np.cos(heading), -np.sin(heading)], -1)
        foot = np.stack([p - ahead - right, p + ahead - right, p + ahead + right, p - ahead + right], 1)
    return prisms(foot, street.clearance_m, street.clearance_m + 1.5, floor=True)


def _tunnel(road: Road, stretch: Stretch, street: StreetConfig, plot: Plot | None) -> Array:
    """Two walls and a roof in short overlapping pieces; no wall where another road leaves or joins."""
    if not street.enclosed:
        return np.zeros((0, 3, 3))
    count = int(np.ceil((stretch.end_m - stretch.start_m) / PIECE_M))
    cuts = np.linspace(stretch.start_m, stretch.end_m, count + 1)
    start, end = np.maximum(cuts[:-1] - 0.5, stretch.start_m), np.minimum(cuts[1:] + 0.5, stretch.end_m)
    wall = road.edge_m + CLEARANCE_M + 0.5 * WALL_M
    top = street.clearance_m + WALL_M
    walls = [_across(road, start, end, s * wall, 0.5 * WALL_M) for s in (RIGHT, LEFT)]
    parts = [prisms(foot if plot is None else foot[plot.clear(foot)], 0.0, top) for foot in walls]
    parts.append(prisms(_across(road, start, end, 0.0, wall + WALL_M), street.clearance_m, top, floor=True))
    return np.concatenate(parts)


def _across(road: Road, start: Array, end: Array, lateral_m: float, half_m: float | Array) -> Array:
    """Footprints (n, 4, 2) between two arcs, ``2 half_m`` wide and centred at a lateral offset."""
    near, far = lateral_m - np.asarray(half_m), lateral_m + np.asarray(half_m)
    corners = ((start, near), (end, near), (end, far), (start, far))
    return np.stack([road.pose_at(arc, lateral)[0] for arc, lateral in corners], 1)
