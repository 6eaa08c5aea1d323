"""A closed way through a real street map as a road: its streets, its lanes, and the buildings around it.

A way follows the rightmost lanes of its streets, as many as its narrowest street has. The corners of the streets become
bends with transitions; where streets jog within a few metres, as in junctions that are drawn as several points, the
corners are joined, until each bend can be driven. The ground is flat, and traffic keeps to the right.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from math import atan2, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.envs.records import enu_of, xy_of
from lanebound.envs.worlds.lanes import CurveLane
from lanebound.envs.worlds.networks import APART_M, StreetNetwork
from lanebound.envs.worlds.paths import Path, Piece, Pose, bend, straight, tangent_m
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.city import CityConfig, SectionKind, Stretch, line_street
from lanebound.integrity.sky.maps.city import bridges_above, city_of, in_buildings
from lanebound.integrity.sky.maps.generated import GENERATED, named_map
from lanebound.integrity.sky.maps.graph import StreetGraph, distance_m
from lanebound.integrity.sky.maps.lines import along
from lanebound.integrity.sky.maps.loops import FAR_M, ClosedWay, loops_of, loops_via
from lanebound.integrity.sky.maps.polygons import crossing
from lanebound.integrity.sky.maps.records import StreetMap, StreetWay
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City

__all__ = ["EACH_CITY", "MOST_CITIES", "MapRoad", "map_cities_of", "map_place", "map_roads", "map_roads_of"]

Array = NDArray[np.float64]
Place = tuple[float, float]

EACH_CITY = "generated"  # map of a world that has a road in each of its generated cities
MOST_CITIES = 128
SIMPLE_M = 0.5  # by which a street may differ from its points
TAPER_M = 15.0  # before and after a place where the lanes of a street lie elsewhere in the carriageway
STRAIGHT_ON = radians(15.0)  # of a turn, below which lanes shift by a taper
SHARPEST = radians(140.0)
RADIUS_M = 15.0  # of bends at corners, where there is room: kerbs of 12 m, and half a street of one lane each way
LEAST_RADIUS_M = 9.0  # of the innermost lane; a car turns within 6 m at walking speed
CUT_M = 1.0  # by which a wide bend cuts a corner
WIDEST_M = 300.0  # of radii
MOVED_M = 6.0  # by which joined corners may lie beside the street: half a carriageway of four lanes
SAMPLE_M = 2.0
LEAST_CUT_M = 2.0  # straight at which one road goes over into the next
LEAST_ROAD_M = 40.0
LEAST_LOOP_M = 200.0
REACH_M = 2000.0  # from the middle of a map, or from the places of a way: a longer way is none of one episode
LANE_WIDTH_M = 3.25  # of worlds, if none is given
ROADS = 4  # at least, where there are straights
ROAD_M = 1500.0  # between the wished ends of longer ones: roads end on straights, and the sky of one ends at 2500 m
MOST_VIA = 8  # both directions of each are tried
UNIT_M = 100.0
BLUNT = 1.0 / 3.0  # share of the other turn, below which a corner is left out for its neighbour
FLAT = radians(0.2)  # of a turn that is none


@dataclass(frozen=True)
class MapRoad:
    """The road of a way through a map.

    Attributes
    ----------
    roads : path of the leftmost lane, and speed limit [m/s], of each road of the way in order
    lanes, width_m : number and width of the lanes of all roads
    city : the obstacles around it
    """

    roads: tuple[tuple[Path, float], ...]
    lanes: int
    width_m: float
    city: City

    @property
    def length_m(self) -> float:
        """Length of the leftmost lane."""
        return sum(path.length for path, _ in self.roads)

    def network(self) -> StreetNetwork:
        """The network: nodes m0, m1, ..., the last road ends where the first begins."""
        out = StreetNetwork()
        for k, (path, limit) in enumerate(self.roads):
            edge = f"m{k}", f"m{(k + 1) % len(self.roads)}"
            out.add_beside(edge, path, range(self.lanes), self.width_m, limit)
        return out


def map_roads_of(world: Mapping[str, Any]) -> tuple[MapRoad, ...]:
    """The roads of a world's configuration, each made once: ``map``, ``route``, ``via``, ``roads``, ``lane_width``.

    Empty without a map. Several are those of the ways from ``route`` on, or one of each generated city of ``seeds``.

    Raises
    ------
    ConfigError
        The map has fewer closed ways, no way leads by the places, or the places are none.
    InputError
        The map is refused by its reader.
    """
    return tuple(_road(*asked) for asked in _asked(world))


def map_cities_of(world: Mapping[str, Any]) -> tuple[City, ...]:
    """The obstacles around these roads, each at its site of the network (:meth:`~.networks.StreetNetwork.apart`)."""
    return tuple(_city_at(k, *asked) for k, asked in enumerate(_asked(world)))


@lru_cache(maxsize=128)
def _city_at(site: int, *asked: Any) -> City:
    return _road(*asked).city.moved(0.0, -site * APART_M)


def _asked(world: Mapping[str, Any]) -> list[tuple[str, StreetMap | None, int, tuple[Place, ...], float]]:
    """Name and contents of the map, number of the way, places and width of a lane of each road that a world asks for.

    The contents of a file stand for its state: a file that has changed is another map.
    """
    name, via, roads = world.get("map"), world.get("via") or (), world.get("roads", 1)
    if name is None:
        if via or world.get("route") or roads > 1:
            raise ConfigError(
                "world.route, world.via and world.roads must be left out without world.map: add it, or remove them"
            )
        return []
    if not isinstance(name, str):
        raise ConfigError(f"world.map must be a packaged map or a file, got {name!r}: write its name")
    if not (isinstance(via, list | tuple) and all(map(_is_place, via)) and len(via) != 1):
        raise ConfigError(f"world.via must be two places or more, each [latitude, longitude], got {via!r}: correct it")
    if len(via) > MOST_VIA:
        raise ConfigError(f"world.via must hold at most {MOST_VIA} places, got {len(via)}: leave some out")
    places, width_m, route = tuple(map(tuple, via)), world["lane_width"], world["route"]
    if name == EACH_CITY:
        if roads > 1 or route or via:  # each city has its own ways and places
            raise ConfigError(
                "world.roads, world.route and world.via must be left out with world.map 'generated': set cities.count, "
                "or take one map, 'generated:SEED'"
            )
        return [(f"{GENERATED}{seed}", None, route, places, width_m) for seed in world["seeds"]]
    streets = None if name.startswith(GENERATED) else named_map(name)
    return [(name, streets, route + k, places, width_m) for k in range(roads)]


def _is_place(place: Any) -> bool:
    """Whether a value is a latitude and a longitude [deg]."""
    two = isinstance(place, list | tuple) and len(place) == 2
    return two and all(isinstance(v, int | float) and abs(v) <= most for v, most in zip(place, (90, 180), strict=True))


def map_place(world: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of NavigatorConfig that move the satellites to the place of a world's map; none without a map."""
    name = world.get("map")
    if not isinstance(name, str):
        return {}
    frame = named_map(f"{GENERATED}0" if name == EACH_CITY else name).frame  # generated cities lie in one place
    return {"sky": {"lat_deg": frame.lat_deg, "lon_deg": frame.lon_deg}}


def map_roads(name: str, width_m: float = LANE_WIDTH_M, most: int = 8) -> list[MapRoad]:
    """The roads of the longest closed ways through a map, in the order of ``world.route``; an empty list for none.

    Raises
    ------
    InputError
        The map is refused by its reader.
    """
    streets = named_map(name)
    return [_made(streets, *way, width_m) for way in _fitted(streets, _graph(streets), (), width_m, most)]


@lru_cache(maxsize=128)
def _road(name: str, streets: StreetMap | None, route: int, via: tuple[Place, ...], width_m: float) -> MapRoad:
    streets = named_map(name) if streets is None else streets
    for k, place in enumerate(via):
        at = streets.frame.en_of(*place)
        away_m = min(distance_m(street.points_en_m, at) for street in streets.streets)
        if away_m > FAR_M:
            raise ConfigError(
                f"world.via.{k} must lie within {FAR_M:g} m of a street of {name}, got {list(place)}, {away_m:.0f} m "
                "away: write latitude, longitude"
            )
    found = list(_fitted(streets, _graph(streets), via, width_m, route + 1))
    if not found and via:
        raise ConfigError(f"world.via must be places of {name} that a closed way joins, got {via!r}: choose others")
    if not found:
        raise ConfigError(f"world.map must hold a closed way that can be driven, got none in {name}: cut a larger part")
    if len(found) <= route:
        reason = "no more closed ways lead by these places" if via else "the map has no more closed ways"
        raise ConfigError(f"world.route must be below {len(found)} in {name}, got {route}: {reason}, choose another")
    return _made(streets, *found[route], width_m)


@lru_cache(maxsize=4)
def _graph(streets: StreetMap) -> StreetGraph:
    return StreetGraph.of(streets)


def _fitted(
    streets: StreetMap, graph: StreetGraph, via: tuple[Place, ...], width_m: float, count: int
) -> Iterator[tuple[_LaneLine, int]]:
    """The first lines that can be driven, of loops in order of their length, the longest first; at most ``count``."""
    places = [tuple(streets.frame.en_of(*place).tolist()) for place in via]
    near = graph.near(places or [(0.0, 0.0)], REACH_M)
    loops = list(loops_via(streets, near, places) if via else loops_of(streets, near))
    for loop in sorted(loops, key=lambda one: -one.length_m):
        lanes = min(edge.lanes for edge in loop.edges)
        line = _joined(_offset(loop, lanes, width_m), lanes, width_m)
        if line is not None and line.length_m >= LEAST_LOOP_M and _is_free(streets, line, lanes, width_m):
            yield line, lanes
            count -= 1
            if not count:
                return


@dataclass(frozen=True)
class _LaneLine:
    """A closed polygon in East, North (n, 2) [m]; side k leads from corner k; the street of each side; radii (n,)."""

    corners: Array
    ways: tuple[StreetWay, ...]
    radius_m: Array

    @property
    def sides(self) -> Array:
        return np.roll(self.corners, -1, 0) - self.corners

    @property
    def length_m(self) -> float:
        return float(np.linalg.norm(self.sides, axis=1).sum())

    @property
    def turns(self) -> Array:
        """Angle at each corner, positive to the right [rad]."""
        azimuth = np.arctan2(*self.sides.T)
        return np.asarray(wrap_angle(azimuth - np.roll(azimuth, 1)))

    @property
    def straights_m(self) -> Array:
        """What the bends leave of each side."""
        cut = self.radius_m * np.array([_tangent(float(turn)) for turn in self.turns])
        return np.asarray(np.linalg.norm(self.sides, axis=1) - cut - np.roll(cut, -1))


# The lanes in the streets


def _offset(loop: ClosedWay, lanes: int, width_m: float) -> _LaneLine | None:
    """The middle of the leftmost of the rightmost ``lanes`` lanes along a loop; None if a corner is too sharp."""
    points, shifts, ways = [], [], []
    for edge in loop.edges:
        line = _simplified(edge.points_en_m)
        points.append(line[:-1])
        shifts += [edge.right_of_middle_m(lanes - 1, width_m)] * (len(line) - 1)
        ways += [edge.way] * (len(line) - 1)
    at = np.concatenate(points)
    side = np.roll(at, -1, 0) - at
    length = np.linalg.norm(side, axis=1)
    ahead = side / np.maximum(length, 1e-9)[:, None]
    right = np.stack([ahead[:, 1], -ahead[:, 0]], -1)
    corners, owner = [], []
    for k in range(len(at)):
        turn = wrap_angle(atan2(*ahead[k]) - atan2(*ahead[k - 1]))
        if abs(turn) > SHARPEST:
            return None
        before, after = shifts[k - 1], shifts[k]
        if before != after and abs(turn) < STRAIGHT_ON:
            back, on = (min(TAPER_M, 0.4 * float(length[j])) for j in (k - 1, k))
            corners += [at[k] - back * ahead[k - 1] + before * right[k - 1], at[k] + on * ahead[k] + after * right[k]]
            owner += [ways[k], ways[k]]
        elif before == after:
            corners.append(at[k] + after * (right[k - 1] + right[k]) / (1.0 + float(right[k - 1] @ right[k])))
            owner.append(ways[k])
        else:
            corners.append(at[k] + np.linalg.solve(right[[k - 1, k]], np.array([before, after])))
            owner.append(ways[k])
    return _LaneLine(np.array(corners), tuple(owner), np.zeros(len(corners)))


def _simplified(line: Array) -> Array:
    """A line without the points that lie within 0.5 m of the straight between others (Douglas and Peucker)."""
    kept, parts = {0, len(line) - 1}, [(0, len(line) - 1)]
    while parts:
        first, last = parts.pop()
        away, chord = line[first : last + 1] - line[first], line[last] - line[first]
        length = float(np.linalg.norm(chord))
        across = np.array([chord[1], -chord[0]]) / max(length, 1e-9)
        aside = np.linalg.norm(away, axis=1) if length < SIMPLE_M else np.abs(away @ across)
        k = int(np.argmax(aside))
        if aside[k] > SIMPLE_M:
            kept.add(first + k)
            parts += [(first, first + k), (first + k, last)]
    return line[sorted(kept)]


# Corners that can be driven


@cache
def _tangent(turn: float) -> float:
    """Distance from a corner to its bend over the radius of the bend, half of whose turn is in its transitions."""
    if abs(turn) < 1e-6:
        return 0.0
    return tangent_m(bend(turn, UNIT_M, 0.5 * UNIT_M * abs(turn)), turn) / UNIT_M


def _joined(line: _LaneLine | None, lanes: int, width_m: float) -> _LaneLine | None:
    """A line all of whose bends can be driven, by joining corners; None if a corner would move too far."""
    if line is None:
        return None
    first = line
    while len(line.corners) >= 3:
        turns = line.turns
        length = np.linalg.norm(line.sides, axis=1)
        flat = (length < SIMPLE_M) | (np.abs(np.roll(turns, -1)) < FLAT)
        if flat.any():  # its end is no corner
            line = _without(line, (int(np.argmax(flat)) + 1) % len(length))
            continue
        if np.abs(turns).max() > SHARPEST:
            return None
        inner = np.where(turns > 0.0, (lanes - 1) * width_m, 0.0)  # from the leftmost lane to the innermost one
        radius, least = _radii(turns, length, inner), LEAST_RADIUS_M + inner
        k = int(np.argmin(radius / least))
        if radius[k] >= least[k]:
            far = max(_beside_m(first.corners, line.corners), _beside_m(line.corners, first.corners)) > MOVED_M
            return None if far or _crosses_itself(line.corners) else _LaneLine(line.corners, line.ways, radius)
        shorter = k if length[k] <= length[k - 1] else (k - 1) % len(length)
        line = _collapsed(line, shorter)
    return None


def _radii(turns: Array, length: Array, inner_m: Array) -> Array:
    """Radii of bends, or those for which the sides have room, which two bends share by what they need.

    The innermost lane, ``inner_m`` from the line, cuts a corner by ``CUT_M``, with no less than ``RADIUS_M``.
    """
    tangent = np.array([_tangent(float(turn)) for turn in turns])
    wished = np.maximum(RADIUS_M, CUT_M / np.maximum(1.0 / np.cos(0.5 * turns) - 1.0, 1e-9))
    wanted = tangent * (np.minimum(wished, WIDEST_M) + inner_m)
    share = np.minimum(1.0, length / np.maximum(wanted + np.roll(wanted, -1), 1e-9))
    return np.asarray(wanted * np.minimum(share, np.roll(share, 1)) / np.maximum(tangent, 1e-9))


def _without(line: _LaneLine, k: int) -> _LaneLine:
    """A line without corner k; its side goes to that before it."""
    keep = np.arange(len(line.corners)) != k
    ways = list(line.ways)
    length = np.linalg.norm(line.sides, axis=1)
    if length[k] > length[k - 1]:
        ways[k - 1] = ways[k]
    del ways[k]
    return _LaneLine(line.corners[keep], tuple(ways), line.radius_m[keep])


def _collapsed(line: _LaneLine, k: int) -> _LaneLine:
    """A line with one corner in place of side k.

    It is the sharper one of two, where the other hardly turns; where the sides beside it meet, if both turn in the same
    direction; or else the middle of the side.
    """
    n = len(line.corners)
    a, b, before, after = (line.corners[j % n] for j in (k, k + 1, k - 1, k + 2))
    here, onward = float(line.turns[k]), float(line.turns[(k + 1) % n])
    point = 0.5 * (a + b)
    u, v = a - before, b - after
    size = u[0] * v[1] - u[1] * v[0]
    if min(abs(here), abs(onward)) < BLUNT * max(abs(here), abs(onward)):
        point = a if abs(here) > abs(onward) else b
    elif here * onward > 0.0 and abs(size) > 1e-3:
        d = b - a
        ahead = (d[0] * v[1] - d[1] * v[0]) / size
        if ahead > 0.0:
            point = a + ahead * u
    corners = line.corners.copy()
    corners[k] = point
    return _without(_LaneLine(corners, line.ways, line.radius_m), (k + 1) % n)


def _beside_m(corners: Array, places: Array) -> float:
    """Largest distance of places (n, 2) from a closed polygon."""
    line = along(np.vstack([corners, corners[:1]]), 1.0)
    return float(np.max(cKDTree(line).query(places)[0]))


def _crosses_itself(corners: Array) -> bool:
    """Whether two sides of a closed polygon cross that are no neighbours."""
    n = len(corners)
    closed = np.vstack([corners, corners[:1]])
    for k in range(n):
        meets = np.isfinite(crossing(closed, closed[k], closed[k + 1])[:, 0])
        meets[[k, (k + 1) % n, k - 1]] = False
        if meets.any():
            return True
    return False


# The road


def _is_free(streets: StreetMap, line: _LaneLine, lanes: int, width_m: float) -> bool:
    """Whether no lane leads through a building; there is nothing in a tunnel or a passage."""
    roads = _roads(line)
    if not roads:
        return False
    places = []
    for path, _ in roads:
        for k in range(lanes):
            lane = CurveLane(path, k * width_m, width_m)
            at = np.linspace(0.0, lane.length, int(lane.length / SAMPLE_M) + 2)
            places += [lane.position(s, aside) for s in at.tolist() for aside in (-0.5 * width_m, 0.0, 0.5 * width_m)]
    en = enu_of(np.array(places))
    for run in _covered_runs(line):
        en = en[cKDTree(along(run, 1.0)).query(en)[0] > lanes * width_m]
    return not in_buildings(en, streets).any()


def _covered_runs(line: _LaneLine) -> list[Array]:
    """The parts of a line below a roof, (n, 2) each."""
    n = len(line.ways)
    runs: list[list[int]] = []
    for k, way in enumerate(line.ways):
        if way.covered:
            runs[-1].append(k) if runs and runs[-1][-1] == k - 1 else runs.append([k])
    return [line.corners[[*run, (run[-1] + 1) % n]] for run in runs]


def _roads(line: _LaneLine) -> list[tuple[Path, float]]:
    """Path and speed limit of each road of a line: a road ends where the limit changes, on a straight."""
    length, rest = np.linalg.norm(line.sides, axis=1), line.straights_m
    n, limits = len(length), [way.speed_limit_mps for way in line.ways]
    arc = np.cumsum(length)
    wanted = [k for k in range(n) if limits[k] != limits[k - 1]]
    roads = max(ROADS, int(np.ceil(arc[-1] / ROAD_M)))
    wanted += [int(np.searchsorted(arc, share * arc[-1])) % n for share in np.arange(roads) / roads]
    cuts: list[int] = []
    for k in wanted:
        cut = next((j % n for j in range(k, k + n) if rest[j % n] >= LEAST_CUT_M), None)
        if cut is not None and all(_apart(arc, cut, other) >= LEAST_ROAD_M for other in cuts):
            cuts.append(cut)
    cuts.sort()
    if len(cuts) < 2:
        return []
    out = []
    for first, last in zip(cuts, [*cuts[1:], cuts[0] + n], strict=True):
        sides = [k % n for k in range(first, last + 1)]
        inner = length[sides]
        inner[[0, -1]] *= 0.5
        weights = {limit: float(inner[[limits[k] == limit for k in sides]].sum()) for limit in limits}
        out.append((_path(line, sides), max(weights, key=lambda limit: (weights[limit], -limit))))
    return out


def _apart(arc: Array, k: int, other: int) -> float:
    """Distance along a loop between the ends of two sides."""
    gap = abs(float(arc[k] - arc[other]))
    return min(gap, float(arc[-1]) - gap)


def _path(line: _LaneLine, sides: Sequence[int]) -> Path:
    """The path from the middle of the first of some sides to that of the last."""
    rest, turns, (first, *_) = line.straights_m, line.turns, sides
    ahead = line.sides[first] / np.linalg.norm(line.sides[first])
    start = line.corners[first] + ahead * (line.radius_m[first] * _tangent(float(turns[first])) + 0.5 * rest[first])
    (x, y), (along_x, along_y) = xy_of(start), xy_of(ahead)
    pieces: list[Piece] = straight(0.5 * float(rest[first]))
    for k in sides[1:]:
        turn, radius = float(turns[k]), float(line.radius_m[k])
        pieces += bend(turn, radius, 0.5 * radius * abs(turn))
        pieces += straight(float(rest[k]) * (0.5 if k == sides[-1] else 1.0))
    return Path.of(Pose(float(x), float(y), atan2(along_y, along_x)), [one for one in pieces if one.length > 1e-6])


def _made(streets: StreetMap, line: _LaneLine, lanes: int, width_m: float) -> MapRoad:
    """The road of a line with what stands around it."""
    closed = np.vstack([line.corners, line.corners[:1]])
    city = city_of(streets, closed) + bridges_above(streets, closed, line.ways)
    for run in _covered_runs(line):
        road = Road.through(
            run, corner_radius_m=RADIUS_M, lane_count=lanes, lane_width_m=width_m, shift_m=0.5 * (lanes - 1) * width_m
        )
        tunnel = [Stretch(0.0, road.length_m, SectionKind.TUNNEL, SectionKind.TUNNEL)]
        city = city + line_street(road, tunnel, CityConfig(), named_generator(0, "tunnel"))
    return MapRoad(tuple(_roads(line)), lanes, width_m, city)
