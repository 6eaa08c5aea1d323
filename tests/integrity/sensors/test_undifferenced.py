"""Undifferenced observables: each term's statistics, what two receivers share, and positions of one receiver alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sensors.gnss import GnssConfig, GnssEpoch
from lanebound.integrity.sensors.undifferenced import (
    Delays,
    UndifferencedConfig,
    add_delays,
    advance,
    delays,
    initial_state,
    obliquity,
    troposphere_mapping,
)
from lanebound.integrity.sky.systems import WAVELENGTH_M, System
from lanebound.integrity.sky.view import SkyView

CONFIG = UndifferencedConfig()
AREAS = 4000


def view(elevation_deg: list[float]) -> SkyView:
    """GPS satellites in the North at these elevations."""
    elevation = np.radians([elevation_deg])
    zero = np.zeros_like(elevation)
    los = np.stack([zero, np.cos(elevation), np.sin(elevation)], -1)
    system = np.zeros(elevation.size, np.int64)
    return SkyView(los, elevation, zero, zero, zero, elevation > 0.0, system, system + 1, np.zeros(1, np.int64))


def test_slant_factors_are_those_of_their_sources() -> None:
    assert obliquity(math.pi / 2.0) == pytest.approx(1.0)
    assert obliquity(0.0) == pytest.approx((1.0 - (6371.0 / 6721.0) ** 2) ** -0.5)
    assert obliquity(math.radians(30.0)) == pytest.approx(1.751, abs=1e-3)
    assert troposphere_mapping(math.pi / 2.0) == pytest.approx(1.0, abs=1e-6)
    assert troposphere_mapping(math.radians(5.0)) == pytest.approx(1.001 / math.sqrt(0.002001 + 0.0075961), rel=1e-4)


def test_each_term_has_the_stated_size_and_is_common_to_what_it_should() -> None:
    """Sigmas of 4,000 areas are known to 1.1 %; bands are four times that."""
    sky = view([90.0, 30.0, 10.0])
    found = delays(CONFIG, initial_state(3, Streams(1, AREAS)), sky)
    np.testing.assert_allclose(found.satellite.std(0), math.hypot(CONFIG.orbit_m, CONFIG.clock_m), rtol=0.045)
    assert np.abs(np.corrcoef(found.satellite.T) - np.eye(3)).max() < 4.0 / math.sqrt(AREAS)
    left = found.iono - found.iono_model
    zenith = math.hypot(CONFIG.iono_share * CONFIG.iono_zenith_m, CONFIG.iono_own_m)
    np.testing.assert_allclose(left.std(0), zenith * obliquity(sky.elevation_rad[0]), rtol=0.045)
    assert np.corrcoef(left.T).min() > 0.97  # one sky for all satellites, but for the ray's own part
    tropo = (found.tropo - found.tropo_model) / troposphere_mapping(sky.elevation_rad[0])
    np.testing.assert_allclose(tropo, tropo[:, :1] @ np.ones((1, 3)), atol=1e-12)  # one zenith delay for all
    assert tropo.std() == pytest.approx(CONFIG.tropo_residual_m, rel=0.045)
    np.testing.assert_allclose(found.residual, found.satellite + left + found.tropo - found.tropo_model)


def test_terms_last_as_long_as_stated() -> None:
    streams = Streams(2, AREAS)
    state = initial_state(2, streams)
    before = state.copy()
    advance(CONFIG, state, 600.0, streams)
    for name, tau_s in (
        ("orbit", CONFIG.orbit_tau_s), ("clock", CONFIG.clock_tau_s), ("iono_own", CONFIG.iono_own_tau_s),
        ("iono", CONFIG.iono_tau_s), ("tropo", CONFIG.tropo_tau_s),
    ):  # fmt: skip
        then, now = getattr(before, name).ravel(), getattr(state, name).ravel()
        assert np.corrcoef(then, now)[0, 1] == pytest.approx(math.exp(-600.0 / tau_s), abs=0.06)
        assert now.std() == pytest.approx(1.0, abs=0.045)


def test_one_stream_does_not_move_the_others() -> None:
    one, other = Streams([5]), Streams([5])
    other.normal("ionosphere", 7)
    a, b = initial_state(3, one), initial_state(3, other)
    np.testing.assert_array_equal(a.orbit, b.orbit)
    np.testing.assert_array_equal(a.tropo, b.tropo)
    assert (a.iono != b.iono).all()


def receivers(seeds: list[int], gnss: GnssConfig) -> tuple[GnssEpoch, SkyView]:
    """Receivers that have stood under the open sky for 5 s."""
    config = NavigatorConfig().replace(gnss=CONFIG.receiver(gnss).to_dict())
    navigator, place, heading = Navigator.nominal(config, seeds), np.zeros((len(seeds), 2)), np.zeros(len(seeds))
    for k in range(50):
        m = navigator.measure(truth_between(0.1 * (k + 1), 0.1, (place, place), (place, place), (heading, heading)))
    return m.gnss, m.sky


def standalone(epoch: GnssEpoch, sky: SkyView, found: Delays, v: int) -> np.ndarray:
    """Position (3,) of receiver v by its codes on L1 less both models, weighted by elevation."""
    used = np.flatnonzero(epoch.tracked[v] & (sky.elevation_rad[0] > math.radians(10.0)))
    e, system = sky.los_enu[0, used], sky.system[used]
    design = np.column_stack([-e, system[:, None] == np.unique(system)])
    weight = np.sin(sky.elevation_rad[0, used])
    y = epoch.code_m[v, used, 0] - (found.iono_model + found.tropo_model)[0, used]
    return np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)[0][:3]


def test_positions_of_one_receiver_are_off_by_metres_and_differences_by_noise() -> None:
    """S2 table 1: 1 to 6 m for single points. Two receivers of one area share all but their noise."""
    seeds = list(range(40))
    plain, sky = receivers(seeds, GnssConfig(bands=(0,), propagation="paths"))
    state = initial_state(sky.satellites, Streams(seeds))
    found = delays(CONFIG, state, sky)
    epoch = add_delays(plain, found, sky, (0,))
    off = np.array([standalone(epoch, sky, found, v) for v in range(len(seeds))])
    horizontal = np.hypot(off[:, 0], off[:, 1])
    assert 0.5 < np.sqrt((horizontal**2).mean()) < 3.0
    assert 1.0 < np.sqrt((off**2).sum(-1).mean()) < 6.0
    assert np.quantile(np.linalg.norm(off, axis=-1), 0.95) < 9.0
    one = delays(CONFIG, initial_state(sky.satellites, Streams([3])), sky)
    shared = add_delays(plain, one, sky, (0,))
    both = plain.tracked[0] & plain.tracked[1]
    np.testing.assert_allclose(
        (shared.code_m[0] - shared.code_m[1])[both], (plain.code_m[0] - plain.code_m[1])[both], atol=1e-9
    )
    apart = (epoch.code_m[0] - epoch.code_m[1])[both, 0] - (plain.code_m[0] - plain.code_m[1])[both, 0]
    assert np.abs(apart).max() > 0.5  # areas of their own share nothing


def test_the_ionosphere_advances_phases_and_goes_with_the_square_of_the_wavelength() -> None:
    sky = view([60.0])
    code, phase = np.full((1, 1, 2), 100.0), np.array([[[50.0, 0.0]]])
    one = np.ones((1, 1))
    epoch = GnssEpoch(one > 0, code, phase, 0.0 * one, 45.0 * one, one < 0, np.zeros(1))
    ionosphere = Delays(0.0 * one, 4.0 * one, 0.0 * one, 0.0 * one, 0.0 * one)
    found = add_delays(epoch, ionosphere, sky, (0, 2))
    ratio = (WAVELENGTH_M[System.GPS, 2] / WAVELENGTH_M[System.GPS, 0]) ** 2
    np.testing.assert_allclose(found.code_m[0, 0], [104.0, 100.0 + 4.0 * ratio])
    np.testing.assert_allclose(found.phase_m[0, 0], [46.0, 0.0])  # the second is not measured
    others = Delays(one, 0.0 * one, 2.0 * one, 0.0 * one, 0.0 * one)
    np.testing.assert_allclose(add_delays(epoch, others, sky, (0, 2)).phase_m[0, 0], [53.0, 0.0])


def test_a_receiver_alone_has_its_own_part_of_the_noise() -> None:
    gnss = GnssConfig()
    own = CONFIG.receiver(gnss)
    assert own.code_sigma_m == pytest.approx(math.sqrt(gnss.code_sigma_m**2 - gnss.station_parts["station_code"] ** 2))
    assert own.station_code_m == own.station_clock_h0 == own.baseline_km == own.age_rate_mps == 0.0
    assert own.station_multipath_tau_s == gnss.station_multipath_tau_s


def test_what_does_not_fit_is_named() -> None:
    state = initial_state(3, Streams(1, 2))
    with pytest.raises(InputError, match="must have 1 row and 3 satellites"):
        delays(CONFIG, state, view([10.0, 20.0]))
    found = delays(CONFIG, state, view([90.0, 30.0, 10.0]))
    none = np.zeros((5, 3))
    epoch = GnssEpoch(none > 0, np.zeros((5, 3, 2)), np.zeros((5, 3, 2)), none, none, none > 0, np.zeros(5))
    with pytest.raises(InputError, match="must be of 1 or 5 areas"):
        add_delays(epoch, found, view([90.0, 30.0, 10.0]), (0, 1))
