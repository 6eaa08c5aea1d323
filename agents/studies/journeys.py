"""Journeys chosen by the integrity that they will have (S2 sections 3 and 5.2), in cities that nothing was fitted on.

In each generated city of the test split, places are drawn at random, and the ways between them at one hour chosen by
length, by time, by time and expected time without a usable position, and by time with a bound on its share. The choice
is made by the map with its errors, the satellites and the speed limits. An oracle chooses as the third one does, by the
true city. Then the whole navigator drives every route under the true city; all routes of a pair of places have the
sensor noise of one vehicle, and random faults of their own. Intervals are by city.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, OnProgress, ignore
from lanebound.agents.report.pages import Table
from lanebound.agents.studies.route_drives import (
    PACKAGES,
    RouteDrivesConfig,
    drive_legs,
    navigator_config,
    town_of,
)
from lanebound.agents.studies.study import Shown, claim, parts_of, stored
from lanebound.integrity.assessment.plotting import INK, PL_COLOUR, legend, new_figure, save, tidy
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.motion.routes import Leg
from lanebound.integrity.sky.availability import packaged_model
from lanebound.integrity.sky.journeys.planner import MOST_UNUSABLE, WEIGHT, Planner, Route, StreetsAhead, place_on
from lanebound.integrity.sky.journeys.streets import EdgeStations, SkyAlong
from lanebound.integrity.sky.maps.generated import map_seed
from lanebound.integrity.sky.track import SkyTrack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

CHOICES = "shortest", "fastest", "integrity-aware", "chance-constrained", "oracle"
LEAST_APART_M = 300.0  # of the places of a pair
GROUPS = 6  # of routes by predicted time without a position
RESAMPLES, CONFIDENCE = 2000, 0.95
MET = "time_s", "length_m", "unusable_s"


class JourneysConfig(RouteDrivesConfig):
    """Test cities, journeys in each, and what the choices weigh."""

    cities: int = Field(20, ge=1, le=100, description="test cities, the first ones; each has an hour of its own")
    pairs: int = Field(10, ge=1, le=1000, description="pairs of places in a city")
    weight: float = Field(WEIGHT, ge=0, le=1e6, description="seconds that a second without a usable position counts as")
    most_unusable: float = Field(
        MOST_UNUSABLE, ge=0, le=1, description="expected share without a position of the chance-constrained route [-]"
    )


def run_journeys(config: JourneysConfig, out: Path, jobs: int = 1, on_progress: OnProgress = ignore) -> dict[str, Any]:
    """Plan and drive the journeys of the missing cities; writes ``results.json`` and a figure, returns the results.

    Raises
    ------
    InputError
        ``out`` cannot be claimed: it holds other work, results of another version or foreign files.
    """
    claim(out, "journeys", config, PACKAGES)
    names = [str(k) for k in range(config.cities)]
    parts = parts_of(config, work_city, names, out, jobs, on_progress)
    cities = [parts[name] for name in names]
    result = {"config": config.to_dict(), **summary(config, cities)}
    save(calibration_figure(cities), out / "calibration.svg")
    return stored(result, out)


def work_city(config: JourneysConfig, name: str, advance: Advance = ignore) -> list[dict[str, Any]]:
    """Plan and drive the journeys of one city: a record of each pair of places."""
    number = int(name)
    town = town_of(config, map_seed("test", number))
    rng = named_generator([config.seed, number], "journeys")
    hour = 24.0 * float(rng.random())
    stations = EdgeStations.along(town.graph.edges)
    track = SkyTrack.from_config(navigator_config(config, hour).sky, 60.0)
    mapped, true = (
        StreetsAhead.of(town.graph, stations, packaged_model(), SkyAlong.of(stations, city).at(track.at(track.start_s)))
        for city in (town.mapped, town.true)
    )
    pairs = [_chosen(config, mapped, true, rng) for _ in range(config.pairs)]
    seeds = [int(seed) for seed in rng.integers(2**32, size=config.pairs + 1)]
    legs = [(pair, leg) for pair, routes in enumerate(pairs) for leg in dict.fromkeys(map(_leg, routes.values()))]
    driven = drive_legs(
        config, town, [leg for _, leg in legs], hour, [seeds[0], *(seeds[1 + pair] for pair, _ in legs)], advance
    )
    met = dict(zip(legs, driven, strict=True))
    return [
        {
            "hour": round(hour, 3),
            "routes": {
                choice: {
                    "edges": list(route.edges),
                    "planned_s": route.time_s,
                    "predicted_s": mapped.described_as(route).unusable_s,
                    **{key: float(getattr(met[pair, _leg(route)], key)) for key in MET},
                }
                for choice, route in routes.items()
            },
        }
        for pair, routes in enumerate(pairs)
    ]


def _leg(route: Route) -> Leg:
    return Leg(route.edges, route.begin, route.end)


def _chosen(
    config: JourneysConfig, mapped: StreetsAhead, true: StreetsAhead, rng: np.random.Generator
) -> dict[str, Route]:
    """The routes of a pair of places that is drawn at random."""
    graph = mapped.graph
    known = sorted(graph.connected)
    while True:
        ends = [graph.edges[int(k)].points_en_m.mean(0) for k in rng.choice(known, 2, replace=False)]
        if np.linalg.norm(ends[1] - ends[0]) < LEAST_APART_M:
            continue
        origin, destination = (place_on(graph, end) for end in ends)
        try:
            planner, oracle = (Planner(ahead, origin, destination) for ahead in (mapped, true))
        except InputError:  # no way: turns that are forbidden on both sides
            continue
        return {
            "shortest": planner.shortest(),
            "fastest": planner.fastest(),
            "integrity-aware": planner.weighted(config.weight),
            "chance-constrained": planner.bounded(config.most_unusable),
            "oracle": oracle.weighted(config.weight),
        }


def summary(config: JourneysConfig, cities: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Means by choice, differences to the shortest route, share of the oracle's gain, and calibration."""
    met = np.array([[[[p["routes"][c][m] for m in MET] for c in CHOICES] for p in city] for city in cities])
    cost = met[..., 0] + config.weight * met[..., 2]
    lost = met[..., 2]
    choices = []
    for k, choice in enumerate(CHOICES):
        row: dict[str, Any] = {"choice": choice} | dict(zip(MET, met[:, :, k].mean((0, 1)).tolist(), strict=True))
        row["same"] = float(
            np.mean([p["routes"][choice]["edges"] == p["routes"]["shortest"]["edges"] for city in cities for p in city])
        )
        for name, other in (("less", 0), ("less_fastest", 1)):
            less = (met[:, :, k] - met[:, :, other]).mean(1)
            row[name] = {m: interval(less[:, j], np.mean) for j, m in enumerate(MET)}
        for name, what in (("gain_cost", cost), ("gain_unusable", lost)):
            pairs = np.stack([what[:, :, 0] - what[:, :, k], what[:, :, 0] - what[:, :, -1]], -1).mean(1)
            row[name] = interval(pairs, lambda rows: rows[:, 0].mean() / rows[:, 1].mean())
        choices.append(row)
    said, was = _routes(cities)
    return {
        "cities": len(cities),
        "journeys": int(met.shape[0] * met.shape[1]),
        "weight": config.weight,
        "choices": choices,
        "calibration": _groups(said, was),
        "correlation": float(np.corrcoef(said, was)[0, 1]) if said.size > 1 else None,
    }


def interval(rows: Array, of: Callable[[Array], Any]) -> list[float]:
    """A figure of rows by city, and its interval of 95 % by resampled cities."""
    drawn = named_generator(0, "resamples").integers(len(rows), size=(RESAMPLES, len(rows)))
    with np.errstate(divide="ignore", invalid="ignore"):
        again = np.array([of(rows[one]) for one in drawn])
        tail = 0.5 * (1.0 - CONFIDENCE)
        return [float(of(rows)), *np.nanquantile(again, [tail, 1.0 - tail]).tolist()]


def _routes(cities: Sequence[Sequence[Mapping[str, Any]]]) -> tuple[Array, Array]:
    """Predicted and met time without a position of all distinct routes [s]."""
    rows = []
    for city in cities:
        for pair in city:
            found = {tuple(r["edges"]): (r["predicted_s"], r["unusable_s"]) for r in pair["routes"].values()}
            rows += list(found.values())
    said, was = np.array(rows).T
    return said, was


def _groups(said: Array, was: Array) -> list[dict[str, float]]:
    """Means of routes in groups of equal size by predicted time."""
    return [
        {"predicted_s": float(said[own].mean()), "unusable_s": float(was[own].mean()), "routes": int(own.size)}
        for own in np.array_split(np.argsort(said, kind="stable"), GROUPS)
        if own.size
    ]


def calibration_figure(cities: Sequence[Sequence[Mapping[str, Any]]]) -> Figure:
    """Predicted and met time without a position, by route and by group."""
    said, was = _routes(cities)
    groups = _groups(said, was)
    figure = new_figure(4.6, 4.0)
    axes = figure.subplots()
    top = float(max(said.max(), was.max()))
    axes.plot([0.0, top], [0.0, top], "--", color=INK, lw=0.8, label="calibrated")
    axes.plot(said, was, ".", color="#999999", ms=3, label="routes")
    axes.plot(
        [g["predicted_s"] for g in groups], [g["unusable_s"] for g in groups], "o-", color=PL_COLOUR, label="groups"
    )
    tidy(axes, xlabel="predicted time without a position [s]", ylabel="met [s]")
    legend(axes)
    return figure


def shown(result: Mapping[str, Any]) -> Iterator[Shown]:
    """All tables."""
    yield f"{result['journeys']} journeys in {result['cities']} test cities; intervals of 95 % by city", choices(result)
    yield "Share of the oracle's gain on the shortest route", gains(result)
    yield (
        f"Predicted and met time without a position by route; correlation {result['correlation'] or 0.0:.2f}",
        (
            ("predicted s", "met s", "routes"),
            [(f"{g['predicted_s']:.1f}", f"{g['unusable_s']:.1f}", str(g["routes"])) for g in result["calibration"]],
        ),
    )


def choices(result: Mapping[str, Any]) -> Table:
    """What is met on the routes of each choice, and the differences to the shortest and the fastest ones."""
    heads = (
        "route", "time s", "length m", "unusable s", "as shortest", "unusable less shortest s", "time less shortest s",
        "unusable less fastest s", "time less fastest s",
    )  # fmt: skip
    return heads, [
        (
            row["choice"], f"{row['time_s']:.0f}", f"{row['length_m']:.0f}", f"{row['unusable_s']:.1f}",
            f"{100.0 * row['same']:.0f} %",
            *(stated(row[name][m], 1.0, "") for name in ("less", "less_fastest") for m in ("unusable_s", "time_s")),
        )
        for row in result["choices"]
    ]  # fmt: skip


def gains(result: Mapping[str, Any]) -> Table:
    """Shares of the oracle's gain on the shortest route."""
    heads = ("route", f"of time + {result['weight']:g} x unusable time", "of unusable time")
    rows = [row for row in result["choices"] if row["choice"] not in ("shortest", "oracle")]
    return heads, [
        (row["choice"], *(stated(row[g], 100.0, " %") for g in ("gain_cost", "gain_unusable"))) for row in rows
    ]


def stated(interval: Sequence[float], factor: float, unit: str) -> str:
    middle, low, high = (factor * value for value in interval)
    digits, sign = (0, "") if unit else (1, "+")
    return f"{middle:{sign}.{digits}f} ({low:{sign}.{digits}f} .. {high:{sign}.{digits}f}){unit}"
