"""What a map promises: the cells that the mask of the same city leaves free, counted above the mask angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

STREET = Road.straight(100.0, 0.3, lane_count=2)
CITY = build_city(STREET, CityConfig.uniform(SectionKind.SEMI_URBAN, tree_spacing_m=12.0), np.random.default_rng(1))


def antennas() -> NDArray[np.float64]:
    en, _ = STREET.pose_at(10.0 * np.arange(11)[:, None], STREET.lane_lateral_m([0, 1])[None])
    return np.concatenate([en, np.full((11, 2, 1), 1.5)], -1)


def sky(hours: float = 0.0) -> SkyView:
    config = SkyConfig()
    time_s = np.array([config.start_gps_s, config.start_gps_s + 3600.0 * hours])
    return config.satellites().view(time_s, *config.place_rad, config.mask_rad, np.array([1]))


def test_free_cells_are_those_that_the_mask_of_the_same_city_has_in_sight() -> None:
    mask = SkyMask.of_stations(antennas(), CITY, 10.0)
    found = SkyForecast.of_stations(antennas(), CITY, 10.0)
    assert (mask.path == SignalPath.FOLIAGE).any()
    np.testing.assert_array_equal(found.free, mask.path == SignalPath.LOS)
    assert (found.azimuths, found.elevations) == (mask.azimuths, mask.elevations)


def test_places_count_what_the_mask_of_the_same_city_receives_directly() -> None:
    mask, view = SkyMask.of_stations(antennas(), CITY, 10.0), sky(2.0)
    arc, lane = np.array([-5.0, 0.0, 33.0, 80.0, 100.0, 400.0]), np.array([0, -1, 1, 7, 1, 0])
    received = mask.look(arc, lane, replace(view, index=np.ones(arc.size, np.int64))).path == SignalPath.LOS
    expected = (received & view.above[1]).sum(-1)
    found = SkyForecast.of_stations(antennas(), CITY, 10.0).count(arc, lane, view)
    np.testing.assert_array_equal(found, expected)
    assert len(set(found)) > 2


def test_signals_in_sight_are_those_that_are_counted() -> None:
    view, forecast = sky(2.0), SkyForecast.of_stations(antennas(), CITY, 10.0)
    seen = forecast.in_sight(view)
    for lane in (0, 1):
        counted = forecast.count(10.0 * np.arange(11), np.full(11, lane), view)
        np.testing.assert_array_equal(seen[:, lane].sum(-1), counted)
    assert not (seen & ~view.above[1]).any()


def test_an_open_sky_shows_all_above_the_mask_angle_and_a_tunnel_none() -> None:
    view, places = sky(), (np.array([0.0, 50.0]), np.array([0, 1]))
    np.testing.assert_array_equal(SkyForecast.open().count(*places, view), 2 * [view.above[1].sum()])
    np.testing.assert_array_equal(
        SkyForecast.of_stations(antennas(), City.empty(), 10.0).count(*places, view), 2 * [view.above[1].sum()]
    )
    tunnel = build_city(STREET, CityConfig.uniform(SectionKind.TUNNEL), np.random.default_rng(0))
    assert SkyForecast.of_stations(antennas(), tunnel, 10.0).count(*places, view)[1] == 0


@pytest.mark.parametrize(
    ("antenna", "more", "message"),
    [
        (np.zeros((2, 3)), (), "antenna_enu_m"),
        (np.full((1, 1, 3), np.nan), (), "antenna_enu_m"),
        (np.zeros((1, 1, 3)), (0.0,), "spacing_m"),
        (np.zeros((1, 1, 3)), (5.0, 7.0), "az_step_deg must divide"),
    ],
)
def test_bad_input_is_refused(antenna: NDArray[np.float64], more: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SkyForecast.of_stations(antenna, City.empty(), *more)
