"""Positioning services: corrected ranges against hand-made errors, levels in drives, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from signal_records import records_of, rows_of

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.services.fix_kernel import takes
from lanebound.integrity.navigators.services.records_kernel import PART, SERVICE_LABEL, SERVICE_WORK, ServiceRows
from lanebound.integrity.navigators.services.stage import band_shares, service_tables
from lanebound.integrity.navigators.services.table import SERVICES
from lanebound.integrity.navigators.services.zenith_kernel import zenith_of_epoch
from lanebound.integrity.positioning.code_errors_kernel import troposphere_slant
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.sky.systems import WAVELENGTH_M, System

L1_L5: dict[str, Any] = {"gnss": {"bands": [0, 2]}}
NO_NOISE: dict[str, Any] = {
    "code_sigma_m": 0.0, "code_multipath_m": 0.0, "phase_sigma_m": 0.0, "phase_multipath_m": 0.0,
    "range_rate_sigma_mps": 0.0,
    "iono_ppm": 0.0, "tropo_ppm": 0.0, "orbit_ppm": 0.0, "age_rate_mps": 0.0,
    "augmentation": {
        "dgps": {"residual_m": 0.0, "baseline_km": 0.0},
        "sbas_l1": {"residual_m": 0.0, "iono_residual_m": 0.0},
        "sbas_dfmc": {"residual_m": 0.0},
    },
}  # fmt: skip
NO_TROPO: dict[str, Any] = {"broadcast": {"tropo_zenith_m": 0.0}}
NO_CLOCK: dict[str, Any] = {"broadcast": {"orbit_tau_s": 1e9, "clock_tau_s": 1e9, "iono_tau_s": 1e9}}


def _drive(
    config: NavigatorConfig, batch: int, epochs: int, speed: float = 10.0, **more: Any
) -> dict[str, NDArray[Any]]:
    """Drive North; errors (K, B, 2) East and North, levels across East and along North, mode."""
    navigator = Navigator.nominal(config, seeds=list(range(batch)), duration_s=0.1 * epochs + 60.0)
    heading, dt = np.zeros(batch), config.dt_s
    velocity = np.tile([0.0, speed], (batch, 1))
    position = np.zeros((batch, 2))
    navigator.place(position, heading, more.get("sigma_m", 30.0), 0.01)
    out: dict[str, list[Any]] = {"error": [], "level": [], "mode": [], "cases": []}
    for k in range(epochs):
        before, position = position, position + dt * velocity
        truth = truth_between((k + 1) * dt, dt, (before, position), (velocity, velocity), (heading, heading))
        solution = navigator.step(truth)
        out["error"].append(solution.position_en_m - position)
        out["level"].append(np.stack([solution.pl_ct_m, solution.pl_at_m], -1))
        out["mode"].append(solution.mode)
        out["cases"].append(solution.pl_cases_m)
    return {name: np.array(values) for name, values in out.items()}


def test_the_ionosphere_cancels_in_the_combination_of_both_bands() -> None:
    wavelength = WAVELENGTH_M[:, [0, 2]]
    share = band_shares(wavelength, combined=True)
    delay = 7.3 * (wavelength / wavelength[:, :1]) ** 2  # on each band
    np.testing.assert_allclose((share * delay).sum(-1), 0.0, atol=1e-9)
    np.testing.assert_allclose(share.sum(-1), 1.0, atol=1e-12)  # ranges stay as they are
    assert np.hypot(*share[System.GPS]) == pytest.approx(2.588, abs=1e-3)  # noise of L1/L5, 2.6 times
    assert band_shares(wavelength, combined=False).tolist() == [[1.0, 0.0]] * len(wavelength)


@pytest.mark.parametrize("service", ["dgps", "sbas_l1", "sbas_dfmc"])
def test_without_noise_and_residuals_a_corrected_position_is_exact(service: str) -> None:
    """Errors of metres are in the ranges; what the corrections cancel leaves no error but their age."""
    config = NavigatorConfig(service=service, **L1_L5).replace(gnss=NO_NOISE | NO_CLOCK)
    if service != "dgps":
        config = config.replace(gnss=NO_TROPO | {"broadcast": {**NO_CLOCK["broadcast"], "tropo_zenith_m": 0.0}})
    found = _drive(config, 3, 21, speed=0.0)
    own = found["mode"][5:] == int(SERVICES[service].mode)  # after the codes are acquired
    assert own.mean() > 0.5  # later positions replace the one at rest only where their level is lower
    assert np.abs(found["error"][5:]).max() < 2e-3  # 1e9 s of correlation leave 2e-4 in 6 s
    spp = _drive(config.replace(service=["spp"]), 3, 21, speed=0.0)
    assert np.abs(spp["error"][5:]).max() > 0.2


def test_an_error_of_one_satellite_moves_the_position_or_is_excluded() -> None:
    from lanebound.integrity.sensors.faults import Fault, FaultSchedule
    from lanebound.integrity.sky.track import SkyTrack
    from lanebound.integrity.sky.visibility import SkyMask

    config = NavigatorConfig(service="dgps").replace(gnss=NO_NOISE)
    track = SkyTrack.from_config(config.sky, 60.0)
    sky = track.at(track.start_s)
    high = int(sky.prn[(sky.system == int(System.GPS)) & (sky.elevation_rad[0] > 0.6)][0])
    errors = {}
    for size in (0.0, 2.0, 40.0):
        faults = [Fault.load({"kind": "satellite_range", "system": System.GPS, "prn": high, "magnitude_m": size,
                              "start_s": 0.0, "duration_s": 60.0})] if size else []  # fmt: skip
        navigator = Navigator(config, track, SkyMask.open(), [1], faults=FaultSchedule(faults))
        navigator.place(np.zeros((1, 2)), np.zeros(1), 30.0, 0.01)
        zero = np.zeros((1, 2))
        for k in range(11):
            truth = truth_between((k + 1) * 0.1, 0.1, (zero, zero), (zero, zero), (np.zeros(1), np.zeros(1)))
            solution = navigator.step(truth)
        errors[size] = float(np.hypot(*solution.position_en_m[0]))
        assert solution.pl_at_m[0] < np.inf
    assert errors[2.0] > errors[0.0] + 0.02  # below the thresholds it counts
    assert errors[40.0] == pytest.approx(errors[0.0], abs=0.05)  # excluded


def test_levels_of_code_services_hold_in_the_open_and_the_mode_is_reported() -> None:
    for service, worst in (("spp", 6.0), ("dgps", 1.5), ("sbas_l1", 3.0), ("sbas_dfmc", 3.0)):
        config = NavigatorConfig(service=service, **L1_L5)
        found = _drive(config, 24, 60)
        assert (np.abs(found["error"]) <= found["level"]).all(), service
        error = np.linalg.norm(found["error"], axis=-1)[20:]
        assert np.quantile(error, 0.95) < worst, service
        assert (found["mode"][5:] == int(SERVICES[service].mode)).mean() > 0.9, service
        assert np.median(found["level"]) < 30.0, service


def test_carrier_smoothing_makes_a_noisy_code_service_better() -> None:
    noisy = {"gnss": {"code_sigma_m": 1.0, "bands": [0, 2]}}
    config = NavigatorConfig(service="dgps").replace(**noisy)
    raw = _drive(config, 16, 400)
    smoothed = _drive(config.replace(services={"dgps": {"smoothing_s": 100.0}}), 16, 400)
    rms = [float(np.sqrt(np.mean(np.square(found["error"][300:])))) for found in (raw, smoothed)]
    assert rms[1] < 0.8 * rms[0]
    assert (np.abs(smoothed["error"]) <= smoothed["level"]).all()


def test_the_first_service_with_a_position_is_taken_and_rtk_where_it_is_fixed() -> None:
    config = NavigatorConfig(service=["rtk", "sbas_dfmc", "spp"], **L1_L5)
    found = _drive(config, 4, 100, sigma_m=30.0)
    assert (found["mode"][5] == int(Mode.SBAS_DFMC)).all()  # before the first fix is confirmed
    assert (found["mode"][-1] == int(Mode.RTK)).all()
    assert np.linalg.norm(found["error"][-1], axis=-1).max() < 0.1
    only = _drive(NavigatorConfig.preset("services/nrtk"), 2, 300)
    assert (only["mode"][50:] == int(Mode.NRTK)).mean() > 0.9  # fixed cold, but for single epochs


def test_a_service_without_corrections_gives_way_to_the_next() -> None:
    config = NavigatorConfig(service=["sbas_dfmc", "spp"], **L1_L5).replace(
        gnss={"augmentation": {"sbas_dfmc": {"delivery": "link"}, "warm": False}},
        corrections={"latency_s": 0.3, "outage_per_h": 1e5, "outage_median_s": 3600.0, "outage_max_s": 3600.0},
    )
    found = _drive(config, 4, 60)
    assert (found["mode"][-1] == int(Mode.SPP)).any()


def test_ppp_converges_in_the_open_and_again_after_an_outage() -> None:
    """At 1 Hz. Each satellite that was lost begins anew, and so does the position after an underpass of all."""
    config = NavigatorConfig(service=["ppp", "sbas_dfmc"], dt_s=1.0, **L1_L5)
    config = config.replace(services={"ppp": {"errors": {"reflections_m": 0.0}}})  # they would not average at rest
    navigator = Navigator.nominal(config, seeds=list(range(12)), duration_s=2200.0)
    zero, still = np.zeros((12, 2)), np.zeros(12)
    navigator.place(zero, still, 30.0, 0.01)
    errors, levels, modes = [], [], []
    for k in range(2000):
        truth = truth_between(k + 1.0, 1.0, (zero, zero), (zero, zero), (still, still))
        m = navigator.measure(truth)
        if k == 1900:  # every carrier loses lock at once
            m.gnss.lock_lost[:] = True
        solution = navigator.locate(m)
        errors.append(solution.position_en_m.copy())
        levels.append(np.stack([solution.pl_ct_m, solution.pl_at_m], -1))
        modes.append(solution.mode.copy())
    error, level = np.array(errors), np.array(levels)
    spread = np.sqrt(np.mean(np.square(error), (1, 2)))
    assert spread[1800] < 0.1  # after 30 min, S2 Table 1 and section 6
    assert spread[1800] < 0.5 * spread[20]
    assert (np.array(modes)[1700:1800] == int(Mode.PPP)).mean() > 0.5  # else a lower level is moved on by Doppler
    assert np.median(level[1800]) < 0.8 * np.median(level[60])
    assert (np.abs(error) <= level).all()
    assert np.median(level[1905:1950]) >= np.median(level[1899])


def test_the_zenith_delay_of_an_epoch_is_found_exactly() -> None:
    rng = np.random.default_rng(3)
    elevation, azimuth = np.deg2rad(rng.uniform(10, 85, 14)), rng.uniform(0, 2 * np.pi, 14)
    los = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    system, used = np.arange(14) % 2, np.ones(14, bool)
    slant = np.array([troposphere_slant(s) for s in los[:, 2]])
    y = -los @ np.array([3.0, -2.0, 1.0]) + 0.123 * slant + np.where(system == 0, 50.0, -20.0)
    variance = rng.uniform(0.5, 2.0, 14)
    found, value, spread = zenith_of_epoch(rows_of(los, system, used, variance, y))
    assert found
    assert value == pytest.approx(0.123, abs=1e-9)
    design = np.column_stack([-los, slant, system == 0, system == 1])
    cofactor = np.linalg.inv(design.T @ (design / variance[:, None]))
    assert spread == pytest.approx(cofactor[3, 3], rel=1e-9)


def test_a_vehicle_does_not_depend_on_the_batch_and_goes_on_from_a_snapshot() -> None:
    config = NavigatorConfig(service=["sbas_l1", "spp"], **L1_L5)
    many, one = _drive(config, 5, 30), _drive(config, 1, 30)
    for name, values in one.items():
        np.testing.assert_array_equal(values[:, 0], many[name][:, 0], err_msg=name)


def test_what_cannot_be_is_refused() -> None:
    for given, message in (
        ({"service": "wifi"}, "service must be among rtk, nrtk, .*, spp, got 'wifi'"),
        ({"service": 5}, r"^service must be a name or a list of names, got 5: write spp, or \[rtk, spp\]"),
        ({"service": {"spp": 1}}, "^service must be a name or a list of names, got"),
        ({"service": ["spp", "spp"]}, "name each one once"),
        ({"service": ["spp", "rtk"]}, "rtk or nrtk first"),
        ({"service": "sbas_dfmc", "gnss": {"bands": [0]}}, "gnss.bands must have 2 .L5. as its second band"),
        ({"services": {"spp": {"systems": ["LORAN"]}}}, "got 'LORAN'"),
    ):
        with pytest.raises(ConfigError, match=message):
            NavigatorConfig.load(given)
    plain = NavigatorConfig()
    assert plain.service == ("rtk",)
    assert plain.receiver is plain.gnss  # nothing more is simulated


def test_a_drift_watch_whose_alarms_do_nothing_is_refused():
    with pytest.raises(ConfigError, match=r"jump_quarantine_s must be larger than 0 with the drift watch, got 0"):
        NavigatorConfig.load({"positioning": {"rtk": {"jump_quarantine_s": 0.0, "drift": {"window_s": 16.0}}}})


def _takes(level: float, reckoned: float, latest: Mode, found_before: float = np.inf, preference: float = 2.0) -> bool:
    """Whether DFMC of [ppp, sbas_dfmc, spp] takes a position, with levels [m] of the same size on both axes."""
    config = NavigatorConfig.preset("services/ppp").replace(services={"preference": preference})
    system = np.array([0, 1], np.int64)
    service = service_tables(config, SERVICES["sbas_dfmc"], system)  # type: ignore[arg-type]
    assert service.later.tolist() == [int(Mode.SPP)]
    work = records_of(SERVICE_WORK, 1, least=2.0 * found_before**2)
    labels = records_of(SERVICE_LABEL, 1, latest=int(latest))
    rows = ServiceRows(np.zeros((1, 2), ROW), np.zeros((1, 2), PART), work, labels)
    taken = takes(0, np.full((1, 2), level), np.full((1, 2), reckoned), service, rows)
    assert work["least"][0] == pytest.approx(2.0 * min(level, found_before) ** 2)
    return bool(taken)


def test_a_more_preferred_service_is_taken_up_to_twice_the_level_and_no_further() -> None:
    assert _takes(5.0, 6.0, Mode.SBAS_DFMC)
    assert not _takes(6.0, 5.0, Mode.SBAS_DFMC)  # its own position, moved on, is better
    assert not _takes(6.0, 5.0, Mode.DOPPLER)
    assert _takes(6.0, 5.0, Mode.SPP)  # that of SPP, moved on
    assert not _takes(11.0, 5.0, Mode.SPP)
    assert not _takes(6.0, 5.0, Mode.SPP, preference=1.0)
    assert not _takes(5.0, 30.0, Mode.PPP, found_before=8.0)  # PPP has found a position in this epoch
    assert _takes(5.0, 30.0, Mode.PPP, found_before=11.0)
    assert _takes(5.0, np.inf, Mode.PPP)


def test_ppp_on_l1_and_l2_positions_as_well() -> None:
    """The bands of the default receiver are free of the ionosphere together, too."""
    found = _drive(NavigatorConfig(service="ppp"), 4, 200, sigma_m=10.0)
    assert (found["mode"][20:] == int(Mode.PPP)).mean() > 0.9
    assert (np.abs(found["error"]) <= found["level"]).all()
    assert np.sqrt(np.mean(np.square(found["error"][100:]))) < 0.5
