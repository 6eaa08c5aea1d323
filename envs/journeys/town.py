"""A generated city as journeys see it: its streets between junctions and places, the sky by map, and the true one."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lanebound.envs.journeys.plan_kernel import plan_routes
from lanebound.envs.journeys.records import AHEAD, EDGE, MOST_STREETS, STATION
from lanebound.envs.sky.cache import folder, sources_digest, write
from lanebound.envs.sky.cities import TEST_CITIES
from lanebound.envs.sky.level import SkyLevel
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sky.availability import WORST_PDOP, packaged_model
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.journeys.planner import GAPS_S, WEIGHT, StreetsAhead
from lanebound.integrity.sky.journeys.realised import packaged_law
from lanebound.integrity.sky.journeys.streets import (
    AZIMUTH_STEP_DEG,
    ELEVATION_STEP_DEG,
    SPACING_M,
    EdgeStations,
    SkyAlong,
    at_hour,
    turn_s,
)
from lanebound.integrity.sky.maps.city import city_of
from lanebound.integrity.sky.maps.generated import generated_map
from lanebound.integrity.sky.maps.graph import StreetEdge, StreetGraph
from lanebound.integrity.sky.maps.lines import arcs_of, part_of
from lanebound.integrity.sky.prediction import StreetPrediction
from lanebound.integrity.sky.scene import City, clad
from lanebound.integrity.sky.survey import MapConfig, as_mapped
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import cells_of

__all__ = ["JourneyTown", "StreetForecast", "Town", "TownHour", "city_hours", "generated_town", "navigator_at"]

Array = NDArray[np.float64]
Int8 = NDArray[np.int8]

KEPT = "journeys"  # folder of the cache
LEAST_APART_M = 300.0  # of the places of a journey
CITIES = TEST_CITIES  # that are kept in memory, of about 2 MB for each hour and 2 MB for the streets
SAME_M = 1e-6  # points that are nearer are one
PLACES = 40  # where journeys of a city begin and end; chosen: some 1,200 pairs, and 2 MB of plans for each hour


class Town(NamedTuple):
    """A city, its graph, its solids as they are and as they are mapped."""

    graph: StreetGraph
    true: City
    mapped: City


def generated_town(sky: str, errors: MapConfig, map_seed: int, seed: int) -> Town:
    """The generated city of a seed under a level of sky, which gives materials; the map is a draw of its own.

    errors, map_seed : of the map of the prediction
    """
    streets = generated_map(seed)
    city = city_of(streets)
    city = replace(
        city, material=clad(city.building, SkyLevel.named(sky).material_shares, named_generator(seed, "facades"))
    )
    return Town(StreetGraph.of(streets), city, as_mapped(city, errors, named_generator([map_seed, seed], "map")))


def navigator_at(sky: str, base: NavigatorConfig, hour: float) -> NavigatorConfig:
    """The navigator with the instruments of a level of sky, at an hour of the day."""
    found = SkyLevel.named(sky).navigator(base)
    return found.replace(sky=at_hour(found.sky, hour).to_dict())


class StreetForecast(NamedTuple):
    """What is predicted of all streets, and the best options towards each place by it.

    Attributes
    ----------
    ahead : (E, G) AHEAD
    aware, fast, short : (P, E, G), (P, E), (P, E) options
    """

    ahead: Records
    aware: Int8
    fast: Int8
    short: Int8


@dataclass(frozen=True, eq=False)
class JourneyTown:
    """A city whose streets are cut at the places where journeys begin and end.

    Attributes
    ----------
    graph : after the cuts, without streets that are not connected in both directions
    places : (P, 2) East, North [m]
    origins, goals : (P, K), (P, 2) edges that leave a place, and that end there; -1: none
    pairs : (M, 2) places that are at least 300 m apart
    edges : (E,) EDGE
    true : what stands there
    sky : level whose satellites and instruments are used
    """

    graph: StreetGraph
    places: Array
    origins: NDArray[np.int64]
    goals: NDArray[np.int64]
    pairs: NDArray[np.int64]
    edges: Records
    stations: EdgeStations
    true: City
    sky: str

    @classmethod
    def of(cls, town: Town, sky: str, rng: np.random.Generator, places: int = PLACES) -> JourneyTown:
        """Cut the streets of a city at places drawn at random.

        Raises
        ------
        InputError
            A junction has more streets than an observation shows, or no two places are 300 m apart.
        """
        inside = _connected(town.graph)
        pieces = sorted({min(k, back) for k in inside if (back := _back(town.graph, k)) in inside})
        chosen = sorted(rng.choice(len(pieces), min(places, len(pieces)), replace=False).tolist())
        graph, begins, ends = _cut(town.graph, inside, [pieces[k] for k in chosen])
        stations = EdgeStations.along(graph.edges)
        middles = np.array([graph.edges[own[0]].points_en_m[-1] for own in ends])
        apart = np.linalg.norm(middles[:, None] - middles, axis=-1) >= LEAST_APART_M
        if not apart.any():
            raise InputError(f"places must be {LEAST_APART_M:g} m apart, got none that are: take a larger city")
        origins = _padded([_sorted(graph, own) for own in begins], MOST_STREETS)
        return cls(
            graph, middles, origins, _padded(ends, 2), np.argwhere(apart), _edges(graph, stations), stations, town.true,
            sky,
        )  # fmt: skip

    def hours(self, mapped: City, hours: Sequence[float], kept: bool = False) -> tuple[TownHour, ...]:
        """The city at hours of the day, with the forecast of a map.

        kept : whether rays are kept on disk
        """
        map_sky, true_sky = self._skies(mapped, kept)
        found = []
        for hour in hours:
            track = SkyTrack.from_config(navigator_at(self.sky, NavigatorConfig(), hour).sky, 60.0)
            view = track.at(track.start_s)
            true = true_sky.at(view)
            law = packaged_law().at(true.satellites.astype(np.float64), np.minimum(true.pdop, WORST_PDOP))
            stations = np.zeros(len(self.stations.part_m), STATION)
            stations["part_m"], stations["satellites"] = self.stations.part_m, law.satellites
            stations["rtk_after"], stations["usable_after"] = law.rtk_after, law.usable_after
            found.append(TownHour(self, hour, stations, self.forecast(map_sky.at(view)), true))
        return tuple(found)

    def _skies(self, mapped: City, kept: bool) -> tuple[SkyAlong, SkyAlong]:
        """The sky along the stations by the map and in truth, from disk where it is there for the same geometry."""
        place, digest = folder(KEPT) if kept else None, hashlib.blake2b(sources_digest().encode(), digest_size=16)
        solids = (part for city in (mapped, self.true) for part in (city.triangles_enu_m, city.surface))
        for array in (self.stations.antenna_enu_m, self.stations.covered, *solids):
            digest.update(repr((array.shape, array.dtype.str)).encode() + array.tobytes())
        key, bins = digest.hexdigest(), cells_of(AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG)
        shape = len(self.stations.part_m), 1, bins[0] * bins[1]
        with suppress(OSError, EOFError, KeyError, ValueError, BadZipFile, zlib.error):
            if place is not None:
                with np.load(place / f"{key}.npz", allow_pickle=False) as data:
                    if tuple(data["shape"]) != shape:
                        raise ValueError(f"shape must be {shape}, got {tuple(data['shape'])}")
                    both = [np.unpackbits(data[n], count=np.prod(shape)).reshape(shape) > 0 for n in ("mapped", "true")]
                a, b = (SkyAlong(self.stations, SkyForecast(free, *bins, SPACING_M)) for free in both)
                return a, b
        a, b = (SkyAlong.of(self.stations, city) for city in (mapped, self.true))
        packed = {name: np.packbits(one.forecast.free) for name, one in (("mapped", a), ("true", b))}
        write(place, key, shape=np.array(shape), **packed)
        return a, b

    def forecast(self, seen: StreetPrediction) -> StreetForecast:
        """What these satellites at the stations let one predict."""
        ahead = StreetsAhead.of(self.graph, self.stations, packaged_model(), seen)
        lost, leaves = ahead.by_class
        model, count = ahead.model, len(self.edges)
        time_s = self.edges["length_m"] / self.edges["limit_mps"]
        chance = np.clip(1.0 - lost / time_s[:, None], 0.0, 1.0)
        at = [int(np.argmin(np.abs(model.shares - share))) for share in (0.5, 0.9)]
        out = np.zeros(lost.shape, AHEAD)
        out["lost_s"], out["leaves"] = lost, leaves
        out["level_m"] = model.quantiles(chance.ravel())[:, at].reshape(*chance.shape, 2)
        first = ahead.satellites[self.stations.first[:-1]]
        out["risk"] = 1.0 - np.stack([model.probability(first, np.full(count, gap)) for gap in GAPS_S], -1)
        shape = len(self.places), count
        aware = np.empty((*shape, len(GAPS_S)), np.int8)
        fast, short = np.empty(shape, np.int8), np.empty(shape, np.int8)
        room = np.arange(count), np.empty(count), np.empty(lost.shape)
        plan_routes(self.goals, self.edges, out, WEIGHT, *room, aware, fast, short)
        return StreetForecast(out, aware, fast, short)


@dataclass(frozen=True, eq=False)
class TownHour:
    """A city at one hour.

    Attributes
    ----------
    stations : (N,) STATION, of the true city
    mapped : what the map predicts
    seen : satellites in the true city
    """

    town: JourneyTown
    hour: float
    stations: Records
    mapped: StreetForecast
    seen: StreetPrediction

    @cached_property
    def oracle(self) -> StreetForecast:
        """What the true city would let one predict; nothing of it is in an observation."""
        return self.town.forecast(self.seen)


def _connected(graph: StreetGraph) -> set[int]:
    """The longest set of edges of which each leads to each."""
    count = len(graph.edges)
    a, b = np.array(graph.turns).reshape(-1, 2).T
    _, part = connected_components(coo_array((np.ones(a.size), (a, b)), (count, count)), connection="strong")
    length = np.bincount(part, [edge.length_m for edge in graph.edges])
    return set(np.flatnonzero(part == np.argmax(length)).tolist())


def _back(graph: StreetGraph, k: int) -> int:
    """The same piece in the other direction, itself where there is none."""
    own = graph.edges[k]
    return next((n for n, edge in enumerate(graph.edges) if own.turns_back(edge)), k)


def _cut(
    graph: StreetGraph, inside: set[int], pieces: Sequence[int]
) -> tuple[StreetGraph, list[list[int]], list[list[int]]]:
    """The connected graph with pieces cut in their middles, and the edges that leave and that end at each cut."""
    place = {k: p for p, piece in enumerate(pieces) for k in {piece, _back(graph, piece)} & inside}
    new: dict[int, tuple[int, int]] = {}  # first and last part of each edge
    edges: list[StreetEdge] = []
    for k in sorted(inside):
        parts = _halves(graph.edges[k], -1 - place[k]) if k in place else (graph.edges[k],)
        new[k] = len(edges), len(edges) + len(parts) - 1
        edges += parts
    turns = [(new[a][1], new[b][0]) for a, b in graph.turns if a in inside and b in inside]
    turns += [ends for ends in new.values() if ends[0] != ends[1]]
    begins, ends = ([[new[k][n] for k in sorted(place) if place[k] == p] for p in range(len(pieces))] for n in (1, 0))
    return StreetGraph(tuple(edges), tuple(turns)), begins, ends


def _halves(edge: StreetEdge, middle: int) -> tuple[StreetEdge, StreetEdge]:
    """Both halves of an edge, which meet at a point of this number."""
    points, length = edge.points_en_m, float(arcs_of(edge.points_en_m)[-1])
    before, after = (part_of(points, *ends, SAME_M) for ends in ((0.0, 0.5 * length), (0.5 * length, length)))
    return replace(edge, end=middle, points_en_m=before), replace(edge, start=middle, points_en_m=after)


def _azimuth(edge: StreetEdge, end: bool) -> float:
    a, b = edge.points_en_m[-2:] if end else edge.points_en_m[:2]
    return float(np.arctan2(b[0] - a[0], b[1] - a[1]))


def _sorted(graph: StreetGraph, edges: Sequence[int], facing_rad: float = 0.0) -> list[int]:
    """Edges from the sharpest left to the sharpest right of a direction."""

    def turned(k: int) -> float:
        return float(np.remainder(_azimuth(graph.edges[k], False) - facing_rad + np.pi, 2.0 * np.pi))

    return sorted(edges, key=lambda k: (turned(k), k))


def _padded(rows: Sequence[Sequence[int]], count: int) -> NDArray[np.int64]:
    """Rows of edges (n, count), -1 where there is none."""
    out = np.full((len(rows), count), -1, dtype=np.int64)
    for row, own in zip(out, rows, strict=True):
        if len(own) > count:
            raise InputError(f"streets that leave a junction must be at most {count}, got {len(own)}")
        row[: len(own)] = own
    return out


def _edges(graph: StreetGraph, stations: EdgeStations) -> Records:
    onward: dict[int, list[int]] = {}
    for a, b in graph.turns:
        onward.setdefault(a, []).append(b)
    out = np.zeros(len(graph.edges), EDGE)
    out["first"], out["last"] = stations.first[:-1], stations.first[1:]
    options = [_sorted(graph, onward.get(k, []), _azimuth(edge, True)) for k, edge in enumerate(graph.edges)]
    out["options"] = _padded(options, MOST_STREETS)
    for k, edge in enumerate(graph.edges):
        row = out[k]
        row["length_m"], row["limit_mps"] = edge.length_m, edge.way.speed_limit_mps
        row["east_m"], row["north_m"] = edge.points_en_m[-1]
        row["azimuth_rad"], row["away_rad"] = _azimuth(edge, True), _azimuth(edge, False)
        for n, b in enumerate(options[k]):
            row["turn_s"][n] = turn_s(edge, graph.edges[b])
    return out


@lru_cache(maxsize=CITIES)
def city_hours(sky: str, errors: MapConfig, seed: int, hours: tuple[float, ...]) -> tuple[TownHour, ...]:
    """The generated city of a seed at hours of the day, for journeys; the last ones are kept."""
    town = generated_town(sky, errors, 0, seed)
    cut = JourneyTown.of(town, sky, named_generator(seed, "places"))
    return cut.hours(town.mapped, hours, kept=True)
