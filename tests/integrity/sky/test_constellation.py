"""Nominal constellations: periods, sites in the sky, numbers in view, geometry."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.sky.constellation import SatelliteTable, SkyConfig, nominal_satellites
from lanebound.integrity.sky.orbit import propagate
from lanebound.integrity.sky.systems import CARRIER_HZ, FIXABLE, N_SYSTEMS, WAVELENGTH_M, System

DAY = 1.1e9 + np.arange(0.0, 86_400.0, 900.0)
TOKYO = (np.deg2rad(35.666), np.deg2rad(139.792), 40.0)


@pytest.fixture(scope="module")
def everything() -> SatelliteTable:
    return SkyConfig().satellites()


def test_carriers() -> None:
    assert WAVELENGTH_M.shape == (N_SYSTEMS, 3)
    assert WAVELENGTH_M[System.GPS, 0] == pytest.approx(0.190293673, abs=1e-9)  # IS-GPS-200: c / 1575.42 MHz
    assert CARRIER_HZ[System.GPS, 1] / CARRIER_HZ[System.GPS, 0] == pytest.approx(60 / 77)  # IS-GPS-200 3.3.1.1
    assert not FIXABLE[System.GLONASS]
    with pytest.raises(ValueError, match="read-only"):
        WAVELENGTH_M[0, 0] = 1.0


@pytest.mark.parametrize(
    ("system", "count", "period_s"),
    [
        (System.GPS, 31, 43_077.0),  # half a sidereal day plus nodal drift, SPS PS
        (System.GALILEO, 24, 14.0 * 3600 + 4 * 60 + 42),  # OS SDD 1.3: 14 h 4 min 42 s
        (System.GLONASS, 24, 11.0 * 3600 + 15 * 60 + 44),  # ICD 5.1: 11 h 15 min 44 s
        (System.BEIDOU, 24, 12.0 * 3600 + 53 * 60),  # BDS open service: 12 h 53 min
        (System.QZSS, 4, 86_164.1),  # a sidereal day
    ],
)
def test_orbital_period(system: System, count: int, period_s: float) -> None:
    satellites = nominal_satellites({system: count})
    assert len(satellites) == count
    assert np.unique(satellites.prn).size == count
    np.testing.assert_allclose(2.0 * np.pi / satellites.elements.mean_motion_radps, period_s, rtol=5e-4)


@pytest.mark.parametrize("count", [24, 27, 31])
def test_gps_keeps_its_baseline_slots_apart(count: int) -> None:
    satellites = nominal_satellites({System.GPS: count})
    position = propagate(satellites.elements, DAY[:4])[0]
    np.testing.assert_allclose(np.linalg.norm(position, axis=-1), 26_559_700.0)
    gap = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1) + 1e9 * np.eye(count)
    assert gap.min() > 1e6


def test_geostationary_satellite_stands_still_at_its_longitude() -> None:
    geo = nominal_satellites({System.QZSS: 4}).take(np.array([3]))
    position = propagate(geo.elements, DAY)[0][:, 0]
    lat, lon, _ = geodetic_from_ecef(position)
    np.testing.assert_allclose(np.rad2deg(lon), 127.0, atol=1e-4)
    np.testing.assert_allclose(lat, 0.0, atol=1e-9)
    np.testing.assert_allclose(propagate(geo.elements, DAY)[1], 0.0, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(position, axis=-1), 42_164_000.0, atol=1500.0)


def test_quasi_zenith_orbits_stay_about_135_east_and_long_over_japan(everything: SatelliteTable) -> None:
    inclined = everything.take(everything.system == System.QZSS).take(np.arange(3))
    lat, lon, _ = geodetic_from_ecef(propagate(inclined.elements, DAY)[0])
    mean_lon = np.rad2deg(np.angle(np.exp(1j * lon).mean(0)))
    np.testing.assert_allclose(mean_lon, 135.0, atol=2.0)
    assert np.rad2deg(np.abs(lat).max()) < 41.5
    view = inclined.view(DAY, *TOKYO)
    assert (np.rad2deg(view.elevation_rad.max(1)) > 60.0).all()  # IS-QZSS-PNT: one of three is always near the zenith


def test_elevations_of_a_satellite_overhead_and_of_its_antipode() -> None:
    geo = nominal_satellites({System.QZSS: 4}).take(np.array([3]))
    below = geo.view(DAY[:1], 0.0, np.deg2rad(127.0))
    assert below.elevation_rad[0, 0] == pytest.approx(np.pi / 2, abs=1e-5)
    away = geo.view(DAY[:1], 0.0, np.deg2rad(-53.0))
    assert away.elevation_rad[0, 0] == pytest.approx(-np.pi / 2, abs=1e-5)
    west = geo.view(DAY[:1], 0.0, np.deg2rad(150.0))
    assert west.azimuth_rad[0, 0] == pytest.approx(1.5 * np.pi, abs=1e-6)


def test_numbers_in_view_over_tokyo(everything: SatelliteTable) -> None:
    view = everything.view(DAY, *TOKYO, mask_rad=np.deg2rad(10.0))
    by_system = [view.above[:, view.system == s].sum(1) for s in System]
    assert by_system[System.GPS].min() >= 6
    assert [6 <= n.mean() <= 10 for n in by_system[:4]] == [True] * 4
    total = view.above.sum(1)
    assert total.min() >= 25
    assert total.max() <= 42


def test_position_dilution_of_24_gps_satellites_is_plausible() -> None:
    view = nominal_satellites({System.GPS: 24}).view(DAY, *TOKYO, mask_rad=np.deg2rad(5.0))
    pdop = []
    for los, above in zip(view.los_enu, view.above, strict=True):
        g = np.column_stack([-los[above], np.ones(above.sum())])
        pdop.append(np.sqrt(np.trace(np.linalg.inv(g.T @ g)[:3, :3])))
    assert np.median(pdop) < 3.0
    assert np.mean(np.array(pdop) <= 6.0) >= 0.98  # SPS PS 3.5.1: PDOP <= 6 for 98 % of the time globally


def test_range_rate_is_the_derivative_of_range(everything: SatelliteTable) -> None:
    t = DAY[::8]
    difference = everything.view(t + 0.5, *TOKYO).range_m - everything.view(t - 0.5, *TOKYO).range_m
    view = everything.view(t, *TOKYO)
    np.testing.assert_allclose(view.range_rate_mps, difference, atol=1e-3)
    assert np.abs(view.range_rate_mps[view.above]).max() < 1000.0
    np.testing.assert_allclose(np.linalg.norm(view.los_enu, axis=-1), 1.0)


def test_one_place_for_each_epoch_equals_one_view_for_each_place(everything: SatelliteTable) -> None:
    lat, lon = np.array([0.1, -0.9]), np.array([2.0, 0.4])
    both = everything.view(DAY[:2], lat, lon, 10.0, index=[1, 0, 1])
    for k in range(2):
        one = everything.view(DAY[k], lat[k], lon[k], 10.0)
        np.testing.assert_allclose(both.los_enu[k], one.los_enu[0], atol=1e-14)
    assert both.batch == 3
    assert both.satellites == len(everything)


def test_rising_leaves_out_only_satellites_never_seen(everything: SatelliteTable) -> None:
    t = DAY[:3]
    kept = everything.rising(t, *TOKYO, mask_rad=0.2)
    full = everything.view(t, *TOKYO, mask_rad=0.2)
    assert kept.view(t, *TOKYO, mask_rad=0.2).above.sum() == full.above.sum()
    assert len(kept) < len(everything)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"gps_time_s": np.nan}, "gps_time_s"),
        ({"lat_rad": 2.0}, "lat_rad"),
        ({"mask_rad": 2.0}, "mask_rad"),
        ({"index": [1]}, "index"),
        ({"height_m": np.inf}, "height_m"),
    ],
)
def test_bad_views_are_refused(everything: SatelliteTable, arguments: dict[str, object], word: str) -> None:
    good: dict[str, object] = {"gps_time_s": 1e9, "lat_rad": 0.1, "lon_rad": 0.2}
    with pytest.raises(InputError, match=word):
        everything.view(**(good | arguments))  # type: ignore[arg-type]


def test_counts_without_a_nominal_constellation_are_refused() -> None:
    with pytest.raises(InputError, match="GPS must be 0 or one of"):
        nominal_satellites({System.GPS: 25})
    with pytest.raises(InputError, match="at least one satellite"):
        nominal_satellites({})


def test_config_round_trip_and_refusals() -> None:
    config = SkyConfig(gps=24, qzss=0, lat_deg=-33.0)
    assert SkyConfig.from_json(config.to_json()) == config
    assert len(config.satellites()) == 24 * 4
    assert config.start_gps_s == 1900 * 604_800.0 + 180_000.0
    for bad in ({"gps": 30}, {"lat_deg": 91.0}, {"mask_deg": -1.0}, {"latitude": 3.0}):
        with pytest.raises(ConfigError):
            SkyConfig.load(bad)


def test_tables_pickle(everything: SatelliteTable) -> None:
    again = pickle.loads(pickle.dumps(everything))
    np.testing.assert_array_equal(propagate(again.elements, 1e9)[0], propagate(everything.elements, 1e9)[0])


def test_tables_have_a_row_for_each_system() -> None:
    assert len(System) == N_SYSTEMS
