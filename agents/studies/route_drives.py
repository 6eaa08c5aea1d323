"""Drives of the whole navigator along routes through a map: where a position is usable, and the levels, each second.

The vehicles of a batch drive one route each through one city at one hour. They stand at the beginning, drive at the
speed limits of their streets within comfortable accelerations and without lights, and stop at the end. Their sky is
that of the nearest of stations along the streets of all routes, which are cast once each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.envs.journeys.town import Town, generated_town, navigator_at
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import STATION_M, Leg, RouteMotion
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sky.availability import NO_LEVEL_M
from lanebound.integrity.sky.journeys.streets import AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG, EdgeStations
from lanebound.integrity.sky.survey import MapConfig
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]

PACKAGES = ("lanebound.integrity", "lanebound.agents.studies", "lanebound.envs.journeys", "lanebound.envs.sky")
"""That results depend on."""


class RouteDrivesConfig(Config):
    """Cities, how they are mapped, and what vehicles are equipped with."""

    sky: str = Field("urban", description="level of sky that gives reference link, instruments and materials")
    faults: str | None = Field(
        "sensors/fault_priors_nominal", description="preset of fault rates; none: nothing but what the street does"
    )
    seed: int = Field(301, ge=0, description="of hours, places, maps, instruments and faults")
    cities: int = Field(20, ge=1, le=100, description="generated cities")
    warm_up_s: float = Field(20.0, ge=0, description="standing before a drive [s]")
    map: MapConfig = Field(MapConfig(), description="errors of the map of the prediction")
    navigator: NavigatorConfig = NavigatorConfig()
    drive: DriveConfig = Field(DriveConfig(), description="accelerations; the speed limits are those of the streets")


def town_of(config: RouteDrivesConfig, seed: int) -> Town:
    """The generated city of a seed; the map is a draw of its own."""
    return generated_town(config.sky, config.map, config.seed, seed)


def navigator_config(config: RouteDrivesConfig, hour: float) -> NavigatorConfig:
    """The navigator with the instruments of the sky, at an hour of the day."""
    return navigator_at(config.sky, config.navigator, hour)


class Driven(NamedTuple):
    """What one vehicle met, by epochs of its drive (K,).

    Attributes
    ----------
    dt_s, length_m : of an epoch; of the way
    place_en_m : (K, 2) true
    rtk, usable, pl_ct_m : solution
    """

    dt_s: float
    length_m: float
    place_en_m: Array
    rtk: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    pl_ct_m: Array

    @property
    def time_s(self) -> float:
        """Time of the drive."""
        return self.dt_s * self.usable.size

    @property
    def unusable_s(self) -> float:
        """Time without a usable position."""
        return self.dt_s * float((~self.usable).sum())


def drive_legs(
    config: RouteDrivesConfig, town: Town, legs: Sequence[Leg], hour: float, seeds: Sequence[int],
    advance: Advance = ignore,
) -> list[Driven]:  # fmt: skip
    """Drive legs under the true city at an hour, a vehicle each.

    Parameters
    ----------
    seeds : one for the campaign of faults of all vehicles, and one for each vehicle
    """
    base = navigator_config(config, hour)
    edges = town.graph.edges
    used = sorted({k for leg in legs for k in leg.edges})
    stations = EdgeStations.along([edges[k] for k in used], STATION_M)
    mask = SkyMask.of_stations(stations.antenna_enu_m, town.true, STATION_M, AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG)
    ways = []
    for leg in legs:
        own = [stations.of(used.index(k)) for k in leg.edges]
        rows = np.concatenate([np.arange(one.start, one.stop) for one in own])
        ways.append(RouteMotion.of([edges[k] for k in leg.edges], leg, stations, rows, config.drive, base.dt_s))
    wait = round(config.warm_up_s / base.dt_s)
    epochs = wait + max(way.speed_mps.size for way in ways) - 1
    track = SkyTrack.from_config(base.sky, epochs * base.dt_s + 60.0)
    faults: Any = None
    if config.faults is not None:
        view = track.at(track.start_s, np.zeros(len(legs), dtype=np.int64))
        rng = named_generator(seeds[0], "faults")
        faults = FaultSchedule(random_campaign(FaultPriors.preset(config.faults), epochs * base.dt_s, rng, view))
    navigator = Navigator(base, track, mask, list(seeds[1:]), faults=faults)
    met: list[list[tuple[bool, bool, float]]] = [[] for _ in legs]
    for k, truth in enumerate(truths_of(ways, wait, epochs, base.dt_s)):
        solution = navigator.step(truth)
        usable, rtk = solution.available & ~solution.alert, solution.mode == Mode.RTK
        for b, way in enumerate(ways):
            if wait <= k < wait + way.speed_mps.size - 1:
                met[b].append((bool(rtk[b]), bool(usable[b]), min(float(solution.pl_ct_m[b]), NO_LEVEL_M)))
        advance((k + 1) / epochs)
    out = []
    for way, rows_met in zip(ways, met, strict=True):
        rtk, usable, level = (np.array(column) for column in zip(*rows_met, strict=True))
        out.append(Driven(base.dt_s, way.length_m, way.place_en_m[1:], rtk, usable, level))
    return out


def truths_of(ways: Sequence[RouteMotion], wait: int, epochs: int, dt_s: float) -> Iterator[Truth]:
    """The truths of all vehicles, which stand before and after their drives."""

    def at(k: int) -> tuple[Array, Array, Array, Array]:
        which = [min(max(k - wait, 0), way.speed_mps.size - 1) for way in ways]
        pairs = list(zip(ways, which, strict=True))
        place = np.array([way.place_en_m[i] for way, i in pairs])
        heading = np.array([way.heading_rad[i] for way, i in pairs])
        speed = np.array([way.speed_mps[i] for way, i in pairs])
        velocity = speed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
        return place, velocity, heading, STATION_M * np.array([way.row[i] for way, i in pairs], dtype=np.float64)

    lane = np.zeros(len(ways), dtype=np.int64)
    for k, (a, b) in enumerate(pairwise(map(at, range(epochs + 1)))):
        yield Truth.between(dt_s * (k + 1), dt_s, (a[0], b[0]), (a[1], b[1]), (a[2], b[2]), b[3], lane)
