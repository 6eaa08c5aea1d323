"""Undifferenced observables: what a difference cancels, each error's law, standalone positions under the open sky."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.least_squares import design_matrix, gain
from lanebound.integrity.sensors.broadcast import BroadcastConfig, initial_broadcast, mapping, obliquity
from lanebound.integrity.sensors.gnss import GnssEpoch
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.systems import WAVELENGTH_M
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
DT = 0.1
TRACK = SkyTrack.from_config(SkyConfig(), 600.0)
EXACT = {"orbit_sigma_m": 0.0, "clock_sigma_m": 0.0, "iono_zenith_m": 0.0, "tropo_zenith_m": 0.0}
NOISELESS = {
    "code_sigma_m": 0.0, "phase_sigma_m": 0.0, "code_multipath_m": 0.0, "phase_multipath_m": 0.0, "iono_ppm": 0.0,
    "tropo_ppm": 0.0, "orbit_ppm": 0.0, "slips_per_h": 0.0, "clock_m": 0.0,
}  # fmt: skip


def _navigator(seeds: Any, gnss: dict[str, Any], batch: int | None = None, area_seed: int | None = None) -> Navigator:
    config = NavigatorConfig().replace(gnss={"undifferenced": True, **gnss})
    return Navigator(config, TRACK, SkyMask.open(), seeds, batch, area_seed=area_seed)


def _truth(position: Array, epoch: int) -> Truth:
    """Vehicles (B, 2) that stand."""
    still, heading = np.zeros_like(position), np.zeros(len(position))
    return truth_between(epoch * DT, DT, (position, position), (still, still), (heading, heading))


def _measure(navigator: Navigator, position: Array, epochs: int = 40) -> tuple[GnssEpoch, SkyView]:
    for epoch in range(1, epochs + 1):
        found = navigator.measure(_truth(position, epoch))
    return found.gnss, found.sky


def _positions(code: Array, used: NDArray[np.bool_], sky: SkyView) -> Array:
    """Least squares by elevation, a clock for each system: (B, 2)."""
    los = sky.los_enu[sky.index]
    weight = np.where(used & (los[..., 2] > 0.17), np.square(los[..., 2]), 0.0)
    design = design_matrix(los, np.broadcast_to(sky.system, weight.shape))
    found = gain(design, weight[..., None] * np.eye(weight.shape[1]))
    assert found.solved.all()
    return np.asarray((found.gain @ code[..., None])[:, :2, 0])


def _raw(epoch: GnssEpoch) -> tuple[Array, Array]:
    assert epoch.raw_code_m is not None
    assert epoch.raw_phase_m is not None
    return epoch.raw_code_m, epoch.raw_phase_m


def test_without_broadcast_errors_codes_lead_to_the_true_origin_and_differences_to_that_of_the_station() -> None:
    gnss = {**NOISELESS, "broadcast": EXACT, "reference_offset_m": 5.0, "age_rate_mps": 0.0}
    position = np.array([[3.0, -4.0], [10.0, 20.0]])
    epoch, sky = _measure(_navigator([1, 2], gnss), position)
    code, _ = _raw(epoch)
    for band in range(2):
        np.testing.assert_allclose(_positions(code[..., band], epoch.tracked, sky), position, atol=1e-6)
    off = np.hypot(*(_positions(epoch.code_m[..., 0], epoch.tracked, sky) - position).T)
    np.testing.assert_allclose(off, 5.0, atol=1e-6)


def test_a_difference_of_two_receivers_of_an_area_cancels_what_is_broadcast() -> None:
    gnss = {**NOISELESS, "broadcast": {"orbit_sigma_m": 5.0}, "clock_h0": 0.0, "clock_hm2": 0.0, "drift_mps": 0.0}
    position = np.array([[0.0, 0.0], [30.0, -7.0]])
    epoch, sky = _measure(_navigator([1, 2], gnss, area_seed=3), position)
    code, phase = _raw(epoch)
    los, both = sky.los_enu[sky.index[0]], epoch.tracked.all(axis=0)
    expected = -los[both, :2] @ (position[1] - position[0])
    np.testing.assert_allclose((code[1] - code[0])[both, 0], expected, atol=1e-6)
    wave = WAVELENGTH_M[sky.system[both], 0]
    cycles = ((phase[1] - phase[0])[both, 0] - expected) / wave
    locked = (epoch.phase_m[:, both, 0] != 0.0).all(axis=0)
    np.testing.assert_allclose(cycles[locked], np.round(cycles[locked]), atol=1e-5)
    assert np.abs(code[0, both, 0] + los[both, :2] @ position[0]).max() > 2.0  # of 5 m: it was there to cancel


def test_code_and_phase_part_by_the_ionosphere_as_the_bands_do() -> None:
    gnss = {**NOISELESS, "broadcast": {**EXACT, "iono_zenith_m": 3.0}}
    epoch, sky = _measure(_navigator([4], gnss), np.zeros((1, 2)))
    code, _ = _raw(epoch)
    delay = code[0, :, 0] - epoch.code_m[0, :, 0]
    other = code[0, :, 1] - epoch.code_m[0, :, 1]
    used = epoch.tracked[0]
    common = (other - delay)[used]  # (dispersion - 1) of the delay of the first band; clocks of the station cancel
    dispersion = (WAVELENGTH_M[sky.system, 1] / WAVELENGTH_M[sky.system, 0])[used] ** 2
    navigator = _navigator([4], gnss)
    _measure(navigator, np.zeros((1, 2)))
    state = navigator.state.area.broadcast
    assert state is not None
    sine = sky.los_enu[sky.index][..., 2]
    _, iono = navigator.config.gnss.broadcast.delays(state, np.where(epoch.tracked, sine, 1.0), np.zeros(1, np.int64))
    np.testing.assert_allclose(common, (dispersion - 1.0) * iono[0, used], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "own"),
    [("orbit_sigma_m", True), ("clock_sigma_m", True), ("iono_zenith_m", False), ("tropo_zenith_m", False)],
)
def test_each_term_has_its_sigma_its_mapping_and_its_memory(name: str, own: bool) -> None:
    """4000 areas; every variance and covariance within two-sided bounds of 1e-3 together."""
    areas, sine = 4000, np.array([[1.0, 0.5, 0.2]])
    config = BroadcastConfig(**{**EXACT, name: 2.0})
    streams = Streams(5, areas)
    state, rows = initial_broadcast(3, streams), np.arange(areas)
    first = np.sum(config.delays(state, np.broadcast_to(sine, (areas, 3)), rows), axis=0)
    tau = {"orbit_sigma_m": config.orbit_tau_s, "clock_sigma_m": config.clock_tau_s, "iono_zenith_m": config.iono_tau_s}
    for _ in range(3):
        config.advance(state, 0.2 * tau.get(name, config.tropo_tau_s), streams)
    later = np.sum(config.delays(state, np.broadcast_to(sine, (areas, 3)), rows), axis=0)
    slant = {"iono_zenith_m": obliquity, "tropo_zenith_m": mapping}.get(name, np.ones_like)(sine)[0]
    low, high = chi2.ppf([1e-3 / 24, 1.0 - 1e-3 / 24], areas) / areas
    for values in (first, later):
        variance = np.square(values / (2.0 * slant)).mean(axis=0)
        assert ((low < variance) & (variance < high)).all()
    bound = 4.1 / np.sqrt(areas)
    memory = (first * later).mean(axis=0) / np.square(2.0 * slant)
    a = np.exp(-2.146193 * 0.2)  # three steps of a double pole
    np.testing.assert_allclose(memory, (1.0 + 3.0 * (1.0 - a * a) / (1.0 + a * a)) * a**3, atol=bound * 1.5)
    shared = (first[:, 0] * first[:, 2]).mean() / (4.0 * slant[0] * slant[2])
    expected = 0.0 if own else config.iono_common if name == "iono_zenith_m" else 1.0
    assert shared == pytest.approx(expected, abs=bound * 1.5)


def test_slants_are_those_of_the_standard() -> None:
    """RTCA DO-229: obliquity 1 at the zenith and 3.03 at 5 degrees; mapping 1 at the zenith and 5.6 at 10 degrees."""
    sine = np.sin(np.deg2rad([90.0, 5.0, 10.0]))
    np.testing.assert_allclose(obliquity(sine[:2]), [1.0, 3.0], atol=0.06)
    np.testing.assert_allclose(mapping(sine[[0, 2]]), [1.0, 5.59], atol=0.01)


def test_standalone_positions_under_the_open_sky_are_a_few_metres_off() -> None:
    """S2 Table 1: 1 to 6 m for single-frequency positions; 300 receivers, each in an area of its own."""
    epoch, sky = _measure(_navigator(7, {}, batch=300), np.zeros((300, 2)), 15)
    code, _ = _raw(epoch)
    error = np.hypot(*_positions(code[..., 0], epoch.tracked, sky).T)
    assert 1.0 < np.sqrt(np.square(error).mean()) < 6.0
    assert 1.0 < np.quantile(error, 0.95) < 6.0
    differenced = np.hypot(*_positions(epoch.code_m[..., 0], epoch.tracked, sky).T)
    assert np.quantile(differenced, 0.95) < 1.0


def test_undifferenced_observables_change_nothing_else_and_do_not_depend_on_the_batch() -> None:
    position = np.zeros((3, 2))
    with_them, _ = _measure(_navigator([1, 2, 3], {}), position)
    without, _ = _measure(_navigator([1, 2, 3], {"undifferenced": False}), position)
    assert without.raw_code_m is None
    for name in ("code_m", "phase_m", "range_rate_mps", "cn0_dbhz", "tracked"):
        np.testing.assert_array_equal(getattr(with_them, name), getattr(without, name))
    alone, _ = _measure(_navigator([2], {}), position[:1])
    for found, expected in zip(_raw(alone), _raw(with_them), strict=True):
        np.testing.assert_array_equal(found[0], expected[1])
