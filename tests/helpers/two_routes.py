"""A city whose answer is known: a short way below a roof, and a longer one under the open sky, between two blocks."""

from __future__ import annotations

from functools import cache

import numpy as np

from lanebound.envs.journeys.town import JourneyTown, Town, TownHour
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.sky.maps.graph import StreetGraph
from lanebound.integrity.sky.maps.records import MapFrame, StreetMap, StreetWay
from lanebound.integrity.sky.scene import City, Surface, prisms

SPEED_MPS = 10.0
HOURS = 3.0, 15.0
TUNNEL_M, OPEN_M = 400.0, 480.0
WEST, EAST = (-100.0, 0.0), (500.0, 0.0)  # places: middles of the outer sides of both blocks
NODES = {
    0: (0.0, -50.0), 1: (0.0, 50.0), 2: (-100.0, 50.0), 3: (-100.0, -50.0),  # the western block
    4: (400.0, -50.0), 5: (400.0, 50.0), 6: (500.0, 50.0), 7: (500.0, -50.0), 8: (200.0, 182.7),
}  # fmt: skip
STREETS = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 8), (8, 5)]


def street_map() -> StreetMap:
    """Two-way streets."""
    ways = [
        StreetWay(k, ends, np.array([NODES[n] for n in ends]), "tertiary", 1, 1, 3.25, SPEED_MPS)
        for k, ends in enumerate(STREETS)
    ]
    return StreetMap(MapFrame(35.66, 139.79), tuple(ways))


def roof(west_m: float, south_m: float, east_m: float, north_m: float) -> City:
    """A roof, 5 m above the street."""
    square = np.array([(west_m, south_m), (east_m, south_m), (east_m, north_m), (west_m, north_m)])
    return City.of(prisms(square[None], 5.0, 6.0, floor=True), Surface.SOLID)


@cache
def two_routes(dark: bool = False) -> tuple[TownHour, ...]:
    """The city at two hours; ``dark``: in truth there is a roof over everything, which the map does not know."""
    tunnel = roof(10.0, -400.0, 390.0, 20.0)
    town = Town(StreetGraph.of(street_map()), roof(-1000.0, -1000.0, 1500.0, 1000.0) if dark else tunnel, tunnel)
    return JourneyTown.of(town, "urban", named_generator(1, "places"), places=99).hours(town.mapped, HOURS)


def place_at(town: JourneyTown, place: tuple[float, float]) -> int:
    """The number of the place nearest to one."""
    return int(np.argmin(np.linalg.norm(town.places - np.array(place), axis=1)))
