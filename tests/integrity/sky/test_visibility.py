"""Sky masks: exact where they can be checked, and reflections by the image method."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from line_of_sight import line_of_sight
from numpy.typing import NDArray

from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.scene import City, Surface, prisms
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

Array = NDArray[np.float64]
STREET = Road.straight(100.0, 0.5 * np.pi, lane_count=3)  # eastward


def sky_of(azimuth_deg: Array, elevation_deg: Array, vehicles: int = 1) -> SkyView:
    """One sky table (K = 1) with satellites in given directions."""
    az, el = np.deg2rad(np.atleast_2d(azimuth_deg)), np.deg2rad(np.atleast_2d(elevation_deg))
    los = np.stack([np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), np.sin(el)], -1)
    n = az.shape[1]
    ids, far = np.arange(n), np.full((1, n), 2.2e7)
    return SkyView(los, el, az, far, 0.0 * far, el > 0.1, 0 * ids, ids, np.zeros(vehicles, dtype=np.int64))


def centres(mask: SkyMask) -> tuple[Array, Array]:
    """Azimuth and elevation of every cell [deg], in the order of the cells."""
    az = (np.arange(mask.azimuths) + 0.5) * 360.0 / mask.azimuths
    el = (np.arange(mask.elevations) + 0.5) * 90.0 / mask.elevations
    return np.repeat(az, mask.elevations), np.tile(el, mask.azimuths)


def wall(distance_m: float, height_m: float = 200.0, half_m: float = 2000.0) -> City:
    """A wall north of the street."""
    y = distance_m
    corners = [[-half_m, y, 0], [half_m, y, 0], [half_m, y, height_m], [-half_m, y, height_m]]
    return City.of([[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]])


def test_reflection_off_one_wall_has_the_closed_form_delay() -> None:
    # image method: 2 d cos(el) |cos(azimuth from the wall's normal)|
    road = Road.straight(20.0, 0.5 * np.pi)
    mask = SkyMask.build(road, wall(12.0), station_spacing_m=10.0)
    az, el = centres(mask)
    sky = sky_of(az, el)
    got = mask.look(10.0, 0, sky)
    south = np.cos(np.deg2rad(az)) < 0.0
    delay = 2.0 * 12.0 * np.cos(np.deg2rad(el)) * np.abs(np.cos(np.deg2rad(az)))
    # the antenna is 1.5 m high: the wall's top stands at 200 m, its ends 2 km away
    height = np.tan(np.deg2rad(el)) * 12.0 / np.abs(np.cos(np.deg2rad(az))) + 1.5
    reflected = south & (height < 199.0)
    np.testing.assert_allclose(got.excess_m[0, reflected], delay[reflected], rtol=1e-5)
    assert (got.path[0, reflected] == SignalPath.LOS).all()
    assert (got.excess_m[0, ~south] == 0.0).all()
    assert (got.path[0, ~south & (height < 199.0)] == SignalPath.BLOCKED).all()


def test_two_walls_make_a_blocked_satellite_arrive_by_reflection() -> None:
    # the northern wall hides satellites behind it, the higher southern one sends them back into the street
    city = wall(10.0, 20.0) + City.of(wall(10.0, 100.0).triangles_enu_m * np.array([1.0, -1.0, 1.0]))
    mask = SkyMask.build(Road.straight(10.0, 0.5 * np.pi), city)
    got = mask.look(5.0, 0, sky_of(np.array([1.5, 1.5, 181.5, 181.5]), np.array([55.5, 85.5, 40.5, 88.5])))
    # 55.5 deg northward: under the 20 m eave (61.6 deg), free by way of the south wall (83 deg)
    assert got.path[0].tolist() == [SignalPath.REFLECTED, SignalPath.LOS, SignalPath.BLOCKED, SignalPath.LOS]
    expected = 2.0 * 10.0 * np.cos(np.deg2rad(55.5)) * np.cos(np.deg2rad(1.5))
    assert got.excess_m[0, 0] == pytest.approx(expected, rel=1e-5)


@pytest.fixture(scope="module")
def canyon() -> tuple[City, SkyMask]:
    foot = [[[-30, 10], [130, 10], [130, 25], [-30, 25]], [[20, -25], [60, -25], [60, -10], [20, -10]]]
    city = City.of(prisms(foot, 0.0, [30.0, 20.0]))
    return city, SkyMask.build(STREET, city, station_spacing_m=10.0)


def test_mask_agrees_with_exact_line_of_sight_away_from_cell_edges(canyon: tuple[City, SkyMask]) -> None:
    city, mask = canyon
    rng = np.random.default_rng(5)
    az, el = rng.uniform(0, 360, 600), rng.uniform(0.1, 89.9, 600)
    for station in (0, 3, 10):
        for lane in range(3):
            position, _ = STREET.pose_at(10.0 * station, STREET.lane_lateral_m(lane))
            exact = []
            for da, de in ((0, 0), (-3, -3), (3, 3), (-3, 3), (3, -3)):
                e = np.clip(el + de, 0.01, 89.99)
                exact.append(line_of_sight(city, [*position, 1.5], sky_of(az + da, e).los_enu[0])[0])
            sure = (np.array(exact) == exact[0]).all(0)
            seen = mask.look(10.0 * station, lane, sky_of(az, el)).path[0] == SignalPath.LOS
            assert sure.mean() > 0.7
            np.testing.assert_array_equal(seen[sure], exact[0][sure])


def test_lanes_and_stations_are_the_nearest(canyon: tuple[City, SkyMask]) -> None:
    _, mask = canyon
    sky = sky_of(np.linspace(0, 359, 50), np.linspace(5, 80, 50), vehicles=6)
    arc, lane = np.array([-50.0, 4.9, 5.1, 99.0, 500.0, 40.0]), np.array([0, 0, 1, 2, 9, -3])
    got = mask.look(arc, lane, sky)
    np.testing.assert_array_equal(got.path, mask.look([0, 0, 10, 100, 100, 40], [0, 0, 1, 2, 2, 0], sky).path)
    assert got.path.dtype == np.uint8


def test_lane_nearest_the_buildings_sees_less() -> None:
    # buildings on the right only: what every lane sees, over 100 stations of a street
    config = CityConfig.load({"sections": [{"kind": "dense_canyon", "left_kind": "open"}]})
    road = Road.straight(500.0, 0.3, lane_count=3)
    mask = SkyMask.build(road, build_city(road, config, np.random.default_rng(2)), az_step_deg=6.0, el_step_deg=5.0)
    seen = (mask.path == SignalPath.LOS).mean((0, 2))
    assert seen[0] < seen[1] < seen[2]


@pytest.mark.parametrize(("kind", "share"), [(SectionKind.OVERPASS, 0.35), (SectionKind.TUNNEL, 0.02)])
def test_overpass_and_tunnel_block(kind: SectionKind, share: float) -> None:
    road = Road.straight(100.0, lane_count=2)
    city = build_city(road, CityConfig.uniform(kind), np.random.default_rng(0))
    mask = SkyMask.build(road, city, station_spacing_m=10.0)
    middle = mask.path[5]
    assert (middle == SignalPath.LOS).mean() < share
    assert (middle[:, mask.elevations - 1 :: mask.elevations] == SignalPath.BLOCKED).all()  # the zenith
    if kind is SectionKind.OVERPASS:
        assert (mask.path[0] == SignalPath.LOS).mean() > 0.9


def test_leaves_are_seen_through_and_solids_behind_them_are_not() -> None:
    box = [[[-5.0, 3.0], [5.0, 3.0], [5.0, 6.0], [-5.0, 6.0]]]
    trees = City.of(prisms(box, 2.0, 8.0, floor=True), Surface.FOLIAGE)
    road = Road.straight(10.0, 0.5 * np.pi)
    low, high = sky_of(np.array([1.0]), np.array([30.0])), sky_of(np.array([1.0]), np.array([80.0]))
    alone = SkyMask.build(road, trees)
    assert alone.look(0.0, 0, low).path == SignalPath.FOLIAGE
    assert alone.look(0.0, 0, high).path == SignalPath.LOS
    behind = SkyMask.build(road, trees + wall(20.0))
    assert behind.look(0.0, 0, low).path == SignalPath.BLOCKED


def test_closed_roads_wrap() -> None:
    road = Road.through([(0, 0), (0, 120), (150, 120), (150, 0)], closed=True, lane_count=2)
    city = build_city(road, CityConfig.uniform(SectionKind.SEMI_URBAN), np.random.default_rng(1))
    mask = SkyMask.build(road, city, az_step_deg=10.0, el_step_deg=10.0)
    sky = sky_of(np.arange(0, 360, 10.0), np.full(36, 35.0), vehicles=4)
    arc = np.array([1.0, road.length_m - 1.0, 77.0, 200.0])
    here = mask.look(arc, 0, sky)
    for turns in (-2, 1, 5):
        np.testing.assert_array_equal(mask.look(arc + turns * road.length_m, 0, sky).path, here.path)
    np.testing.assert_array_equal(here.path[0], here.path[1])  # both nearest to station 0


def test_open_sky_and_satellites_below_the_horizon() -> None:
    sky = sky_of(np.array([0.0, 90.0, 359.9]), np.array([-3.0, 0.0, 90.0]), vehicles=2)
    got = SkyMask.open().look([1e5, -3.0], [7, 0], sky)
    assert got.path.tolist() == [[SignalPath.BLOCKED, SignalPath.LOS, SignalPath.LOS]] * 2
    assert not got.excess_m.any()
    negative = replace(sky, azimuth_rad=sky.azimuth_rad - 4.0 * np.pi)
    np.testing.assert_array_equal(SkyMask.open().look(0.0, 0, negative).path, got.path)


def test_threads_and_one_core_build_the_same_mask() -> None:
    road = Road.straight(150.0, lane_count=1)
    city = build_city(road, CityConfig.uniform(SectionKind.DENSE_CANYON), np.random.default_rng(4))
    threads = SkyMask.build(road, city, az_step_deg=6.0, el_step_deg=6.0)
    with serial():
        alone = SkyMask.build(road, city, az_step_deg=6.0, el_step_deg=6.0)
    np.testing.assert_array_equal(threads.path, alone.path)
    np.testing.assert_array_equal(threads.excess_m, alone.excess_m)


def test_saved_masks_come_back_and_know_their_inputs(tmp_path: Path, canyon: tuple[City, SkyMask]) -> None:
    city, mask = canyon
    file = tmp_path / "mask.npz"
    mask.save(file)
    digest = SkyMask.digest_of(STREET, city, station_spacing_m=10.0)
    again = SkyMask.load(file, digest)
    assert numba.typeof(again.rows) == numba.typeof(mask.rows)  # or kernels would be compiled again
    np.testing.assert_array_equal(again.excess_m, mask.excess_m)
    assert (again.spacing_m, again.closed, again.digest) == (mask.spacing_m, mask.closed, digest)
    assert SkyMask.digest_of(STREET, city) != digest
    assert SkyMask.digest_of(STREET, City.empty(), station_spacing_m=10.0) != digest
    with pytest.raises(InputError, match="inputs"):
        SkyMask.load(file, "other")
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(InputError, match="build it again"):
        SkyMask.load(file)
    with pytest.raises(InputError, match="build it again"):
        SkyMask.load(tmp_path / "none.npz")
    assert pickle.loads(pickle.dumps(mask)).digest == digest


def test_bad_input_is_refused(canyon: tuple[City, SkyMask]) -> None:
    city, mask = canyon
    sky = sky_of(np.array([0.0]), np.array([40.0]), vehicles=2)
    with pytest.raises(InputError, match="arc_m"):
        mask.look([0.0, np.nan], 0, sky)
    with pytest.raises(InputError, match="shape"):
        mask.look([0.0, 1.0, 2.0], 0, sky)
    with pytest.raises(InputError, match="index"):
        mask.look(0.0, 0, replace(sky, index=np.array([1])))
    with pytest.raises(InputError, match="az_step_deg"):
        SkyMask.build(STREET, city, az_step_deg=7.0)
    with pytest.raises(InputError, match="lanes"):
        SkyMask.build(STREET, city, lanes=4)
    with pytest.raises(InputError, match="station_spacing_m"):
        SkyMask.build(STREET, city, station_spacing_m=0.0)


def test_stations_anywhere_are_cast_as_those_of_a_road_and_repeated_antennas_once() -> None:
    city = build_city(STREET, CityConfig.uniform(SectionKind.SEMI_URBAN), np.random.default_rng(1))
    built = SkyMask.build(STREET, city, 10.0)
    en, _ = STREET.pose_at(10.0 * np.arange(11)[:, None], STREET.lane_lateral_m([0, 1, 2])[None])
    antenna = np.concatenate([en, np.full((11, 3, 1), 1.5)], -1)
    free = SkyMask.of_stations(antenna, city, 10.0)
    np.testing.assert_array_equal(free.path, built.path)
    np.testing.assert_array_equal(free.excess_m, built.excess_m)
    twice = SkyMask.of_stations(antenna[:, [0, 2, 2]], city, 10.0)
    np.testing.assert_array_equal(twice.path, built.path[:, [0, 2, 2]])


@pytest.mark.parametrize("antenna", [np.zeros((2, 3)), np.zeros((0, 1, 3)), np.full((1, 1, 3), np.nan)])
def test_stations_of_another_shape_are_refused(antenna: Array) -> None:
    with pytest.raises(InputError, match="antenna_enu_m"):
        SkyMask.of_stations(antenna, City.empty())
