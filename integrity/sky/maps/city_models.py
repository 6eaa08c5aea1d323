"""Readers of city models: CityGML (1.0 to 3.0) and CityJSON, plain or gzip, as the obstacles of a city.

Of each building the surfaces of its highest level of detail are kept, without those on the ground. The street is flat:
each building stands at height 0. Coordinates are those of the file, in metres; of UTM zones, :class:`.records.MapFrame`
places them on the Earth.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.maps.polygons import MOST_CORNERS, cleaned, triangulated
from lanebound.integrity.sky.maps.records import MapFrame
from lanebound.integrity.sky.maps.sizes import read_bytes
from lanebound.integrity.sky.maps.utm import Utm
from lanebound.integrity.sky.scene import City

__all__ = ["CityModel", "is_city_model", "read_city_model"]

Array = NDArray[np.float64]
Rings = list[Array]  # (n, 3) each, the first is the outline

GML, JSON = (".gml", ".citygml", ".xml"), (".json", ".cityjson")
LARGEST_BYTES = 256 * 2**20  # after decompression
MOST_BUILDINGS, MOST_POLYGONS = 200_000, 2_000_000
NOT_SEEN = ("GroundSurface", "ClosureSurface", "OuterFloorSurface", "Window", "Door", "opening")
REACH_M = 20_000.0  # of a model from its middle
TALLEST_M = 830.0
EPSG = re.compile(r"EPSG[:/]+(?:[\d.]*[:/]+)?(\d{4,6})")


@dataclass(frozen=True)
class CityModel:
    """The buildings of a city model.

    Attributes
    ----------
    city : in East, North [m] about the middle of the model; each building has its number
    frame : where the middle lies; None for coordinates of other systems than UTM on WGS 84 or ETRS89
    found, skipped : how many objects are kept and left out, by kind and reason
    """

    city: City
    frame: MapFrame | None
    found: Counter[str]
    skipped: Counter[str]


@dataclass
class _Surfaces:
    """Polygons by building and level of detail, as they are read."""

    polygons: list[tuple[int, float, Rings]] = field(default_factory=list)
    buildings: int = 0
    epsg: int | None = None
    skipped: Counter[str] = field(default_factory=Counter)

    def add(self, building: int, lod: float, rings: Rings) -> None:
        self.polygons.append((building, lod, rings))
        if len(self.polygons) > MOST_POLYGONS or self.buildings > MOST_BUILDINGS:
            most = f"{MOST_BUILDINGS} buildings and {MOST_POLYGONS} surfaces"
            raise InputError(f"city model must hold at most {most}, got more: cut a part")


def is_city_model(path: str | Path) -> bool:
    """Whether a file is one of CityGML or CityJSON, by its name."""
    return Path(path).name.lower().removesuffix(".gz").endswith((*GML, *JSON))


def read_city_model(path: str | Path) -> CityModel:
    """Read the buildings of a CityGML or CityJSON file.

    Raises
    ------
    InputError
        The file is missing, of another format, too large, damaged or truncated, has entities in its XML, or no building
        with a surface.
    """
    file = Path(path)
    name = file.name.lower().removesuffix(".gz")
    if not is_city_model(file):
        raise InputError(
            f"city model {file} must end in one of {', '.join((*GML, *JSON))}, also with .gz, got {file.name!r}"
        )
    content = read_bytes(file, "city model", LARGEST_BYTES)
    try:
        found = _of_json(content) if name.endswith(JSON) else _of_gml(content)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except expat.ExpatError as error:
        raise InputError(f"city model {file} must be whole XML, got: {error}; fetch it again") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise InputError(
            f"city model {file} must have the form of its format, got {type(error).__name__}: {error}; fetch it again"
        ) from error
    return _made(file, found)


def _made(file: Path, found: _Surfaces) -> CityModel:
    """The city of what was read."""
    best: dict[int, float] = {}
    for building, lod, _ in found.polygons:
        best[building] = max(lod, best.get(building, -1.0))
    kept = [(building, rings) for building, lod, rings in found.polygons if lod == best[building]]
    if not kept:
        raise InputError(f"city model {file} must hold a building with surfaces, got none: is it of another theme?")
    everything = np.concatenate([rings[0] for _, rings in kept])
    if not np.isfinite(everything).all():
        raise InputError(f"city model {file} must have finite coordinates, got NaN or infinity: correct the file")
    middle = np.round(np.median(everything[:, :2], axis=0))
    ground: dict[int, float] = {}
    for building, rings in kept:
        ground[building] = min(float(rings[0][:, 2].min()), ground.get(building, np.inf))
    parts, number, skipped = [], [], found.skipped
    for building, rings in kept:
        local = [ring - (*middle, ground[building]) for ring in rings]
        if np.abs(local[0][:, :2]).max() > REACH_M or local[0][:, 2].max() > TALLEST_M:
            skipped[f"surfaces farther than {REACH_M / 1000:g} km from the middle, or above {TALLEST_M:g} m"] += 1
            continue
        triangles = _triangles(local)
        if triangles is None:
            skipped["surfaces without area, or of too many corners"] += 1
            continue
        parts.append(triangles)
        number.append(np.full(len(triangles), building))
    if not parts:
        raise InputError(f"city model {file} must hold a surface with an area, got none: are its units metres?")
    walls = np.concatenate(parts)
    _, dense = np.unique(np.concatenate(number), return_inverse=True)
    grid = Utm.of_epsg(found.epsg)
    frame = None
    if grid is not None:
        frame, turn = grid.frame_at(middle)
        walls[..., :2] = walls[..., :2] @ turn.T
    city = City(walls, np.zeros(len(walls), dtype=np.uint8), dense.astype(np.int64))
    count = Counter({"buildings": city.buildings, "surfaces": len(parts)})
    return CityModel(city, frame, count, +skipped)


def _triangles(rings: Rings) -> Array | None:
    """Triangles (t, 3, 3) of a plane polygon in space; None without area."""
    outline = rings[0]
    if sum(map(len, rings)) > MOST_CORNERS or len(outline) < 3:
        return None
    middle = outline.mean(0)
    away = outline - middle
    normal = np.cross(away, np.roll(away, -1, 0)).sum(0)  # Newell
    size = float(np.linalg.norm(normal))
    if size < 1e-6:
        return None
    normal = normal / size
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    axes = np.stack([first / np.linalg.norm(first), np.cross(normal, first / np.linalg.norm(first))])
    flat = [cleaned((ring - middle) @ axes.T, clockwise=k > 0) for k, ring in enumerate(rings)]
    if flat[0] is None:
        return None
    return np.asarray(middle + triangulated([ring for ring in flat if ring is not None]) @ axes)


# CityGML


def _of_gml(content: bytes) -> _Surfaces:
    """The surfaces of buildings in CityGML, by one pass without a tree."""
    found, reader = _Surfaces(), expat.ParserCreate(namespace_separator=" ")
    path: list[str] = []
    text: list[str] = []
    rings: Rings = []
    points: list[float] = []
    state = {"building": -1, "lod": -1.0}

    def begin(tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(" ")[2]
        path.append(name)
        if name == "Building" and "Building" not in path[:-1]:
            found.buildings += 1
            state["building"] = found.buildings
        elif match := re.match(r"lod(\d)", name):
            state["lod"] = float(match[1])
        elif name == "Polygon":
            rings.clear()
        elif name == "LinearRing":
            points.clear()
        if found.epsg is None and (code := EPSG.search(attributes.get("srsName", ""))):
            found.epsg = int(code[1])
        text.clear()

    def end(tag: str) -> None:
        name = path.pop()
        if name in ("pos", "posList") and "LinearRing" in path:
            points.extend(map(float, "".join(text).split()))
        elif name == "LinearRing":
            ring = np.array(points).reshape(-1, 3)
            rings.insert(0 if path[-1:] in (["exterior"], ["outerBoundaryIs"]) else len(rings), ring)
        elif name == "Polygon" and rings and "Building" in path and not set(path) & set(NOT_SEEN):
            found.add(state["building"], state["lod"], list(rings))  # type: ignore[arg-type]
        text.clear()

    def refuse(*_: Any) -> None:
        raise InputError("city model must have no entities in its XML, got one: remove its DOCTYPE")

    reader.StartElementHandler, reader.EndElementHandler = begin, end
    reader.CharacterDataHandler, reader.EntityDeclHandler = text.append, refuse
    reader.Parse(content, True)
    return found


# CityJSON


def _of_json(content: bytes) -> _Surfaces:
    """The surfaces of buildings in CityJSON."""
    data = json.loads(content)
    found = _Surfaces()
    if not isinstance(data, dict) or data.get("type") != "CityJSON":
        raise InputError("city model must have the type CityJSON, got another JSON file: convert it")
    vertices = np.array(data["vertices"], dtype=np.float64).reshape(-1, 3)
    if move := data.get("transform"):
        vertices = vertices * np.array(move["scale"]) + np.array(move["translate"])
    if code := EPSG.search(str(data.get("metadata", {}).get("referenceSystem", ""))):
        found.epsg = int(code[1])
    number: dict[str, int] = {}
    for name, one in data["CityObjects"].items():
        if one["type"] not in ("Building", "BuildingPart"):
            found.skipped["objects that are no buildings"] += 1
            continue
        owner = number.setdefault((one.get("parents") or [name])[0], len(number))
        found.buildings = len(number)
        for shape in one.get("geometry", ()):
            kinds = shape.get("semantics") or {}
            for surface, kind in _surfaces(shape["boundaries"], kinds.get("values"), DEPTH.get(shape["type"], -1)):
                seen = kind is None or kinds["surfaces"][kind]["type"] not in NOT_SEEN
                if seen:
                    found.add(
                        owner, float(shape.get("lod", 0)), [vertices[_in_range(ring, vertices)] for ring in surface]
                    )
    return found


DEPTH = {"MultiSurface": 1, "CompositeSurface": 1, "Solid": 2, "MultiSolid": 3, "CompositeSolid": 3}
"""Levels of lists above a surface, by the type of a geometry."""


def _surfaces(boundaries: Any, values: Any, depth: int) -> list[tuple[Any, int | None]]:
    """Surfaces, each a list of rings, and the index of their semantics."""
    if depth < 1:
        return []
    if depth == 1:
        kinds = values if isinstance(values, list) else [None] * len(boundaries)
        return list(zip(boundaries, kinds, strict=True))
    below = values if isinstance(values, list) else [None] * len(boundaries)
    return [pair for inside, kind in zip(boundaries, below, strict=True) for pair in _surfaces(inside, kind, depth - 1)]


def _in_range(ring: Any, vertices: Array) -> NDArray[np.int64]:
    index = np.array(ring, dtype=np.int64)
    if index.size and not 0 <= index.min() <= index.max() < len(vertices):
        raise InputError(f"city model must name vertices 0 to {len(vertices) - 1}, got {index.max()}: fetch it again")
    return index
