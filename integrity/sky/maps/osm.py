"""Reader of OpenStreetMap extracts: ``.osm``, ``.osm.gz`` and ``.osm.pbf``, by libosmium (the extra ``maps``).

What the format leaves open is counted in ``assumed``, what cannot be used in ``skipped``. Streets are those that cars
drive through (:data:`.tags.DRIVABLE`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps import tags as tg
from lanebound.integrity.sky.maps.buildings import Outline, solids_of
from lanebound.integrity.sky.maps.lines import arcs_of, points_at
from lanebound.integrity.sky.maps.records import BridgeAxis, MapFrame, Restriction, StreetMap, StreetWay, Tree
from lanebound.integrity.sky.maps.sizes import require_moderate_gzip, require_moderate_pbf

__all__ = ["SUFFIXES", "read_osm"]

Array = NDArray[np.float64]
Place = tuple[float, float]
_Plan = Callable[[Sequence[Sequence[Place]]], list[Array | None]]

SUFFIXES = (".osm", ".osm.gz", ".osm.pbf")
LARGEST_BYTES = 64 * 2**20  # of a file; a million buildings
LARGEST_TEXT_BYTES = 2**29  # of XML after decompression
LARGEST_PBF_BYTES = 2**28  # after decompression: a node has 3 bytes at least there, and 16 in the memory
MOST_OBJECTS = {"streets": 100_000, "bridges": 100_000, "outlines": 200_000, "trees": 500_000, "points": 5_000_000}
MOST_TURNS = 100  # pairs of streets of one restriction
REACH_M = 10_000.0  # from the middle; what lies farther is left out: the ground is taken for flat
ROW_SPACING_M = 8.0  # between the trees of a row, as in generated streets with trees
TREE_APART_M = 3.0  # trees of a row nearer to a mapped tree are that tree
BRIDGE_WIDTH_M = 5.0  # of a bridge without a width: railways and paths; chosen
KEYS = ("highway", "railway", "building", "building:part", "natural", "restriction")


@dataclass
class _Found:
    """Objects of a file in degrees, before its middle is known."""

    streets: list[tuple[int, list[int], list[Place], dict[str, str]]] = field(default_factory=list)
    bridges: list[tuple[list[int], list[Place], dict[str, str]]] = field(default_factory=list)
    outlines: list[tuple[list[list[Place]], dict[str, str]]] = field(default_factory=list)
    trees: list[tuple[Place, dict[str, str]]] = field(default_factory=list)
    rows: list[list[Place]] = field(default_factory=list)
    restrictions: list[Restriction] = field(default_factory=list)
    count: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)
    points: int = 0
    assembled: int = 0

    def require_moderate(self, file: Path) -> None:
        """Refuse a file with too many objects."""
        for name in MOST_OBJECTS:
            _require_at_most(name, self.points if name == "points" else len(getattr(self, name)), file)


def _require_at_most(name: str, count: int, file: Path) -> None:
    most = MOST_OBJECTS[name]
    if count > most:
        raise InputError(f"map {file} must hold at most {most} {name}, got more: cut a part by 'osmium extract --bbox'")


def read_osm(path: str | Path) -> StreetMap:
    """Read the streets, buildings and trees of an extract of OpenStreetMap.

    Raises
    ------
    InputError
        The extra ``maps`` is not installed; the file is missing, of another format, too large, damaged or truncated;
        or it holds no street.
    """
    file = Path(path)
    _require_file(file)
    found = _objects(file)
    _require_streets(file, found.streets, found)
    lat, lon = np.median(np.array([place for _, _, line, _ in found.streets for place in line]), axis=0).tolist()
    frame, assumed = MapFrame(lat, lon), Counter[str]()
    near = partial(_near, frame, found.skipped)
    streets = [
        _street(number, nodes, line, tags, assumed)
        for (number, nodes, _, tags), line in zip(found.streets, near([one[2] for one in found.streets]), strict=True)
        if line is not None
    ]
    _require_streets(file, streets, found)
    rings = iter(near([ring for of_one, _ in found.outlines for ring in of_one]))
    outlines = []
    for of_one, tags in found.outlines:
        kept = [next(rings) for _ in of_one]
        if all(ring is not None for ring in kept):
            outlines.append(Outline(tuple(ring for ring in kept if ring is not None), tags))
    bridges = [
        BridgeAxis(line, tg.metres(tags.get("width"), 1.0, 60.0) or BRIDGE_WIDTH_M, _level(tags), tuple(nodes))
        for (nodes, _, tags), line in zip(found.bridges, near([one[1] for one in found.bridges]), strict=True)
        if line is not None
    ]
    return StreetMap(
        frame,
        tuple(streets),
        tuple(found.restrictions),
        tuple(solids_of(outlines, assumed, found.skipped)),
        tuple(_trees(found, near, assumed, file)),
        tuple(bridges),
        found.count,
        +assumed,
        +found.skipped,
    )


def _require_file(file: Path) -> None:
    """Refuse what is no extract of moderate size, before libosmium reads it."""
    if not file.name.lower().endswith(SUFFIXES):
        raise InputError(f"map {file} must end in one of {', '.join(SUFFIXES)}, got {file.name!r}: convert it")
    if not file.is_file():
        raise InputError(f"map {file} must be a file, which does not exist: correct the path")
    size = file.stat().st_size
    if not 0 < size <= LARGEST_BYTES:
        raise InputError(f"map {file} must have 1 to {LARGEST_BYTES} bytes, got {size}: cut a part of a city")
    if file.name.lower().endswith(".gz"):
        require_moderate_gzip(file, "map", LARGEST_TEXT_BYTES)
    if file.name.lower().endswith(".pbf"):
        require_moderate_pbf(file, "map", LARGEST_PBF_BYTES)


def _require_streets(file: Path, streets: Sequence[Any], found: _Found) -> None:
    if not streets:
        skipped = ", ".join(f"{n} {why}" for why, n in found.skipped.items()) or "nothing"
        raise InputError(f"map {file} must hold streets for cars, got none (skipped: {skipped}): cut another part")


def _objects(file: Path) -> _Found:
    """The objects of a file that this package uses."""
    try:
        import osmium
    except ImportError as error:
        raise InputError(f"map {file} needs the extra maps: pip install 'lanebound[maps]'") from error
    found, wanted = _Found(), osmium.filter.KeyFilter(*KEYS)
    try:
        for one in osmium.FileProcessor(str(file)).with_areas(wanted).with_filter(wanted):
            _add(found, one)
            found.require_moderate(file)
    except InputError:
        raise
    except (RuntimeError, ValueError, OSError, osmium.InvalidLocationError) as error:
        raise InputError(f"map {file} must be a whole OpenStreetMap file, got: {error}; fetch it again") from error
    whole = found.count["outlines of buildings"]
    if (lost := whole - found.assembled) > 0:
        found.skipped["buildings whose outline crosses itself or lacks points"] += lost
    return found


def _add(found: _Found, one: Any) -> None:
    """Sort an object of libosmium into what is found."""
    tags = dict(one.tags)
    if one.is_area():
        if _is_building(tags):
            _add_outlines(found, one, tags)
    elif one.is_node():
        if tags.get("natural") == "tree" and one.location.valid():
            found.trees.append(((one.location.lat, one.location.lon), tags))
            found.count["trees"] += 1
    elif one.is_way():
        _add_way(found, one, tags)
    elif one.is_relation():
        if tags.get("type") == "multipolygon" and _is_building(tags):
            found.count["outlines of buildings"] += 1
        elif tags.get("type") == "restriction" and "restriction" in tags:
            _add_restriction(found, one, tags)


def _is_building(tags: tg.Tags) -> bool:
    return tags.get("building", "no") != "no" or tags.get("building:part", "no") != "no"


def _add_outlines(found: _Found, area: Any, tags: dict[str, str]) -> None:
    """The outlines of an area; it has none if libosmium could not assemble it."""
    outers = list(area.outer_rings())
    found.assembled += bool(outers)
    for outer in outers:
        rings = [_places(ring)[1] for ring in (outer, *area.inner_rings(outer))]
        found.points += sum(map(len, rings))
        found.outlines.append((rings, tags))


def _add_way(found: _Found, way: Any, tags: dict[str, str]) -> None:
    if _is_building(tags):
        found.count["outlines of buildings"] += 1
    nodes, line = _places(way.nodes)
    missing = len(way.nodes) - len(line)
    if tags.get("natural") == "tree_row" and len(line) > 1:
        found.rows.append(line)
        found.points += len(line)
        found.count["rows of trees"] += 1
    kind = tags.get("highway", tags.get("railway"))
    if kind is None or tags.get("area") == "yes":
        return
    if tags.get("bridge", "no") != "no" and len(line) > 1:
        found.bridges.append((nodes, line, tags))
        found.points += len(line)
        found.count["bridges"] += 1
    if tags.get("highway") not in tg.DRIVABLE:
        if "highway" in tags:
            found.skipped["ways of highway that are no streets for through traffic"] += 1
        return
    if tg.no_motor_cars(tags):
        found.skipped["streets closed to private cars"] += 1
        return
    found.count["streets"] += 1
    if missing:
        found.skipped["points of streets that lie outside of the file or have no place"] += missing
    for run_nodes, run in _runs(way.nodes) if missing else ((nodes, line),):
        if len(run) > 1:
            found.streets.append((way.id, run_nodes, run, tags))
            found.points += len(run)


def _places(nodes: Any) -> tuple[list[int], list[Place]]:
    """Numbers and places (lat, lon) [deg] of the points of a way that have one."""
    known = [(node.ref, (node.location.lat, node.location.lon)) for node in nodes if node.location.valid()]
    return [number for number, _ in known], [place for _, place in known]


def _runs(nodes: Any) -> Iterator[tuple[list[int], list[Place]]]:
    """The parts of a way between points without a place."""
    for known, run in groupby(nodes, key=lambda node: node.location.valid()):
        if known:
            yield _places(list(run))


def _add_restriction(found: _Found, relation: Any, tags: dict[str, str]) -> None:
    """A restriction of turns by a point; others, and those that do not hold for cars, are counted."""
    roles: dict[tuple[str, str], list[int]] = {}
    for member in relation.members:
        roles.setdefault((member.type, member.role), []).append(member.ref)
    value, via = tags["restriction"], roles.get(("n", "via"), [])
    only, none = value.startswith("only_"), value.startswith("no_")
    before, after = roles.get(("w", "from"), []), roles.get(("w", "to"), [])
    not_cars = {"motorcar", "motor_vehicle"} & set(tags.get("except", "").split(";"))
    if not_cars or not (only or none) or len(via) != 1 or len(before) * len(after) > MOST_TURNS:
        found.skipped["restrictions of turns by way, or not of cars"] += 1
        return
    found.count["restrictions of turns"] += 1
    found.restrictions += [Restriction(a, via[0], b, only) for a in before for b in after]


def _near(frame: MapFrame, skipped: Counter[str], lines: Sequence[Sequence[Place]]) -> list[Array | None]:
    """Lines of places in the plane of the map, (n, 2) [m] each; None, counted, if one is too far from its middle."""
    places = np.array([place for line in lines for place in line]).reshape(-1, 2)
    en = frame.en_of(places[:, 0], places[:, 1])
    far = np.abs(en).max(1) > REACH_M
    out: list[Array | None] = []
    end = 0
    for line in lines:
        begin, end = end, end + len(line)
        lost = bool(far[begin:end].any())
        skipped[f"objects farther than {REACH_M / 1000.0:g} km from the middle"] += lost
        out.append(None if lost else en[begin:end])
    return out


def _level(tags: tg.Tags) -> int:
    """``layer``; else 1 of a bridge, -1 of a tunnel."""
    sign = -1.0 if tags.get("layer", "").startswith("-") else 1.0
    layer = tg.integer(tags.get("layer", "").removeprefix("-"), 0, 5)
    if layer is not None:
        return int(sign * layer)
    if tags.get("bridge", "no") != "no":
        return 1
    return -1 if tags.get("tunnel", "no") not in ("no", "building_passage") else 0


def _street(number: int, nodes: list[int], line: Array, tags: tg.Tags, assumed: Counter[str]) -> StreetWay:
    ahead, back, counted = tg.lanes(tags)
    limit, limited = tg.speed_mps(tags)
    wide = tg.metres(tags.get("width"), 2.0, 60.0)
    assumed["lanes of streets, where nothing is tagged"] += not counted
    assumed["lanes for buses or turns taken for any other lane, by street"] += any(map(tg.OF_LANES.match, tags))
    assumed["speed limits by class, where nothing is tagged"] += not limited
    covered = tags.get("tunnel", "no") != "no" or tags.get("covered") == "yes"
    width = None if wide is None or not counted else wide / (ahead + back)
    return StreetWay(
        number, tuple(nodes), line, tags["highway"], ahead, back, width, limit, _level(tags),
        tags.get("bridge", "no") != "no", covered,
    )  # fmt: skip


def _trees(found: _Found, near: _Plan, assumed: Counter[str], file: Path) -> list[Tree]:
    """Single trees, and those of rows where none is mapped."""
    out = []
    for (_, tags), at in zip(found.trees, near([[place] for place, _ in found.trees]), strict=True):
        if at is not None:
            height, crown = tg.metres(tags.get("height"), 1.0, 60.0), tg.metres(tags.get("diameter_crown"), 0.5, 30.0)
            assumed["sizes of trees, where nothing is tagged"] += height is None
            out.append(Tree(float(at[0, 0]), float(at[0, 1]), height, crown))
    mapped = cKDTree(np.array([(tree.east_m, tree.north_m) for tree in out]).reshape(-1, 2))
    for line in near(found.rows):
        if line is None:
            continue
        length = float(arcs_of(line)[-1])
        _require_at_most("trees", len(out) + int(length / ROW_SPACING_M), file)
        stands = points_at(line, np.arange(0.5 * min(ROW_SPACING_M, length), length, ROW_SPACING_M))
        free = stands[mapped.query(stands)[0] > TREE_APART_M] if out else stands
        assumed["places of trees in rows"] += len(free)
        out += [Tree(float(east), float(north)) for east, north in free]
    return out
