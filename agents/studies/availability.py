"""The packaged model of availability and the law of realised courses, fitted on drives through training cities.

The drives are of the whole navigator, in generated cities. Each city is predicted from its map at one hour. Vehicles
drive the shortest ways between places drawn at random; what they meet each second, with what was predicted at the
nearest station, are the samples of the fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.studies.route_drives import (
    PACKAGES,
    Driven,
    RouteDrivesConfig,
    drive_legs,
    navigator_config,
    town_of,
)
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.motion.routes import Leg
from lanebound.integrity.sky.availability import WORST_PDOP, AvailabilityModel, Fit, gaps_along, likely
from lanebound.integrity.sky.journeys.realised import DrivenWay, RealisedLaw
from lanebound.integrity.sky.journeys.streets import EdgeStations, SkyAlong
from lanebound.integrity.sky.maps.generated import map_seed
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.prediction import StreetPrediction
from lanebound.integrity.sky.track import SkyTrack

Array = NDArray[np.float64]

SAMPLE_S = 1.0
LEAST_EDGES = 4  # of a way
SHARES = tuple((k + 0.5) / 10.0 for k in range(10))  # of the quantiles of levels: ten equal parts


class AvailabilityConfig(RouteDrivesConfig):
    """Training cities and the vehicles in each."""

    cities: int = Field(10, ge=1, le=1000, description="training cities, the first ones")
    more: int = Field(20, ge=0, le=1000, description="further ones, for the law of realised courses alone")
    vehicles: int = Field(20, ge=1, le=4096, description="vehicles in a city, a way each")


def run_availability(
    config: AvailabilityConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore
) -> dict[str, Any]:
    """Drive the missing cities, and write the model as ``availability.json``; returns it.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "availability", config, PACKAGES)
    names = [str(k) for k in range(config.cities + config.more)]
    parts = parts_of(config, work_city, names, out, jobs, on_progress)
    every = [way for name in names for way in parts[name]]
    ways = [way for name in names[: config.cities] for way in parts[name]]
    model = fitted(ways)
    said = np.concatenate([_probability(model, way) for way in ways])
    was = np.concatenate([way["usable"] for way in ways])
    result = {
        "model": model.to_dict(),
        "realised": RealisedLaw.fitted([driven_way(way) for way in every]).to_dict(),
        "realised_cities": len(names),
        "cities": config.cities,
        "ways": len(ways),
        "samples": int(was.size),
        "usable": float(was.mean()),
        "skill": float(1.0 - ((said - was) ** 2).mean() / was.var()),
    }
    return stored(result, out, "availability.json")


def work_city(config: AvailabilityConfig, name: str, advance: Advance = ignore) -> list[dict[str, Any]]:
    """Predict and drive one city: a record of each way."""
    number = int(name)
    town = town_of(config, map_seed("train", number))
    rng = named_generator([config.seed, number], "ways")
    hour = 24.0 * float(rng.random())
    known = sorted(town.graph.connected)
    legs: list[Leg] = []
    while len(legs) < config.vehicles:
        first, last = rng.choice(known, 2, replace=False)
        way = town.graph.way(int(first), int(last))
        if way is not None and len(way) >= LEAST_EDGES:
            legs.append(Leg(tuple(way), 0.0, 1.0))
    stations = EdgeStations.along(town.graph.edges)
    sky = navigator_config(config, hour).sky
    track = SkyTrack.from_config(sky, 60.0)
    seen, true = (SkyAlong.of(stations, city).at(track.at(track.start_s)) for city in (town.mapped, town.true))
    seeds = [int(seed) for seed in rng.integers(2**32, size=config.vehicles + 1)]
    driven = drive_legs(config, town, legs, hour, seeds, advance)
    return [_record(leg, one, town.graph, stations, seen, true) for leg, one in zip(legs, driven, strict=True)]


def _record(
    leg: Leg, driven: Driven, graph: StreetGraph, stations: EdgeStations, seen: StreetPrediction, true: StreetPrediction
) -> dict[str, Any]:
    """What was predicted along a way, what its vehicle met each second, and what it met in passing each station."""
    rows, part_s = stations.of_way(graph, leg.edges)
    every = slice(None, None, max(1, round(SAMPLE_S / driven.dt_s)))
    passed = cKDTree(driven.place_en_m).query(stations.place_en_m[rows])[1]
    return {
        "satellites": seen.satellites[rows].tolist(),
        "pdop": np.round(np.minimum(seen.pdop[rows], WORST_PDOP), 3).tolist(),
        "part_s": np.round(part_s, 4).tolist(),
        "station": cKDTree(stations.place_en_m[rows]).query(driven.place_en_m[every])[1].tolist(),
        "rtk": driven.rtk[every].astype(int).tolist(),
        "usable": driven.usable[every].astype(int).tolist(),
        "true_satellites": true.satellites[rows].tolist(),
        "true_pdop": np.round(np.minimum(true.pdop[rows], WORST_PDOP), 3).tolist(),
        "passed": {
            "rtk": driven.rtk[passed].astype(int).tolist(),
            "usable": driven.usable[passed].astype(int).tolist(),
            "pl_ct_m": np.round(driven.pl_ct_m[passed], 4).tolist(),
        },
        "pl_ct_m": np.round(driven.pl_ct_m[every], 3).tolist(),
    }


def driven_way(way: Mapping[str, Any]) -> DrivenWay:
    """A drive at its stations."""
    passed = way["passed"]
    number, pdop, part_s, level = (
        np.asarray(of, float) for of in (way["true_satellites"], way["true_pdop"], way["part_s"], passed["pl_ct_m"])
    )
    return DrivenWay(number, pdop, part_s, np.array(passed["rtk"]) > 0, np.array(passed["usable"]) > 0, level)


def fitted(ways: list[dict[str, Any]]) -> AvailabilityModel:
    """The model of the samples of ways."""

    def all_of(name: str) -> Array:
        return np.concatenate([np.asarray(way[name], float) for way in ways])

    def at_samples(name: str) -> Array:
        return np.concatenate([np.asarray(way[name], float)[way["station"]] for way in ways])

    def gap_of(fix: Fit) -> Array:
        return np.concatenate([_gap(fix, way)[way["station"]] for way in ways])

    return AvailabilityModel.fitted(
        at_samples("satellites"), at_samples("pdop"), all_of("rtk") > 0.0, all_of("usable") > 0.0, all_of("pl_ct_m"),
        gap_of, SHARES,
    )  # fmt: skip


def _gap(fix: Fit, way: Mapping[str, Any]) -> Array:
    """Gaps at the stations of a way, from a known place."""
    good = likely(fix, np.asarray(way["satellites"], float), np.asarray(way["pdop"], float))
    part_s = np.asarray(way["part_s"], float)
    return gaps_along(good, np.cumsum(part_s) - 0.5 * part_s, 0.0)


def _probability(model: AvailabilityModel, way: Mapping[str, Any]) -> Array:
    """Probability of a usable position at the samples of a way."""
    station = way["station"]
    satellites = np.asarray(way["satellites"], float)
    return model.probability(satellites[station], _gap(model.fix, way)[station])


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """The table."""
    yield (
        "Model of availability, fitted on generated training cities",
        (
            ("cities", "ways", "samples", "usable", "skill on them"),
            [(
                str(result["cities"]), str(result["ways"]), f"{result['samples']:,}",
                f"{100.0 * result['usable']:.1f} %", f"{result['skill']:.2f}",
            )],
        ),
    )  # fmt: skip
