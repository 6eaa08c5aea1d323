"""Journeys under the whole navigator: the streets chosen are driven, and its solutions are what is met."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.journeys.course_kernel import class_of
from lanebound.envs.journeys.town import JourneyTown, TownHour, navigator_at
from lanebound.integrity.core.records import Records
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.motion.drive import DriveConfig
from lanebound.integrity.motion.routes import STATION_M, Leg, RouteMotion
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.campaign import FaultPriors, random_campaign
from lanebound.integrity.sensors.faults import FaultSchedule
from lanebound.integrity.sky.availability import NO_LEVEL_M
from lanebound.integrity.sky.journeys.planner import GAPS_S
from lanebound.integrity.sky.journeys.streets import AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG, EdgeStations
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["FullDrive"]

Array = NDArray[np.float64]

FAULTS = "sensors/fault_priors_nominal"
WARM_UP_S = 20.0  # standing before the departure, as of the drives that the law of the fast mode is fitted on
LOOK_M = 20.0  # before the end of a street its course depends on the next one: arcs of corners begin 17 m before
LAST_S = 120.0  # after ``duration_s``, to come to the next junction; a journey that would take longer is cut there
CLASSES_S = np.array(GAPS_S)
SKIES = 16  # that are kept beside those of journeys under way, of about 44 MB

_in_use: WeakValueDictionary[JourneyTown, SkyMask] = WeakValueDictionary()


@lru_cache(maxsize=SKIES)
def _sky_of(town: JourneyTown) -> tuple[EdgeStations, SkyMask]:
    """Stations of all streets, and the true sky there; one that a journey holds is not made again."""
    stations, mask = EdgeStations.along(town.graph.edges, STATION_M), _in_use.get(town)
    if mask is None:
        steps = AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG
        mask = _in_use[town] = SkyMask.of_stations(stations.antenna_enu_m, town.true, STATION_M, *steps)
    return stations, mask


class FullDrive:
    """One vehicle on its journey.

    It drives as far as its course does not depend on the next street: until it would have to brake for the end of the
    last one. There the next street is asked for.

    Parameters
    ----------
    at : city and hour
    seed : of instruments and faults
    duration_s : longest journey
    car : (1,) CAR
    """

    def __init__(self, at: TownHour, seed: int, duration_s: float, car: Records) -> None:
        self.at, self._config = at, DriveConfig()
        base = navigator_at(at.town.sky, NavigatorConfig(), at.hour)
        self.dt_s, self._wait = base.dt_s, round(WARM_UP_S / base.dt_s)
        stations, self._mask = _sky_of(at.town)
        self._stations = replace(stations, speed_mps=stations.speed_mps.copy())
        most_s = WARM_UP_S + duration_s + LAST_S
        track = SkyTrack.from_config(base.sky, most_s)
        rng = named_generator(seed, "faults")
        first = track.at(track.start_s, np.zeros(1, np.int64))
        faults = FaultSchedule(random_campaign(FaultPriors.preset(FAULTS), most_s, rng, first))
        self._navigator = Navigator(base, track, self._mask, [seed], faults=faults)
        self._car, self._most = car[0], round((duration_s + LAST_S) / self.dt_s) - 1  # epochs, before the track ends
        self._edges: list[int] = []
        self._paces: list[float] = []
        self._epoch, self._entered, self._warm = 0, 0, False

    def drive(self, edges: list[int], pace: float, ends: bool, journey: Records) -> bool:
        """Drive on along more edges at a share of the speed limit, and write what is met into a journey (1,).

        An edge that is driven again keeps its first pace.  -> false where the time ended on the way.
        """
        graph, drive, dt_s = self.at.town.graph, self._config, self.dt_s
        for k in edges:
            if k not in self._edges:
                self._stations.speed_mps[self._stations.of(k)] *= pace
        self._edges += edges
        self._paces += [pace] * len(edges)
        own = [np.arange(s.start, s.stop) for s in map(self._stations.of, self._edges)]
        leg = Leg(tuple(self._edges), 0.0, 1.0)
        streets = [graph.edges[k] for k in self._edges]
        way = RouteMotion.of(streets, leg, self._stations, np.concatenate(own), drive, dt_s)
        moved = np.linalg.norm(np.diff(way.place_en_m, axis=0), axis=1)
        left = np.concatenate([np.cumsum(moved[::-1])[::-1], [0.0]])
        braking = np.maximum(0.5 * way.speed_mps**2 / drive.braking_mps2 + way.speed_mps * dt_s, LOOK_M)
        last = left.size - 1 if ends else max(int(np.argmax(left <= braking)), self._epoch)
        if not self._warm:
            for k in range(self._wait):
                self._step(way, 0, 0, k)
            self._warm = True
        stop = min(last, self._most)
        for k in range(self._epoch, stop):
            while self._entered < len(self._edges) and way.arc_m[k + 1] > way.starts_m[self._entered]:
                self._enter(journey[0])
            solution = self._step(way, k, k + 1, self._wait + k)
            self._meet(solution, journey[0])
        self._epoch = stop
        return stop == last

    def _enter(self, journey: Any) -> None:
        """Add the next edge to a journey, as :func:`~.course_kernel.drive_rows` does where it enters one."""
        n, town = self._entered, self.at.town
        k, turn_s = self._edges[n], 0.0
        if n > 0:
            before = town.edges[self._edges[n - 1]]
            turn_s = float(before["turn_s"][np.flatnonzero(before["options"] == k)[0]])
        edge, into = town.edges[k], self.at.mapped.ahead[k, class_of(float(journey["gap_s"]), CLASSES_S)]
        journey["predicted_s"] += into["lost_s"] + turn_s * into["risk"]
        journey["length_m"] += edge["length_m"]
        speed = self._paces[n] * edge["limit_mps"]
        journey["energy_kwh"] += edge["length_m"] * (self._car["rolling"] + self._car["drag"] * speed**2)
        self._entered += 1

    def _step(self, way: RouteMotion, a: int, b: int, epoch: int) -> Any:
        """Take the navigator from one epoch of the way to another."""

        def at(k: int) -> tuple[Array, Array, Array]:
            heading = way.heading_rad[k : k + 1]
            velocity = way.speed_mps[k] * np.stack([np.sin(heading), np.cos(heading)], -1)
            return way.place_en_m[k : k + 1], velocity, heading

        place, velocity, heading = zip(at(a), at(b), strict=True)
        arc, lane = STATION_M * way.row[b : b + 1].astype(np.float64), np.zeros(1, dtype=np.int64)
        truth = Truth.between(self.dt_s * (epoch + 1), self.dt_s, place, velocity, heading, arc, lane)
        return self._navigator.step(truth)

    def _meet(self, solution: Any, journey: Any) -> None:
        """Add an epoch to a journey."""
        usable = bool(solution.available[0]) and not bool(solution.alert[0])
        rtk = bool(solution.mode[0] == Mode.RTK)
        journey["rtk"], journey["usable"] = rtk, usable
        journey["level_m"] = min(float(solution.pl_ct_m[0]), NO_LEVEL_M)
        journey["gap_s"] = 0.0 if rtk else journey["gap_s"] + self.dt_s
        journey["time_s"] += self.dt_s
        journey["unusable_s"] += 0.0 if usable else self.dt_s
