"""Reader of road maps: GeoJSON (RFC 7946) with LineStrings, such as an export of OpenStreetMap.

A line is a street in both directions. Of its properties these are read, by the names that OpenStreetMap uses:

- ``name``, ``ref`` or ``id``: what the road is called;
- ``oneway``: yes, true or 1 (along the line), -1 or reverse (against it), else both directions; lines of ``junction``
  roundabout and of ``highway`` motorway are of one direction unless ``oneway`` says no;
- ``maxspeed``: km/h, or ``30 mph``; 50 km/h where it is none, walk, signals, variable, or a zone as DE:urban;
- ``highway``: ways that no car drives on (footway, cycleway, ...) are left out.

Streets meet where their lines have a vertex in common.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.source import MAX_BYTES

__all__ = ["RoadLine", "RoadLines", "read_roads"]

Array = NDArray[np.float64]

KMH_MPS, MPH_MPS = 1.0 / 3.6, 0.44704
USUAL_LIMIT_MPS = 50.0 * KMH_MPS  # of a road without a limit: towns
FASTEST_MPS = 100.0
MOST_MALFORMED = 0.1  # share of ways; a file with more of them is not what it seems
NO_CARS = frozenset({
    "footway", "cycleway", "path", "steps", "pedestrian", "bridleway", "corridor", "platform", "track", "proposed",
    "construction", "elevator", "raceway",
})  # fmt: skip
FORWARD, BACKWARD, BOTH = frozenset({"yes", "true", "1"}), frozenset({"-1", "reverse"}), frozenset({"no", "false", "0"})
WGS84 = ("crs84", "epsg::4326", "epsg:4326")
# values of maxspeed that give no number: https://wiki.openstreetmap.org/wiki/Key:maxspeed
WITHOUT_NUMBER = re.compile(r"|none|walk|signals|variable|[a-z]{2}([-_][a-z]+)?:[\w:]+")
LINES = ("LineString", "MultiLineString")


@dataclass(frozen=True)
class RoadLine:
    """A line of a road: vertices (P, 2) longitude, latitude [deg]; name; limit [m/s]; the directions that exist."""

    lon_lat_deg: Array
    name: str
    limit_mps: float
    along: bool
    against: bool


@dataclass(frozen=True)
class RoadLines:
    """The lines of a file, and what else it holds: features that are no lines, ways without cars, ways and limits
    that are malformed, the first of each in words."""

    lines: tuple[RoadLine, ...]
    others: int
    without_cars: int
    malformed: int = 0
    limits: int = 0
    first: str = ""
    first_limit: str = ""

    @property
    def note(self) -> str:
        """What of the file was not used as it says, "" for nothing."""
        ways = f"{self.malformed} malformed ways left out, the first: {self.first}" if self.malformed else ""
        limits = f"{self.limits} speed limits taken as 50 km/h, the first: {self.first_limit}" if self.limits else ""
        return "; ".join(text for text in (ways, limits) if text)


def read_roads(path: str | Path) -> RoadLines:
    """Read the roads of a GeoJSON file.

    Raises
    ------
    InputError
        The file cannot be read, is no GeoJSON in longitude and latitude, holds no road, or more than a tenth of its
        ways or of their speed limits are malformed.
    """
    path = Path(path)
    features = _features(path, _document(path))
    lines: list[RoadLine] = []
    others = without_cars = ways = 0
    wrong: list[str] = []
    limits: list[str] = []
    for number, feature in enumerate(features):
        where = f"{path}, feature {number}"
        if not isinstance(feature, Mapping):
            raise InputError(f"{where} must be an object, got {type(feature).__name__}: is it GeoJSON?")
        geometry, given = feature.get("geometry"), feature.get("properties") or {}
        if not isinstance(geometry, Mapping) or geometry.get("type") not in LINES or not isinstance(given, Mapping):
            others += 1
        elif str(given.get("highway", "")) in NO_CARS:
            without_cars += 1
        else:
            try:
                lines += _lines(where, geometry, feature, given, number)
                ways += 1
                if _limit(given.get("maxspeed")) is None:
                    limits.append(f"{where}: maxspeed {str(given['maxspeed'])[:40]!r}")
            except InputError as error:  # one bad way of a city is no reason to refuse it
                wrong.append(str(error))
    if len(wrong) > max(MOST_MALFORMED * (len(lines) + len(wrong)), 1.0) or (wrong and not lines):
        raise InputError(f"{wrong[0]} ({len(wrong)} of {len(lines) + len(wrong)} ways of the file are malformed)")
    if len(limits) > max(MOST_MALFORMED * ways, 1.0):  # as many are no typing errors
        raise InputError(
            f"{limits[0]} must be a limit in km/h above 0 and up to {FASTEST_MPS / KMH_MPS:g}, or as '30 mph' or "
            f"DE:urban ({len(limits)} of {ways} ways have others): correct or remove them"
        )
    if not lines:
        raise InputError(
            f"{path} must hold a LineString that cars drive on, has {others} other features and {without_cars} ways "
            "without cars: export the streets as lines"
        )
    first, first_limit = (found[0] if found else "" for found in (wrong, limits))
    return RoadLines(tuple(lines), others, without_cars, len(wrong), len(limits), first, first_limit)


def _document(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path} must have at most {MAX_BYTES} bytes, has {path.stat().st_size}: cut out an area")
        text = path.read_text(encoding="utf-8-sig")
        if not text.strip():
            raise InputError(f"{path} must be GeoJSON, is empty: export it again")
        if text.lstrip().startswith("<"):
            raise InputError(f"{path} must be GeoJSON, is XML: convert an .osm file with osmtogeojson")
        found = json.loads(text)
    except OSError as error:
        raise InputError(f"map must be a file that can be read, got {path} ({error.strerror}): correct the path") from (
            error
        )
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path} must be GeoJSON, is no JSON ({str(error)[:120]}): export it again") from error
    if not isinstance(found, Mapping):
        raise InputError(f"{path} must hold a FeatureCollection, got {type(found).__name__}: is it GeoJSON?")
    return found


def _features(path: Path, document: Mapping[str, Any]) -> Sequence[Any]:
    """The features of a FeatureCollection, whose coordinates must be longitude and latitude."""
    features = document.get("features")
    if document.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise InputError(
            f"{path} must hold a FeatureCollection with features, got type {document.get('type')!r}: is it GeoJSON?"
        )
    crs = json.dumps(document.get("crs", "crs84")).lower()
    if not any(name in crs for name in WGS84):
        raise InputError(
            f"{path} must have coordinates in longitude and latitude (WGS 84), got crs {crs[:80]}: export it in "
            "EPSG:4326"
        )
    return features


def _lines(
    where: str, geometry: Mapping[str, Any], feature: Mapping[str, Any], given: Mapping[str, Any], number: int
) -> list[RoadLine]:
    """The lines of one feature."""
    parts = geometry.get("coordinates")
    parts = [parts] if geometry["type"] == "LineString" else parts
    if not isinstance(parts, list):
        raise InputError(f"{where}: coordinates must be a list, got {type(parts).__name__}: export it again")
    names = (given.get("name"), given.get("ref"), given.get("id"), given.get("@id"), feature.get("id"), number)
    name = str(next(value for value in names if value not in (None, "")))
    along, against = _directions(given)
    limit = _limit(given.get("maxspeed")) or USUAL_LIMIT_MPS
    found = [RoadLine(_vertices(where, part), name, limit, along, against) for part in parts]
    return [line for line in found if len(line.lon_lat_deg) > 1]


def _vertices(where: str, part: Any) -> Array:
    """Vertices (P, 2), none twice in a row."""
    if not isinstance(part, list) or len(part) < 2:
        count = len(part) if isinstance(part, list) else 0
        raise InputError(f"{where}: a line must have two vertices, got {count}: remove it")
    out = np.empty((len(part), 2))
    for k, vertex in enumerate(part):
        numbers = vertex[:2] if isinstance(vertex, list) else []
        good = len(numbers) == 2 and all(isinstance(v, int | float) and math.isfinite(v) for v in numbers)
        if not good or not (-180.0 <= numbers[0] <= 180.0 and -90.0 <= numbers[1] <= 90.0):
            metres = good and max(map(abs, numbers)) > 360.0
            raise InputError(
                f"{where}: vertex {k} must be longitude in [-180, 180] and latitude in [-90, 90], got "
                f"{str(vertex)[:60]}: {'they are metres, as of UTM; export in EPSG:4326' if metres else 'correct it'}"
            )
        out[k] = numbers
    return np.asarray(out[np.concatenate([[True], (np.diff(out, axis=0) != 0.0).any(-1)])])


def _directions(given: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether cars may drive along the line and against it."""
    way = str(given.get("oneway", "")).lower()
    if way in BACKWARD:
        return False, True
    one = given.get("junction") == "roundabout" or given.get("highway") == "motorway"
    return True, not (way in FORWARD or (one and way not in BOTH))


def _limit(given: Any) -> float | None:
    """A speed limit [m/s]; that of towns for values without a number, None for what no road has."""
    text = str(given if given is not None else "").strip().lower()
    unit = MPH_MPS if text.endswith("mph") else KMH_MPS
    try:
        limit = unit * float(text.removesuffix("mph").removesuffix("km/h").strip())
    except ValueError:
        return USUAL_LIMIT_MPS if WITHOUT_NUMBER.fullmatch(text) else None
    return limit if 0.0 < limit <= FASTEST_MPS else None
