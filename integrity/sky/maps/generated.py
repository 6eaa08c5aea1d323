"""Generated city maps of one square kilometre: streets, blocks of buildings, a park and trees, as a reader gives them.

A city is a grid with shifted junctions, or rings and spokes about a place. Avenues are wide, streets have a lane each
way, lanes are narrow and of one direction. Buildings stand along the blocks; heights are lognormal by district: the
kinds of street of :mod:`..city`, dense about a centre and lower outwards. Seeds below 2^31 are for training; the 100
seeds from 2^31 on are for tests.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.city import STREETS, SectionKind, StreetConfig
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.maps.files import map_of
from lanebound.integrity.sky.maps.lines import along
from lanebound.integrity.sky.maps.polygons import cleaned, inside, signed_area
from lanebound.integrity.sky.maps.records import MapFrame, Restriction, Solid, StreetMap, StreetWay, Tree

__all__ = ["GENERATED", "TEST_MAPS", "TRAIN_MAPS", "generated_map", "map_seed", "named_map"]

Array = NDArray[np.float64]

GENERATED = "generated:"  # and a seed: the name of a generated map
TRAIN_MAPS, TEST_MAPS = 2**31, 100  # as of the cities of a sky: seeds 0 to 2^31 - 1, and 2^31 to 2^31 + 99

# Sizes are chosen, where no source is given.
HALF_M = 500.0
BLOCK_M = 70.0, 150.0
JITTER_M = 5.0
RADIAL_SHARE = 0.35  # of cities; the others are grids
SPOKES = 6, 9
RING_M = 60.0, 90.0  # radius of the innermost ring
RINGS_M = 80.0, 130.0  # between rings
LONGEST_M = 150.0  # of a piece of a ring; where it would be longer, spokes begin
LANE_M = 3.25
MISSING = 0.08  # share of streets that a grid leaves out
LINED = 0.35  # share of avenues with trees
NO_LEFT = 0.15  # share of left turns from one avenue into another that are forbidden
CORE_M, BELT_M, ROUGH_M = (150.0, 330.0), (150.0, 300.0), 60.0  # radius of the centre, width about it, their spread
TREE_M, TREE_OFFSET_M = 12.0, 1.5  # between trees of an avenue; from its lanes
PARK_TREE_M2 = 150.0  # of a park for each tree
LEAST_M2 = 40.0  # of a building
HEIGHTS_M = 3.0, 150.0
KMH = 1.0 / 3.6
PARALLEL = 0.05  # sine of an angle, below which two sides are one


class _Rank(NamedTuple):
    """A rank of street: its name, lanes along and against, speed [m/s], and the width from lanes to facades [m]."""

    kind: str
    lanes: int
    back: int
    speed_mps: float
    walk_m: float


AVENUE = _Rank("primary", 2, 2, 60.0 * KMH, 7.0)
STREET = _Rank("tertiary", 1, 1, 40.0 * KMH, 4.5)
LANE = _Rank("residential", 1, 0, 30.0 * KMH, 2.5)
RANKS = AVENUE, STREET, LANE
SHARES = 0.25, 0.45, 0.30


class _Piece(NamedTuple):
    """A street between two junctions, in its direction if it has one; ``wide_m`` from its middle to the facades."""

    start: int
    end: int
    rank: _Rank
    wide_m: float
    lined: bool


@dataclass(frozen=True)
class _Plan:
    """Junctions (n, 2) [m], and the pieces of streets between them."""

    places: Array
    pieces: list[_Piece]


def map_seed(split: str, index: int) -> int:
    """The seed of a generated map of a split, ``train`` or ``test``; no seed is in both.

    Raises
    ------
    InputError
        There is no such split, or no such map in it.

    >>> map_seed("test", 0)
    2147483648
    """
    sizes = {"train": TRAIN_MAPS, "test": TEST_MAPS}
    if split not in sizes:
        raise InputError(f"split must be train or test, got {split!r}: choose one")
    if not 0 <= index < sizes[split]:
        raise InputError(f"index must lie in [0, {sizes[split] - 1}] in split {split}, got {index}: choose another")
    return index + (TRAIN_MAPS if split == "test" else 0)


def named_map(name: str) -> StreetMap:
    """The map of a file, a packaged name, or ``generated:SEED``.

    Raises
    ------
    InputError
        There is none.
    """
    if not name.startswith(GENERATED):
        return map_of(name)
    text = name.removeprefix(GENERATED)
    if not (text.isascii() and text.isdecimal() and int(text) < TRAIN_MAPS + TEST_MAPS):
        raise InputError(f"map must be generated:SEED with 0 <= SEED < {TRAIN_MAPS + TEST_MAPS}, got {name!r}")
    return generated_map(int(text))


@lru_cache(maxsize=4)
def generated_map(seed: int) -> StreetMap:
    """The map of a city of about one square kilometre; the same seed gives the same city.

    Parameters
    ----------
    seed : see :func:`map_seed`
    """
    rng = named_generator(seed, "generated map")
    plan = _radial(rng) if rng.random() < RADIAL_SHARE else _grid(rng)
    blocks = _blocks(plan)
    core = rng.uniform(-200.0, 200.0, 2)
    dense = rng.uniform(*CORE_M)
    semi = dense + rng.uniform(*BELT_M)
    park = int(rng.integers(len(blocks)))
    solids: list[Solid] = []
    trees: list[Tree] = []
    for k, sides in enumerate(blocks):
        corners = plan.places[[_first(plan, side) for side in sides]]
        away = float(np.linalg.norm(corners.mean(0) - core)) + ROUGH_M * rng.standard_normal()
        if k == park:
            trees += _park(plan, sides, corners, rng)
            continue
        kind = SectionKind.DENSE_CANYON if away < dense else (
            SectionKind.SEMI_URBAN if away < semi else SectionKind.SUBURBAN
        )  # fmt: skip
        _build(solids, plan, sides, corners, STREETS[kind], rng)
    for piece in plan.pieces:
        if piece.lined:
            trees += _lining(plan, piece)
    sky = SkyConfig()
    return StreetMap(
        MapFrame(sky.lat_deg, sky.lon_deg), tuple(_ways(plan)), tuple(_restrictions(plan, rng)), tuple(solids),
        tuple(trees), found=Counter(streets=len(plan.pieces), buildings=len(solids), trees=len(trees)),
    )  # fmt: skip


# Streets


def _ranked(rng: np.random.Generator) -> tuple[_Rank, float, bool]:
    """Rank, width from the middle to the facades [m] and trees of a street."""
    rank = RANKS[int(rng.choice(len(RANKS), p=SHARES))]
    wide = 0.5 * (rank.lanes + rank.back) * LANE_M + rank.walk_m * rng.uniform(0.8, 1.3)
    return rank, float(wide), bool(rng.random() < LINED) and rank is AVENUE


def _grid(rng: np.random.Generator) -> _Plan:
    """A grid of streets, turned by any angle, with shifted junctions; some pieces are missing."""
    at = [_steps(rng) for _ in range(2)]
    n, m = len(at[0]), len(at[1])
    places = np.stack(np.meshgrid(*at, indexing="ij"), -1).reshape(-1, 2) + JITTER_M * rng.standard_normal((n * m, 2))
    angle = rng.uniform(0.0, 0.5 * np.pi)
    places = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    pieces, cut = [], set[int]()
    for axis, lines, length in ((0, n, m), (1, m, n)):
        for k in range(lines):
            rank, wide, lined = _ranked(rng)
            backward = bool(rng.integers(2))
            for j in range(length - 1):
                ends = (k * m + j, k * m + j + 1) if axis == 0 else (j * m + k, (j + 1) * m + k)
                inner = 0 < k < lines - 1
                if inner and rank is not AVENUE and rng.random() < MISSING and not cut & set(ends):
                    cut |= set(ends)  # so that every junction keeps three streets
                    continue
                start, end = ends[::-1] if backward else ends
                pieces.append(_Piece(start, end, rank, wide, lined))
    return _Plan(places, pieces)


def _steps(rng: np.random.Generator) -> Array:
    """Distances of parallel streets about the middle."""
    at = [0.0]
    while at[-1] < 2.0 * HALF_M - BLOCK_M[0]:
        at.append(at[-1] + rng.uniform(*BLOCK_M))
    return np.array(at) - 0.5 * at[-1]


def _radial(rng: np.random.Generator) -> _Plan:
    """Rings about the middle and spokes between them; farther out there are more spokes."""
    count, radius = int(rng.integers(*SPOKES)), rng.uniform(*RING_M)
    rings: list[NDArray[np.int64]] = []
    places: list[Array] = []
    spokes = [_ranked(rng) for _ in range(count)]
    pieces: list[_Piece] = []
    begin, turn = 0, rng.uniform(0.0, 2.0 * np.pi)
    while radius < 1.1 * HALF_M:
        if 2.0 * np.pi * radius / count > LONGEST_M:
            count *= 2
            spokes = [one for old in spokes for one in (old, _ranked(rng))]
        angle = turn + 2.0 * np.pi * np.arange(count) / count
        circle = radius * np.stack([np.sin(angle), np.cos(angle)], -1)
        places.append(circle + JITTER_M * rng.standard_normal((count, 2)))
        ring = begin + np.arange(count)
        rank, wide, lined = _ranked(rng)
        backward = bool(rng.integers(2))
        for a, b in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True):
            pieces.append(_Piece(b if backward else a, a if backward else b, rank, wide, lined))
        if rings:
            step = count // len(rings[-1])
            for j, (a, b) in enumerate(zip(rings[-1].tolist(), ring[::step].tolist(), strict=True)):
                pieces.append(_Piece(a if j % 2 else b, b if j % 2 else a, *spokes[j * step]))
        rings.append(ring)
        begin, radius = begin + count, radius + rng.uniform(*RINGS_M)
    return _Plan(np.concatenate(places), pieces)


def _ways(plan: _Plan) -> list[StreetWay]:
    return [
        StreetWay(
            k, (p.start, p.end), plan.places[[p.start, p.end]], p.rank.kind, p.rank.lanes, p.rank.back, LANE_M,
            p.rank.speed_mps,
        )
        for k, p in enumerate(plan.pieces)
    ]  # fmt: skip


def _restrictions(plan: _Plan, rng: np.random.Generator) -> list[Restriction]:
    """Some left turns from avenues into avenues are forbidden."""
    at: dict[int, list[int]] = {}
    for k, piece in enumerate(plan.pieces):
        if piece.rank is AVENUE:
            for node in (piece.start, piece.end):
                at.setdefault(node, []).append(k)
    out = []
    for node, pieces in at.items():
        for a in pieces:
            for b in pieces:
                before, after = (_toward(plan, k, node) for k in (a, b))
                left = a != b and before[1] * after[0] - before[0] * after[1] > 0.5  # of what is seen from the junction
                if left and rng.random() < NO_LEFT:
                    out.append(Restriction(a, node, b, only=False))
    return out


def _toward(plan: _Plan, k: int, node: int) -> Array:
    """The unit vector along a piece from a junction."""
    piece = plan.pieces[k]
    away = plan.places[piece.end if piece.start == node else piece.start] - plan.places[node]
    return np.asarray(away / np.linalg.norm(away))


# Blocks


def _blocks(plan: _Plan) -> list[list[tuple[int, bool]]]:
    """The blocks between streets, counter-clockwise: pieces, and whether each is followed from its start."""
    leaving: dict[int, list[tuple[float, int, bool]]] = {}
    for k, piece in enumerate(plan.pieces):
        for node, forward in ((piece.start, True), (piece.end, False)):
            leaving.setdefault(node, []).append((float(np.arctan2(*_toward(plan, k, node))), k, forward))
    for sides_here in leaving.values():
        sides_here.sort()  # by azimuth
    left = {(k, forward) for k in range(len(plan.pieces)) for forward in (True, False)}
    blocks = []
    while left:
        side = min(left)
        block = []
        while side in left:
            left.remove(side)
            block.append(side)
            piece = plan.pieces[side[0]]
            sides = [one[1:] for one in leaving[piece.end if side[1] else piece.start]]
            side = sides[(sides.index((side[0], not side[1])) + 1) % len(sides)]  # the sharpest left turn
        corners = plan.places[[_first(plan, one) for one in block]]
        if signed_area(corners) > 0.0:
            blocks.append(block)
    return blocks


def _first(plan: _Plan, side: tuple[int, bool]) -> int:
    piece = plan.pieces[side[0]]
    return piece.start if side[1] else piece.end


def _inset(corners: Array, away_m: Array) -> Array | None:
    """A ring (n, 2) whose sides lie inside of those of another; None if a side vanishes."""
    side = np.roll(corners, -1, 0) - corners
    ahead = side / np.linalg.norm(side, axis=1, keepdims=True)
    inward = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    out = np.empty_like(corners)
    for k in range(len(corners)):
        normals, wanted = inward[[k - 1, k]], away_m[[k - 1, k]]
        if abs(normals[0, 0] * normals[1, 1] - normals[0, 1] * normals[1, 0]) < PARALLEL:
            out[k] = corners[k] + wanted.max() * inward[k]
        else:
            out[k] = corners[k] + np.linalg.solve(normals, wanted)
    grown = np.roll(out, -1, 0) - out
    return out if np.all((grown * ahead).sum(1) > 1.0) and signed_area(out) > LEAST_M2 else None


def _build(
    solids: list[Solid], plan: _Plan, sides: list[tuple[int, bool]], corners: Array, street: StreetConfig,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Append the buildings along a block; a block without room for a yard is one building."""
    garden = max(street.setback_m - StreetConfig().setback_m, 0.0)
    wide = np.array([plan.pieces[k].wide_m for k, _ in sides]) + garden
    front = _inset(corners, wide)
    if front is None:
        return
    depth = street.depth_m
    back = None
    while back is None and depth > 0.3 * street.depth_m:
        back = _inset(corners, wide + depth)
        depth *= 0.7
    if back is None:
        _add(solids, front, street, rng)
        return
    depth /= 0.7
    for a, b, c, d in zip(front, np.roll(front, -1, 0), np.roll(back, -1, 0), back, strict=True):
        length, at = float(np.linalg.norm(b - a)), 0.0
        while at < length - 1.0:
            end = at + street.frontage_m * rng.uniform(0.5, 1.5)
            end = length if end > length - 0.4 * street.frontage_m else end
            u, v, step = at / length, end / length, street.setback_spread_m * rng.random() / depth
            outer, inner = a + np.array([[u], [v]]) * (b - a), d + np.array([[v], [u]]) * (c - d)
            outer = outer + step * (inner[::-1] - outer)
            _add(solids, np.concatenate([outer, inner]), street, rng)
            at = end + (rng.exponential(street.gap_m) if rng.random() < street.gap_probability else 0.0)


def _add(solids: list[Solid], ring: Array, street: StreetConfig, rng: np.random.Generator) -> None:
    """Append a building of a lognormal height."""
    height = float(np.clip(street.height_median_m * np.exp(street.height_log_sd * rng.standard_normal()), *HEIGHTS_M))
    sound = cleaned(ring)
    if sound is not None and abs(signed_area(sound)) >= LEAST_M2:
        solids.append(Solid((sound,), 0.0, height, len(solids)))


def _park(plan: _Plan, sides: list[tuple[int, bool]], corners: Array, rng: np.random.Generator) -> list[Tree]:
    """Trees at random places of a block."""
    ground = _inset(corners, np.array([plan.pieces[k].wide_m for k, _ in sides]))
    if ground is None:
        return []
    count = int(signed_area(ground) / PARK_TREE_M2)
    places = rng.uniform(ground.min(0), ground.max(0), (count, 2))
    return [Tree(float(east), float(north)) for east, north in places[inside(places, [ground])]]


def _lining(plan: _Plan, piece: _Piece) -> list[Tree]:
    """Trees on both sides of a piece, between its crossings."""
    start, end = plan.places[piece.start], plan.places[piece.end]
    line = along(np.stack([start, end]), TREE_M)[1:-1]
    ahead = (end - start) / np.linalg.norm(end - start)
    aside = (0.5 * (piece.rank.lanes + piece.rank.back) * LANE_M + TREE_OFFSET_M) * np.array([ahead[1], -ahead[0]])
    return [Tree(float(p[0]), float(p[1])) for sign in (1.0, -1.0) for p in line + sign * aside]
