"""Providers of corrections: common errors cancel, corrections age, messages come when they are received."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.sbas import GIVE_M2, UDRE_M2
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.augmentation import (
    AugmentationConfig,
    corrections_of,
    initial_held,
    initial_providers,
    receive_messages,
)
from lanebound.integrity.sensors.augmentation import advance_providers as advance
from lanebound.integrity.sensors.broadcast import BroadcastConfig, initial_broadcast, mapping, obliquity
from lanebound.integrity.sky.constellation import geostationary_view
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

DT, SATELLITES, AREAS = 0.1, 12, 300
PERFECT: dict[str, Any] = {
    "dgps": {"residual_m": 0.0, "baseline_km": 0.0, "latency_s": 0.0},
    "sbas_l1": {"residual_m": 0.0, "iono_residual_m": 0.0, "latency_s": 0.0},
    "sbas_dfmc": {"residual_m": 0.0},
    "ppp": {"residual_m": 0.0},
}


class Street:
    """Areas with one vehicle each, which hear everything unless told otherwise."""

    def __init__(self, config: AugmentationConfig, seed: int = 1) -> None:
        self.config, self.errors, self.streams = config, BroadcastConfig(), Streams(seed, AREAS)
        self.broadcast = initial_broadcast(SATELLITES, self.streams)
        self.areas = initial_providers(config, SATELLITES, DT, self.streams)
        self.held = initial_held(config, SATELLITES, AREAS)
        self.epoch = np.zeros(AREAS, np.int64)
        self.sine = np.linspace(0.2, 0.99, SATELLITES) * np.ones((AREAS, 1))
        self.system = np.zeros(SATELLITES, np.int64)
        self.ageing = 0.0015 * np.random.default_rng(seed).standard_normal((AREAS, SATELLITES))

    def step(self, geo: bool = True, up: bool = True, epochs: int = 1) -> None:
        for _ in range(epochs):
            self.epoch += 1
            self.errors.advance(self.broadcast, DT, self.streams)
            advance(self.config, (self.errors, self.broadcast), self.areas, self.epoch, DT, self.streams)
            in_view = np.full((AREAS, len(self.config.geo_longitude_deg)), geo)
            receive_messages(self.config, self.areas, self.held, in_view, np.full(AREAS, up), DT)

    def corrections(self, name: str) -> Any:
        now = self.errors.satellite_errors(self.broadcast), self.ageing
        return corrections_of(self.config, name, self.held, self.epoch, (self.sine, self.system), now, DT)

    def true_slant(self) -> np.ndarray:
        alike, iono = self.errors.delays(self.broadcast, self.sine, np.arange(AREAS))
        return np.asarray(alike + iono)


def test_common_errors_cancel_at_the_station_and_at_age_zero() -> None:
    street = Street(AugmentationConfig().replace(**PERFECT | {"dgps": PERFECT["dgps"] | {"interval_s": DT}}))
    street.step(epochs=3)
    found = street.corrections("dgps")
    assert found.age_s.max() == 0.0
    np.testing.assert_allclose(found.satellite_m, street.true_slant(), atol=1e-9)
    assert (found.zenith_m == 0.0).all()


def test_the_grid_and_the_satellite_corrections_of_sbas_are_parts_of_the_same_error() -> None:
    street = Street(AugmentationConfig().replace(**PERFECT))
    street.step()  # the first epoch sends everything
    found = street.corrections("sbas_l1")
    np.testing.assert_allclose(found.satellite_m, street.errors.satellite_errors(street.broadcast), atol=1e-12)
    slant = found.satellite_m + obliquity(street.sine) * found.zenith_m
    tropo = mapping(street.sine) * street.errors.tropo_zenith_m * street.broadcast.common[:, 1:]
    np.testing.assert_allclose(slant + tropo, street.true_slant(), atol=1e-9)


def test_corrections_age_with_the_clocks_and_the_grid_with_the_ionosphere() -> None:
    street = Street(AugmentationConfig().replace(**PERFECT))
    street.step()
    street.step(up=False, geo=False, epochs=300)
    for name in ("dgps", "sbas_dfmc"):
        np.testing.assert_allclose(street.corrections(name).age_s, 30.0)
    left = street.errors.satellite_errors(street.broadcast) - street.corrections("sbas_dfmc").satellite_m
    np.testing.assert_allclose(left, 30.0 * street.ageing, atol=1e-9)
    e, zenith = street.errors, street.errors.zenith_delays(street.broadcast)
    grown = zenith - street.corrections("sbas_l1").zenith_m
    expected = (2.146 * 30.0 * e.iono_zenith_m / e.iono_tau_s) ** 2  # a smooth process: 1.5 mm/s
    assert grown.var() == pytest.approx(expected, rel=0.5)  # 80 % is common to the satellites of 300 areas
    assert np.abs(left).max() < np.sqrt(1e-3 * 30.0) * 5.0


def test_residuals_have_the_stated_sigma_and_the_declared_one_bounds_it() -> None:
    street = Street(AugmentationConfig())
    street.step()
    for name in ("sbas_l1", "sbas_dfmc", "ppp"):
        left = street.corrections(name).satellite_m - street.errors.satellite_errors(street.broadcast)
        stated = getattr(street.config, name)
        assert left.std() == pytest.approx(stated.residual_m, rel=5.0 / np.sqrt(2.0 * left.size))
        assert stated.declared_m > stated.residual_m


def test_declared_sigmas_of_sbas_are_steps_of_the_tables() -> None:
    config = AugmentationConfig().sbas_l1
    assert config.declared_m == pytest.approx(np.sqrt(UDRE_M2[5]), abs=5e-4)
    assert config.iono_declared_m == pytest.approx(np.sqrt(GIVE_M2[9]), abs=5e-4)


def test_messages_come_at_their_intervals_with_their_latency() -> None:
    street = Street(AugmentationConfig())
    street.step()
    ages = []
    for _ in range(130):
        street.step()
        ages.append(street.corrections("sbas_dfmc").age_s.copy())
    seen = np.array(ages)[70:]
    c = street.config.sbas_dfmc
    assert seen.min() == pytest.approx(c.latency_s)
    assert seen.max() == pytest.approx(c.latency_s + c.interval_s - DT)


def test_satellites_that_are_not_monitored_have_no_declared_sigma() -> None:
    street = Street(AugmentationConfig())
    street.system = np.arange(SATELLITES) % 5
    street.step()
    assert np.isfinite(street.corrections("sbas_l1").declared_m).tolist() == (street.system == 0).tolist()


def test_messages_by_satellite_stop_behind_a_wall_and_those_by_network_in_an_outage() -> None:
    street = Street(AugmentationConfig().replace(sbas_l1={"delivery": "both"}))
    street.step(epochs=80)
    street.step(geo=False, epochs=200)
    assert street.corrections("sbas_dfmc").age_s.min() >= 20.0  # by GEO alone
    assert street.corrections("sbas_l1").age_s.max() < 10.0  # and by network, as SISNeT
    assert street.corrections("ppp").age_s.max() < 10.0
    street.step(geo=False, up=False, epochs=200)
    assert street.corrections("sbas_l1").age_s.min() >= 20.0
    street.step(geo=True, up=False, epochs=29)  # reacquires: 3 s without a message
    assert street.corrections("sbas_dfmc").age_s.min() >= 42.0
    street.step(geo=True, up=False, epochs=70)
    assert street.corrections("sbas_dfmc").age_s.max() < 10.0


def test_a_receiver_that_was_off_holds_nothing_at_first() -> None:
    street = Street(AugmentationConfig(warm=False))
    street.step(geo=False, up=False, epochs=5)
    assert np.isinf(street.corrections("sbas_l1").age_s).all()
    warm = Street(AugmentationConfig())
    warm.step(geo=False, up=False)
    assert (warm.corrections("sbas_l1").age_s == 0.0).all()


def test_a_geostationary_satellite_stands_where_the_formula_of_look_angles_says() -> None:
    latitude, longitude = np.deg2rad(35.666), np.deg2rad(139.792)
    view = geostationary_view((127.0, 139.792), (latitude, longitude, 0.0), 3)
    gap = longitude - np.deg2rad(127.0)
    azimuth = np.pi + np.arctan2(np.tan(gap), np.sin(latitude))  # on a sphere; 0.2 degrees on the ellipsoid
    assert view.azimuth_rad[0, 0] == pytest.approx(azimuth, abs=4e-3)
    cosine = np.cos(latitude) * np.cos(gap)
    elevation = np.arctan2(cosine - 6378.137 / 42164.17, np.sqrt(1.0 - cosine**2))
    assert view.elevation_rad[0, 0] == pytest.approx(elevation, abs=4e-3)
    assert view.azimuth_rad[0, 1] == pytest.approx(np.pi, abs=1e-9)
    assert view.index.shape == (3,)


def _stand(batch: int, epoch: int) -> Truth:
    position, still, heading = np.zeros((batch, 2)), np.zeros((batch, 2)), np.zeros(batch)
    return truth_between(epoch * DT, DT, (position, position), (still, still), (heading, heading))


def _hidden(mask: SkyMask, azimuth_rad: float) -> SkyMask:
    """An open sky but for a wall over 20 degrees of azimuth, from the horizon to 60 degrees."""
    a, e = 72, 30
    path = np.zeros((1, 1, a * e), np.uint8)
    for k in range(a):
        gap = np.angle(np.exp(1j * (2.0 * np.pi * (k + 0.5) / a - azimuth_rad)))
        if abs(gap) < np.deg2rad(10.0):
            path[0, 0, k * e : k * e + 20] = 3  # BLOCKED
    return SkyMask(path, np.zeros(path.shape, np.float32), a, e, 1.0, 1.0, True)


def test_a_wall_before_the_satellite_hides_it_in_the_instruments() -> None:
    config = NavigatorConfig(
        service="sbas_dfmc", gnss={"bands": [0, 2], "augmentation": {"geo_longitude_deg": [127.0]}}
    )
    track = SkyTrack.from_config(config.sky, 60.0)
    azimuth = float(geostationary_view((127.0,), config.sky.place_rad, 1).azimuth_rad[0, 0])
    ages = {}
    for name, turn in (("free", np.pi), ("hidden", 0.0)):
        navigator = Navigator(config, track, _hidden(SkyMask.open(), azimuth + turn), [1, 2])
        for k in range(250):
            corrections = navigator.measure(_stand(2, k + 1)).gnss.corrections
        assert corrections is not None
        ages[name] = corrections["sbas_dfmc"].age_s
    assert ages["free"].max() < 10.0
    np.testing.assert_allclose(ages["hidden"], 24.9)  # what a warm receiver held, measured in the first epoch


def test_figures_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"sbas_l1.latency_s must be < interval_s = 6, got 7"):
        AugmentationConfig().replace(sbas_l1={"latency_s": 7.0})
    with pytest.raises(ConfigError, match=r"systems must be among GPS, .*, got 'EGNOS'"):
        AugmentationConfig().replace(sbas_l1={"systems": ["EGNOS"]})
