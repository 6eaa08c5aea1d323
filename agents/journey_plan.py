"""A journey through a street map: the routes to choose from, the best hour of the day, and a picture of both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.plotting import legend, new_figure, save, tidy
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.availability import NO_LEVEL_M, packaged_model
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.journeys.planner import (
    MOST_UNUSABLE,
    WEIGHT,
    Planner,
    Route,
    StreetsAhead,
    place_on,
)
from lanebound.integrity.sky.journeys.streets import EdgeStations, SkyAlong, at_hour
from lanebound.integrity.sky.maps.city import city_of
from lanebound.integrity.sky.maps.generated import GENERATED, named_map
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.lines import arcs_of, part_of
from lanebound.integrity.sky.maps.records import StreetMap
from lanebound.integrity.sky.track import SkyTrack

__all__ = ["PlannedJourney", "draw_journey", "plan_journey"]

Array = NDArray[np.float64]
Degrees = tuple[float, float]

MARGIN_M = 400.0  # about both places, beside half of their distance: streets farther away are no choice
HOURS = range(24)
HIGH_M = 40.0  # from which on all buildings have one colour
COLOURS = {"shortest": "#000000", "fastest": "#0072B2", "integrity-aware": "#D55E00", "chance-constrained": "#CC79A7"}


@dataclass(frozen=True)
class PlannedJourney:
    """What is planned.

    Attributes
    ----------
    streets, ahead : the map near the journey, and what is predicted of its streets
    routes : by name
    by_hour : the integrity-aware route at each hour of the day
    weight : of a second without a usable position in it
    """

    streets: StreetMap
    ahead: StreetsAhead
    origin_en_m: Array
    destination_en_m: Array
    hour: float
    routes: dict[str, Route]
    by_hour: dict[int, Route]
    weight: float

    @property
    def best_hour(self) -> int:
        """The hour at which the integrity-aware route has the least sum of time and weighted unusable time."""
        return min(self.by_hour, key=lambda h: (self.by_hour[h].time_s + self.weight * self.by_hour[h].unusable_s, h))

    def to_dict(self) -> dict[str, Any]:
        """The journey as plain data; routes as latitudes and longitudes of the points of their streets."""
        return {
            "hour": self.hour,
            "routes": {name: self._plain(route) for name, route in self.routes.items()},
            "best_hour": self.best_hour,
            "by_hour": [
                {"hour": hour, "time_s": r.time_s, "unusable_s": r.unusable_s} for hour, r in self.by_hour.items()
            ],
        }

    def _plain(self, route: Route) -> dict[str, Any]:
        def finite(level_m: float) -> float | None:
            return level_m if level_m < NO_LEVEL_M else None

        line = np.concatenate([self.ahead.graph.edges[k].points_en_m for k in route.edges])
        return {
            "length_m": route.length_m,
            "time_s": route.time_s,
            "unusable_s": route.unusable_s,
            "unusable_share": route.unusable_share,
            "level_median_m": finite(route.level_m[0]),
            "level_90_m": finite(route.level_m[1]),
            "energy_kwh": route.energy_kwh,
            "lat_lon_deg": np.round(self.streets.frame.lat_lon_of(line), 7).tolist(),
        }


def plan_journey(
    name: str, origin_deg: Degrees, destination_deg: Degrees, hour: float = 12.0, weight: float = WEIGHT,
    most_unusable: float = MOST_UNUSABLE,
) -> PlannedJourney:  # fmt: skip
    """Plan a journey through a map, which is taken as it is; trees are left out, as their crowns change.

    Parameters
    ----------
    name : a packaged map, a file, or ``generated:SEED``
    origin_deg, destination_deg : latitude, longitude
    hour : of the day of departure, GPS time
    weight : seconds of time that an expected second without a usable position counts as
    most_unusable : largest expected share of the time without a usable position of the chance-constrained route

    Raises
    ------
    InputError
        There is no such map; a place is outside of it; both are one place, or no way leads from one to the other; or
        the hour, the weight or the share is out of range.
    """
    whole = named_map(name)
    sky = at_hour(SkyConfig(lat_deg=whole.frame.lat_deg, lon_deg=whole.frame.lon_deg), hour)
    reached = StreetGraph.of(whole)
    points = np.concatenate([reached.edges[k].points_en_m for k in sorted(reached.connected)])
    places = [_place(whole, points, *one) for one in ((origin_deg, "--from"), (destination_deg, "--to"))]
    streets = _near(whole, *places)
    graph = StreetGraph.of(streets)
    origin, destination = (place_on(graph, at, of) for at, of in zip(places, ("--from", "--to"), strict=True))
    stations = EdgeStations.along(graph.edges)
    buildings = city_of(replace(streets, trees=()), np.concatenate([edge.points_en_m for edge in graph.edges]))
    along = SkyAlong.of(stations, buildings)

    def planner_at(time: float) -> Planner:
        track = SkyTrack.from_config(at_hour(sky, time), 60.0)
        ahead = StreetsAhead.of(graph, stations, packaged_model(), along.at(track.at(track.start_s)))
        return Planner(ahead, origin, destination)

    now = planner_at(hour)
    routes = {
        "shortest": now.shortest(),
        "fastest": now.fastest(),
        "integrity-aware": now.weighted(weight),
        "chance-constrained": now.bounded(most_unusable),
    }
    by_hour = {one: planner_at(float(one)).weighted(weight) for one in HOURS}
    return PlannedJourney(streets, now.ahead, places[0], places[1], hour, routes, by_hour, weight)


def _place(streets: StreetMap, points_en_m: Array, place_deg: Degrees, name: str) -> Array:
    """East, North of a place within the bounds of points (n, 2) of streets.  (2,) [m]."""
    lat, lon = place_deg
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        raise InputError(f"{name} must be LAT,LON in degrees, got {lat:g},{lon:g}: latitude first")
    at = streets.frame.en_of(lat, lon)
    low, high = points_en_m.min(0), points_en_m.max(0)
    if np.any(at < low) or np.any(at > high):
        (south, west), (north, east) = streets.frame.lat_lon_of(np.stack([low, high]))
        raise InputError(
            f"{name} must lie in the map's connected streets, latitude {south:.5f} to {north:.5f}, longitude "
            f"{west:.5f} to {east:.5f}, got {lat:g},{lon:g}: choose a place there, or another map"
        )
    return np.asarray(at)


def _near(streets: StreetMap, origin: Array, destination: Array) -> StreetMap:
    """The streets near a journey."""
    margin = MARGIN_M + 0.5 * float(np.linalg.norm(destination - origin))
    low, high = np.minimum(origin, destination) - margin, np.maximum(origin, destination) + margin
    return replace(
        streets,
        streets=tuple(
            way
            for way in streets.streets
            if np.all(way.points_en_m.max(0) >= low) and np.all(way.points_en_m.min(0) <= high)
        ),
    )


def draw_journey(journey: PlannedJourney, path: Path, name: str) -> Path:
    """Draw buildings, streets by the probability of a usable position, and the routes; returns the path."""
    from matplotlib.collections import LineCollection, PathCollection
    from matplotlib.path import Path as Outline

    graph = journey.ahead.graph
    figure = new_figure(9.0, 8.0)
    axes = figure.add_subplot()
    solids = journey.streets.solids
    greys = np.repeat([[0.93 - 0.45 * min(solid.top_m / HIGH_M, 1.0)] for solid in solids], 3, axis=1)
    shapes = [Outline.make_compound_path(*map(Outline, solid.rings_en_m)) for solid in solids]
    axes.add_collection(PathCollection(shapes, facecolors=greys, linewidths=0.0))
    lines: Any = LineCollection([edge.points_en_m for edge in graph.edges], cmap="viridis", linewidths=2.2)
    lines.set_array(journey.ahead.edge_probability)
    lines.set_clim(0.0, 1.0)
    axes.add_collection(lines)
    for k, (title, route) in enumerate(journey.routes.items()):
        line = route_line(graph, route)
        text = f"{title}: {route.time_s:.0f} s, unusable {route.unusable_s:.0f} s"
        axes.plot(*line.T, color=COLOURS[title], lw=6.0 - 1.4 * k, alpha=0.85, label=text, solid_capstyle="round")
    for at, mark in ((journey.origin_en_m, "o"), (journey.destination_en_m, "s")):
        axes.plot(*at, mark, color="#FFFFFF", markeredgecolor="#000000", markersize=8)
    ends = np.stack([journey.origin_en_m, journey.destination_en_m])
    points = np.concatenate([ends, *(route_line(graph, route) for route in journey.routes.values())])
    low, high = points.min(0) - 200.0, points.max(0) + 200.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tidy(axes, xlabel="East [m]", ylabel="North [m]")
    axes.set_title(f"{name}, departure at {journey.hour:g} h", fontsize=10)
    legend(axes, loc="upper right")
    figure.colorbar(lines, ax=axes, label="probability of a usable position [-]", shrink=0.6)
    if not name.startswith(GENERATED):
        figure.text(0.01, 0.005, "Map data: (c) OpenStreetMap contributors, ODbL 1.0", fontsize=7, color="#666666")
    return save(figure, path)


def route_line(graph: StreetGraph, route: Route) -> Array:
    """The middles of the streets of a route, cut at its ends.  (n, 2) [m]."""
    return np.concatenate(list(_pieces(graph, route)))


def _pieces(graph: StreetGraph, route: Route) -> Iterator[Array]:
    for k, number in enumerate(route.edges):
        line = graph.edges[number].points_en_m
        length = float(arcs_of(line)[-1])
        begin = route.begin * length if k == 0 else 0.0
        yield part_of(line, begin, route.end * length if k == len(route.edges) - 1 else length)


def place_named(text: str, name: str) -> Degrees:
    """A place from ``LAT,LON``.

    Raises
    ------
    InputError
        It is no pair of numbers.
    """
    try:
        lat, lon = map(float, text.split(","))
    except ValueError:
        raise InputError(f"{name} must be LAT,LON in degrees, got {text!r}: write it as 52.4990,13.4180") from None
    return lat, lon
