"""Buildings of OpenStreetMap as prisms: their heights from tags, and parts of buildings in place of their outlines.

Roofs are flat, at the eaves where the height of the roof is tagged: from a street below, the eaves hide the ridge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.maps import tags as tg
from lanebound.integrity.sky.maps.polygons import MOST_CORNERS, cleaned, inside, signed_area, triangulated
from lanebound.integrity.sky.maps.records import Solid

__all__ = ["STOREY_M", "Outline", "solids_of"]

Array = NDArray[np.float64]

STOREY_M = 3.6  # median of height over levels of the 21 buildings with both in the extracts of Helsinki and Neukölln
USUAL_M = 12.0  # without known heights: three to five storeys of 3 m, as of semi-urban streets in city.py
LEAST_KNOWN = 5  # heights of a map, from which on their median stands for unknown ones; chosen
LOW_M = 3.0  # of garages and sheds: one storey
LOW_KINDS = (
    "garage",
    "garages",
    "carport",
    "shed",
    "hut",
    "kiosk",
    "roof",
    "service",
    "toilets",
    "greenhouse",
    "cabin",
)
OPEN_KINDS = ("roof", "carport")  # a roof on posts
ROOF_M = 0.5  # thickness of such a roof; chosen
COVERED = 0.5  # share of an outline from which on its parts replace it; chosen, the wiki asks for all of it
LARGEST_M2 = 1e6  # a larger outline is none of a building: the largest of the world cover 0.4 km2
LOWEST_M = 0.5  # a lower solid hides no sky from an antenna at 1.5 m


@dataclass(frozen=True)
class Outline:
    """An outline with holes, (n, 2) [m] each, and its tags."""

    rings_en_m: tuple[Array, ...]
    tags: tg.Tags

    @property
    def is_part(self) -> bool:
        """Whether it is a part of a building."""
        return self.tags.get("building:part", "no") != "no"

    @property
    def kind(self) -> str:
        """The value of ``building``, or of ``building:part``."""
        return self.tags.get("building:part" if self.is_part else "building", "")

    @cached_property
    def area_m2(self) -> float:
        """Area without the holes."""
        return signed_area(self.rings_en_m[0]) + sum(map(signed_area, self.rings_en_m[1:]))

    @cached_property
    def middle_en_m(self) -> Array:
        """A point inside: the middle of its largest triangle.  (2,)."""
        triangles = triangulated(self.rings_en_m)
        u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        return np.asarray(triangles[int(np.argmax(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))].mean(0))


def solids_of(outlines: Iterable[Outline], assumed: Counter[str], skipped: Counter[str]) -> list[Solid]:
    """The prisms of buildings; counts what is assumed and left out."""
    sound = [found for outline in outlines if (found := _sound(outline, skipped)) is not None]
    whole, parts = ([o for o in sound if o.is_part == part] for part in (False, True))
    owner = _owners(whole, parts)
    covered = np.zeros(len(whole))
    for part, k in zip(parts, owner, strict=True):
        if k >= 0:
            covered[k] += part.area_m2
    known = [height for outline in sound if (height := _top_m(outline.tags)) is not None]
    usual = float(np.median(known)) if len(known) >= LEAST_KNOWN else USUAL_M
    out: list[Solid] = []
    for k, outline in enumerate(whole):
        if covered[k] >= COVERED * outline.area_m2:
            skipped["outlines replaced by building:part"] += 1
        else:
            _add(out, outline, outline.tags, k, usual, assumed, skipped)
    for n, (part, k) in enumerate(zip(parts, owner, strict=True)):
        base: tg.Tags = whole[k].tags if k >= 0 else {}
        _add(out, part, base, k if k >= 0 else len(whole) + n, usual, assumed, skipped)
    return out


def _sound(outline: Outline, skipped: Counter[str]) -> Outline | None:
    """An outline with cleaned rings; None, counted, if it is no building above the ground with an area."""
    tags = outline.tags
    level = tags.get("layer", "0")
    if outline.kind in ("no", ""):
        return None
    if level.startswith("-") or tags.get("location") == "underground":
        skipped["buildings under the ground"] += 1
        return None
    if sum(map(len, outline.rings_en_m)) > MOST_CORNERS:
        skipped[f"buildings of more than {MOST_CORNERS} corners"] += 1
        return None
    outer, *holes = (cleaned(ring, clockwise=k > 0) for k, ring in enumerate(outline.rings_en_m))
    if outer is None or signed_area(outer) > LARGEST_M2:
        skipped["buildings without area" if outer is None else f"buildings above {LARGEST_M2:g} m2"] += 1
        return None
    return Outline((outer, *(hole for hole in holes if hole is not None)), tags)


def _owners(whole: Sequence[Outline], parts: Sequence[Outline]) -> list[int]:
    """The building in whose outline each part lies, -1 for none."""
    if not whole:
        return [-1] * len(parts)
    boxes = np.array([(*outline.rings_en_m[0].min(0), *outline.rings_en_m[0].max(0)) for outline in whole])
    order = np.argsort(boxes[:, 0], kind="stable")
    left, widest = boxes[order, 0], float((boxes[:, 2] - boxes[:, 0]).max())
    owner = []
    for part in parts:
        x, y = part.middle_en_m
        near = order[np.searchsorted(left, x - widest) : np.searchsorted(left, x, side="right")]
        near = near[(boxes[near, 2] >= x) & (boxes[near, 1] <= y) & (boxes[near, 3] >= y)]
        here = [int(k) for k in near if inside(part.middle_en_m[None], whole[k].rings_en_m)[0]]
        owner.append(min(here, key=lambda k: whole[k].area_m2, default=-1))
    return owner


def _top_m(tags: tg.Tags) -> float | None:
    """Height of the eaves by ``height`` and ``roof:height``, or by ``building:levels``; None if neither is known."""
    height, levels = tg.metres(tags.get("height"), LOWEST_M), tg.integer(tags.get("building:levels"), 1, 200)
    if height is not None:
        return max(height - (tg.metres(tags.get("roof:height"), 0.0, height) or 0.0), LOWEST_M)
    return None if levels is None else levels * STOREY_M


def _bottom_m(tags: tg.Tags) -> float:
    """Height of the lower face: ``min_height``, or ``building:min_level``."""
    height = tg.metres(tags.get("min_height"))
    return height if height is not None else STOREY_M * (tg.integer(tags.get("building:min_level"), 0, 200) or 0)


def _add(
    out: list[Solid], outline: Outline, base: tg.Tags, building: int, usual_m: float, assumed: Counter[str],
    skipped: Counter[str],
) -> None:  # fmt: skip
    """Append the prism of an outline; what a part does not say is that of the building, ``base``."""
    tags, kind = outline.tags, outline.kind
    if "height" in tags and tg.metres(tags["height"], LOWEST_M) is None:
        assumed["heights that are no heights"] += 1
    top, source = _top_m(tags), tags
    if top is None and outline.is_part:
        top, source = _top_m(base), base
    if top is not None and tg.metres(source.get("height"), LOWEST_M) is None:
        assumed[f"storeys of {STOREY_M:g} m"] += 1
    if top is None:
        top = LOW_M if kind in LOW_KINDS else usual_m
        assumed[f"heights of {top:.3g} m, where nothing is tagged"] += 1
    bottom = top - ROOF_M if kind in OPEN_KINDS else _bottom_m(tags)
    if top - bottom < min(LOWEST_M, ROOF_M):
        skipped["buildings not higher than their lower face"] += 1
        return
    out.append(Solid(outline.rings_en_m, bottom, top, building))
