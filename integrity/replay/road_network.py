"""The road network of a file near a recorded drive, as matchers take it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.recorded.road_file import RoadLine, RoadLines
from lanebound.integrity.replay.window import LocalFrame

__all__ = ["RoadNetwork", "network_near"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME_DEG = 1e-7  # 1 cm: vertices that are written alike are one


@dataclass(frozen=True)
class RoadNetwork:
    """A map, and the name of the road of each link."""

    road_map: RoadMap
    names: tuple[str, ...]


def network_near(roads: RoadLines, frame: LocalFrame, track_en_m: Array, within_m: float) -> RoadNetwork:
    """The links of roads that come within ``within_m`` of a track (T, 2) in E, N of the frame [m].

    Lines are cut where they share a vertex. The frame is a plane through the origin at its height.

    Raises
    ------
    InputError
        No road is near the track, or too many are.
    """
    vertices = np.concatenate([line.lon_lat_deg for line in roads.lines])
    keys, of = np.unique(np.rint(vertices / SAME_DEG).astype(np.int64), axis=0, return_inverse=True)
    place, length = (
        _plane(np.asarray(keys * SAME_DEG, np.float64), frame),
        [len(line.lon_lat_deg) for line in roads.lines],
    )
    paths = [path[np.diff(path, prepend=-1) != 0] for path in np.split(of.ravel(), np.cumsum(length)[:-1])]
    node = _is_node(paths, len(keys))
    ends: list[tuple[int, int]] = []
    lines: list[Array] = []
    limits: list[float] = []
    names: list[str] = []
    for line, path in zip(roads.lines, paths, strict=True):
        for piece in _pieces(path, node):
            if _is_near(place[piece], track_en_m, within_m):
                _add(line, piece, place, ends, lines, limits, names)
    if not ends:
        raise InputError(
            f"the map must have a road within {within_m:g} m of the drive, the nearest is "
            f"{_distance(place, track_en_m) / 1000.0:.1f} km away: give a map of its area"
        )
    used, renumbered = np.unique(np.array(ends), return_inverse=True)
    pairs = [(int(a), int(b)) for a, b in renumbered.reshape(-1, 2)]
    return RoadNetwork(RoadMap.of_lines(place[used], pairs, lines, limit_mps=limits), tuple(names))


def _plane(lon_lat_deg: Array, frame: LocalFrame) -> Array:
    """East and North (V, 2) of longitudes and latitudes."""
    _, _, height = geodetic_from_ecef(frame.origin_ecef_m)
    longitude, latitude = np.radians(lon_lat_deg).T
    ecef = ecef_from_geodetic(latitude, longitude, np.full(len(latitude), float(height)))
    return np.asarray(frame.local(ecef)[:, :2])


def _is_node(paths: list[Ints], count: int) -> NDArray[np.bool_]:
    """Whether a place is the end of a line, or a vertex of several lines, or of one line twice."""
    node = np.bincount(np.concatenate(paths), minlength=count) > 1
    node[[path[k] for path in paths for k in (0, -1)]] = True
    return np.asarray(node)


def _pieces(path: Ints, node: NDArray[np.bool_]) -> list[Ints]:
    """A line of places cut at nodes."""
    return [path[a : b + 1] for a, b in pairwise(np.flatnonzero(node[path]))]


def _add(
    line: RoadLine, piece: Ints, place: Array, ends: list[tuple[int, int]], lines: list[Array], limits: list[float],
    names: list[str],
) -> None:  # fmt: skip
    """Add the links of a piece in the directions that exist."""
    for exists, way in ((line.along, piece), (line.against, piece[::-1])):
        if exists:
            ends.append((int(way[0]), int(way[-1])))
            lines.append(place[way])
            limits.append(line.limit_mps)
            names.append(line.name)


def _is_near(line: Array, track: Array, within_m: float) -> bool:
    """Whether a line (P, 2) comes within a distance of a track, to a tenth of it."""
    low, high = line.min(0) - within_m, line.max(0) + within_m
    some = track[((track >= low) & (track <= high)).all(-1)]
    if not len(some):
        return False
    step = np.hypot(*np.diff(line, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, arc[-1], 2 + int(arc[-1] / (0.2 * within_m)))
    points = np.stack([np.interp(at, arc, column) for column in line.T], -1)
    return any(bool((np.square(points - here).sum(-1) <= within_m**2).any()) for here in some)


def _distance(place: Array, track: Array) -> float:
    """Least distance between places and a track [m]."""
    return float(min(np.hypot(*(place - here).T).min() for here in track))
