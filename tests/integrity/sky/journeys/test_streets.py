"""Stations along streets, and the sky that obstacles leave there."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.journeys.streets import EdgeStations, SkyAlong, at_hour, lane_line
from lanebound.integrity.sky.maps.graph import StreetEdge
from lanebound.integrity.sky.maps.records import StreetWay
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.track import SkyTrack


def street(lanes: int = 1, against: int = 1, *, covered: bool = False) -> StreetEdge:
    points = np.array([(0.0, 0.0), (0.0, 95.0)])
    way = StreetWay(0, (0, 1), points, "residential", lanes, against, 3.0, 10.0, covered=covered)
    return StreetEdge(way, 0, 1, points, lanes, against)


def walls(height_m: float, count: int = 2) -> City:
    """Blocks on both sides of a street to the North."""
    foot = np.array([[(x, -20.0), (x + 10.0, -20.0), (x + 10.0, 120.0), (x, 120.0)] for x in (8.0, -18.0)])
    return City.of_buildings(foot[:count], np.full(count, height_m))


LANES = [(1, 1, 1.5), (2, 2, 4.5), (1, 0, 0.0), (3, 0, 3.0), (2, 1, 3.0)]


@pytest.mark.parametrize(("lanes", "against", "right_m"), LANES)
def test_the_line_is_that_of_the_rightmost_lane(lanes: int, against: int, right_m: float) -> None:
    np.testing.assert_allclose(lane_line(street(lanes, against)), [(right_m, 0.0), (right_m, 95.0)], atol=1e-12)


def test_stations_stand_for_equal_parts_of_their_street() -> None:
    stations = EdgeStations.along([street(), street(2, 2)], 10.0)
    assert stations.first.tolist() == [0, 10, 20]
    np.testing.assert_allclose(stations.part_m, 9.5)
    np.testing.assert_allclose(stations.part_s.sum(), 19.0)
    np.testing.assert_allclose(stations.place_en_m[:2], [(1.5, 4.75), (1.5, 14.25)])
    assert stations.of(1) == slice(10, 20)


def test_obstacles_never_add_satellites_nor_improve_the_geometry() -> None:
    stations = EdgeStations.along([street()])
    track = SkyTrack.from_config(SkyConfig(), 60.0)
    sky = track.at(track.start_s)
    found = [SkyAlong.of(stations, city).at(sky) for city in (City.empty(), walls(8.0), walls(20.0), walls(60.0))]
    for less, more in itertools.pairwise(found):
        assert np.all(more.satellites <= less.satellites)
        assert np.all(more.pdop >= less.pdop - 1e-9)
    assert found[-1].satellites.mean() < 0.5 * found[0].satellites.mean()
    one = SkyAlong.of(stations, walls(60.0, 1)).at(sky)
    assert np.all(one.satellites >= found[-1].satellites)


def test_below_a_roof_there_is_no_satellite() -> None:
    track = SkyTrack.from_config(SkyConfig(), 60.0)
    found = SkyAlong.of(EdgeStations.along([street(), street(covered=True)]), City.empty()).at(track.at(track.start_s))
    assert found.satellites[:10].min() > 10
    assert found.satellites[10:].max() == 0
    assert np.isinf(found.pdop[10:]).all()


def test_hours_of_the_day() -> None:
    sky = SkyConfig()
    assert at_hour(sky, 0.0).week_second_s == 2 * 86_400.0
    assert at_hour(at_hour(sky, 23.5), 6.0).week_second_s == 2 * 86_400.0 + 6.0 * 3600.0
    for hour in (-1.0, 24.0):
        with pytest.raises(InputError, match="hour"):
            at_hour(sky, hour)
