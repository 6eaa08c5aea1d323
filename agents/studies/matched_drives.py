"""Drives through street maps on which all scores of map matching are computed point by point.

Drives follow random routes through street maps of OpenStreetMap, under the buildings of the map or under an open sky.
A receiver has code positions of its first band, some drives have faults, and the map of the vehicle has errors. One
topological matcher matches all points; every method scores the same matches. A point is wrong if the matched link is
not that of the drive, or the matched point farther away than the alert limit. Points in motion with a position count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.agents.studies.context_drive import navigator_config
from lanebound.agents.studies.route_drives import truths_of
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.assessment.warning_rates import sweep_thresholds
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.context.code_fix import code_fix
from lanebound.integrity.monitoring.context.link_scores import ScoreKind, make_score
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor, ContextVerdict, match_inputs
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import STATION_M, Leg, RouteMotion
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.positioning.map_matching.map_errors import MapErrorsConfig, with_errors
from lanebound.integrity.positioning.map_matching.road_map import RoadMap
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sensors.gnss import GnssConfig
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.journeys.streets import AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG, EdgeStations, at_hour
from lanebound.integrity.sky.maps.city import city_of
from lanebound.integrity.sky.maps.generated import named_map
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.records import MapFrame
from lanebound.integrity.sky.scene import City, clad
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

THRESHOLDS = np.arange(0.0, 100.5, 0.25)
ALONE, PUBLISHED = "alone", "published"  # the score by itself, and after the phases that its authors have before it
PROBABILITY = "probability"  # of the link, by the emissions of the matcher: what a score has to add to
SCORES = (*(str(kind) for kind in ScoreKind), PROBABILITY)
BEFORE: dict[str, tuple[str, ...]] = {"context": ("position", "speed"), "velaga": ("position",)}
OPEN = "open"


class MapMatchingConfig(Config):
    """Maps, drives, and what vehicles have."""

    maps: tuple[str, ...] = Field(min_length=2, description="packaged maps, files, or generated:SEED")
    skies: tuple[str, ...] = Field(
        (OPEN, "urban"), min_length=1, description="levels that give instruments; all but open with the map's buildings"
    )
    drives: int = Field(40, ge=2, description="on each map under each sky [-]")
    length_m: float = Field(4000.0, ge=500, le=50_000, description="of a route at least [m]")
    seed: int = Field(401, ge=0, description="of routes, hours, instruments, maps and faults")
    faults: str = Field("sensors/fault_priors_stress", description="preset of fault rates")
    fault_share: float = Field(0.5, ge=0, le=1, description="of the drives have faults [-]")
    equal_far: float = Field(0.05, gt=0, lt=1, description="share of right points warned of, of the rule equal [-]")
    warm_up_s: float = Field(20.0, ge=0, description="standing before a drive [s]")
    node_m: float = Field(10.0, ge=0, description="from a node, within which both links of the route are right [m]")
    map_errors: MapErrorsConfig = Field(
        MapErrorsConfig(shift_m=3.0, missing=0.02, wrong_topology=0.02),
        description="errors of the map of each vehicle; chosen, as of the study of S5's monitor",
    )
    monitor: ContextConfig = Field(default_factory=ContextConfig, description="S5's; its matcher is that of all")
    gnss: GnssConfig = Field(
        default_factory=lambda: GnssConfig.preset("sensors/gnss_automotive"), description="receiver; its first band"
    )
    drive: DriveConfig = Field(DriveConfig(), description="accelerations; the speed limits are those of the streets")

    @model_validator(mode="after")
    def _maps_differ_and_the_monitor_is_s5s(self) -> Self:
        if len({Path(name).resolve() for name in self.maps}) < len(self.maps):
            raise ConfigError(
                f"maps must differ, got {', '.join(self.maps)}: thresholds are fitted on other maps; name each map once"
            )
        if self.monitor.map.score is not ScoreKind.CONTEXT:
            raise ConfigError(
                f"monitor.map.score must be context, got {self.monitor.map.score}: all are scored; leave it out"
            )
        return self


class DrivenStreets(NamedTuple):
    """A map as it is: streets, their links for matching, and stations of the sky along the streets that can be driven.

    known : edges from each of which each can be reached, without those below a roof
    """

    frame: MapFrame
    graph: StreetGraph
    links: RoadMap
    known: tuple[int, ...]
    stations: EdgeStations


@lru_cache(maxsize=8)
def streets_of(name: str) -> DrivenStreets:
    """The streets of a map.

    Raises
    ------
    InputError
        No street leads back to itself.
    """
    streets = named_map(name)
    graph = StreetGraph.of(streets)
    known = tuple(sorted(k for k in graph.connected if not graph.edges[k].way.covered))
    if len(known) < 2:
        raise InputError(f"map {name} must have streets that lead back to themselves, got none: cut a larger part")
    stations = EdgeStations.along([graph.edges[k] for k in known], STATION_M)
    return DrivenStreets(streets.frame, graph, links_of(graph), known, stations)


def links_of(graph: StreetGraph) -> RoadMap:
    """All edges of a street graph as links, named by their numbers."""
    number = {node: k for k, node in enumerate(graph.junctions)}
    place: dict[int, Array] = {}
    for edge in graph.edges:
        place[edge.start], place[edge.end] = edge.points_en_m[0], edge.points_en_m[-1]
    return RoadMap.of_lines(
        np.array([place[node] for node in graph.junctions]),
        [(number[edge.start], number[edge.end]) for edge in graph.edges],
        [edge.points_en_m for edge in graph.edges],
        limit_mps=[edge.way.speed_limit_mps for edge in graph.edges],
    )


@lru_cache(maxsize=8)
def _mask(name: str, sky: str) -> SkyMask:
    """What the buildings of a map leave of the sky at its stations; an open sky has none."""
    city = City.empty()
    if sky != OPEN:
        city = city_of(named_map(name))
        shares = SkyLevel.named(sky).material_shares
        city = replace(city, material=clad(city.building, shares, named_generator(0, "facades")))
    return SkyMask.of_stations(
        streets_of(name).stations.antenna_enu_m, city, STATION_M, AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG
    )


def wandering(streets: DrivenStreets, length_m: float, rng: np.random.Generator) -> list[int]:
    """A route: from edge to edge by allowed turns, to those that were driven least, until it is long enough."""
    edges, onward = streets.graph.edges, dict[int, list[int]]()
    known = set(streets.known)
    for before, after in streets.graph.turns:
        if after in known:
            onward.setdefault(before, []).append(after)
    out, driven = [int(rng.choice(streets.known))], dict[int, int]()
    total = edges[out[0]].length_m
    while total < length_m and out[-1] in onward:
        choices = onward[out[-1]]
        cost = np.array([driven.get(k, 0) for k in choices]) + 0.5 * rng.random(len(choices))
        out.append(choices[int(np.argmin(cost))])
        driven[out[-1]] = driven.get(out[-1], 0) + 1
        total += edges[out[-1]].length_m
    return out


class ScoredPoints(NamedTuple):
    """Points of one drive (T,): which are wrong, what the first two phases passed, and all scores by name."""

    wrong_link: Bools
    beyond: Bools
    passed: dict[str, Bools]
    scores: dict[str, Array]

    @property
    def wrong(self) -> Bools:
        """A wrong link, or a matched point beyond the alert limit."""
        return self.wrong_link | self.beyond


def work_drive(config: MapMatchingConfig, name: str, advance: Advance = ignore) -> dict[str, Any]:
    """Drive once and sweep the thresholds of all scores; a drive depends on no other."""
    which, sky, number = (int(text) for text in name.split("-"))
    faulty = int((number + 1) * config.fault_share) > int(number * config.fault_share)
    found = judged_drive(
        config, config.maps[which], config.skies[sky], [config.seed, which, sky, number], faulty, advance
    )
    return {
        "map": config.maps[which], "sky": config.skies[sky], "faulty": faulty,
        "points": found.wrong.size, "wrong": int(found.wrong.sum()), "wrong_link": int(found.wrong_link.sum()),
        "beyond": int(found.beyond.sum()),
        "sweeps": {
            score: {
                chain: _swept(np.where(_all_passed(found, before), values, -1.0), found.wrong)
                for chain, before in ((ALONE, ()), (PUBLISHED, BEFORE.get(score, ())))
            }
            for score, values in found.scores.items()
        },
    }  # fmt: skip


def _all_passed(found: ScoredPoints, phases: Sequence[str]) -> Bools:
    return np.all([found.passed[phase] for phase in phases], 0) if phases else np.ones(found.wrong.size, np.bool_)


def _swept(score: Array, wrong: Bools) -> list[list[int]]:
    sweep = sweep_thresholds(score, wrong, THRESHOLDS)
    return [sweep.false_alarms.tolist(), sweep.missed.tolist()]


def judged_drive(
    config: MapMatchingConfig, name: str, sky: str, seeds: list[int], faulty: bool, advance: Advance = ignore
) -> ScoredPoints:
    """One drive through a map under a sky: its points in motion with a position."""
    streets, monitor, rng = streets_of(name), config.monitor, named_generator(seeds, "journeys")
    route = wandering(streets, config.length_m, rng)
    hour, own, campaign = 24.0 * float(rng.random()), int(rng.integers(2**32)), int(rng.integers(2**32))
    at = {k: streets.stations.of(i) for i, k in enumerate(streets.known)}
    rows = np.concatenate([np.arange(at[k].start, at[k].stop) for k in route])
    edges = [streets.graph.edges[k] for k in route]
    way = RouteMotion.of(edges, Leg(tuple(route), 0.0, 1.0), streets.stations, rows, config.drive, 1.0)
    place = SkyConfig().replace(lat_deg=streets.frame.lat_deg, lon_deg=streets.frame.lon_deg)
    base = SkyLevel.named(sky).navigator(navigator_config(config.gnss, at_hour(place, hour)))
    wait = round(config.warm_up_s)
    epochs = wait + way.speed_mps.size - 1
    track = SkyTrack.from_config(base.sky, epochs + 60.0)
    faults = FaultSchedule(
        random_campaign(
            FaultPriors.preset(config.faults), float(epochs), named_generator(campaign, "faults"),
            track.at(track.start_s, np.zeros(1, np.int64)),
        ) if faulty else ()
    )  # fmt: skip
    navigator = Navigator(base, track, _mask(name, sky), [own], faults=faults)
    matched = with_errors(streets.links, config.map_errors, named_generator(seeds, "map"))
    watch, points = ContextMonitor(monitor, matched, 1, 1.0), _Points()
    scores = {
        str(kind): score
        for kind in ScoreKind
        if (score := make_score(kind, matched, monitor.matching, monitor.map.map_sigma_m, monitor.map.intervals, 1))
    }
    for k, truth in enumerate(truths_of([way], wait, epochs, 1.0)):
        m = navigator.measure(truth)
        fix = code_fix(m, monitor.codes)
        verdict = watch.step(fix, m.odometer.speed_mps)
        inputs = match_inputs(fix, verdict.speed, 1.0)
        said = {score: float(of.step(verdict.match, inputs)[0]) for score, of in scores.items()}
        if k >= wait and fix.located[0] and not verdict.speed.at_rest[0]:
            arc = float(way.arc_m[k - wait + 1])
            right = _on_route(route, way.starts_m, int(verdict.link[0]), arc, config.node_m)
            off = float(np.linalg.norm(verdict.match.foot_en_m[0] - truth.position_enu_m[0, :2]))
            points.add(not right, off > monitor.position.alert_limit_m, verdict, said)
        advance((k + 1) / epochs)
    return points.done()


def _on_route(route: Sequence[int], starts_m: Array, link: int, arc_m: float, node_m: float) -> bool:
    """Whether a link is one of the route within ``node_m`` of a place along it."""
    here = (starts_m[:-1] - node_m <= arc_m) & (arc_m <= starts_m[1:] + node_m)
    return bool((here & (np.array(route) == link)).any())


class _Points:
    """Rows of :class:`ScoredPoints` as they come."""

    def __init__(self) -> None:
        self._rows: list[tuple[bool, bool, bool, bool]] = []
        self._scores: list[dict[str, float]] = []

    def add(self, wrong_link: bool, beyond: bool, v: ContextVerdict, said: Mapping[str, float]) -> None:
        """One point and what all methods say of it."""
        self._rows.append((wrong_link, beyond, bool(v.position.passed[0]), bool(v.speed.passed[0])))
        own = {"context": float(v.score[0]), PROBABILITY: 100.0 * float(v.match.probability[0])}
        self._scores.append({**own, **said})

    def done(self) -> ScoredPoints:
        """All points."""
        wrong, beyond, position, speed = np.array(self._rows, np.bool_).reshape(-1, 4).T
        scores = {name: np.array([row[name] for row in self._scores]) for name in SCORES}
        return ScoredPoints(wrong, beyond, {"position": position, "speed": speed}, scores)
