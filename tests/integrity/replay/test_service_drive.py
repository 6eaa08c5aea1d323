"""Recorded drives on a positioning service: an exact drive by hand, what is refused, and real recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recordings import real

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.smartloc import Odometry
from lanebound.integrity.replay.datasets import replay_folder
from lanebound.integrity.replay.service_drive import (
    ServiceDrive,
    config_of,
    drive_service,
    require_possible,
    status_of,
    summarise_service,
)
from lanebound.integrity.replay.service_epochs import ServiceEpochs, StationCorrections
from lanebound.integrity.sky.systems import System

DT_S = 0.1


def _bend(time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position (T, 2) and heading (T,) of a car that drives East and then North, at 8 m/s."""
    heading = np.interp(time_s, [0.0, 20.0, 24.0, 60.0], [0.5 * np.pi, 0.5 * np.pi, 0.0, 0.0])
    fine = np.linspace(0.0, time_s[-1], 20_001)
    course = np.interp(fine, time_s, heading)
    steps = 8.0 * np.diff(fine)[:, None] * np.stack([np.sin(course[1:]), np.cos(course[1:])], -1)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.stack([np.interp(time_s, fine, path[:, k]) for k in range(2)], -1), heading


def _recording(noise_m: float = 0.0, carrier: bool = False, odometry: bool = True) -> ServiceEpochs:
    """30 s at 5 Hz, 16 strong satellites of two systems."""
    rng = np.random.default_rng(5)
    time = np.round(np.arange(0.0, 30.0, 0.2), 3)
    place, heading = _bend(time)
    azimuth, elevation = np.linspace(0.0, 5.5, 16), np.deg2rad(np.tile([20.0, 45.0, 70.0, 30.0], 4))
    los = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], -1)
    system = np.tile([int(System.GPS), int(System.GALILEO)], 8)
    clean = 77.0 - place @ los[:, :2].T + np.where(system == int(System.GPS), 0.0, 12.0)
    shape = clean.shape
    code = clean + noise_m * rng.standard_normal(shape)
    rate = -np.gradient(heading, time)  # positive to the left
    one = np.ones(time.size)
    return ServiceEpochs(
        time_s=time, system=system, prn=np.arange(1, 17), los_enu=np.tile(los, (time.size, 1, 1)),
        tracked=np.ones(shape, bool), cn0_dbhz=np.tile(38.0 + 10.0 * np.sin(elevation), (time.size, 1)),
        code_m=code, phase_m=clean + 3.0 if carrier else np.zeros(shape), lost=np.zeros(shape, bool),
        odometry=Odometry(time, 8.0 * one, rate, one, one) if odometry else None, station=None, rough_en_m=place,
        truth_enu_m=np.column_stack([place, 0.0 * time]), known=np.ones(time.size, bool), reference="by hand",
    )  # fmt: skip


def _driven(epochs: ServiceEpochs, names: list[str], **changes: Any) -> ServiceDrive:
    return drive_service(epochs, config_of(epochs, names, DT_S if epochs.odometry else 0.2, changes))


def test_a_drive_without_errors_is_followed_and_its_heading_is_found() -> None:
    drive = _driven(_recording(), ["spp"])
    assert (drive.epoch >= 0).sum() == 150
    assert 3.0 < drive.begun_s < 8.0  # 30 m of path, and the next position
    record, errors = drive.record(), np.hypot(*drive.errors_en_m().T)
    assert errors.max() < 0.3  # yaw rates of 0.2 s blur the corner
    true = _bend(drive.time_s[drive.judged])[1]
    assert np.rad2deg(np.abs(drive.heading_rad[drive.judged] - true)).max() < 3.0
    assert (record.error("ct") <= record.pl("ct")).all()
    assert np.median(record.pl("ct")) < 40.0
    assert (drive.mode[-20:] == Mode.SPP).all()


def test_carriers_make_noisy_codes_smooth_and_odometry_bridges_a_loss_of_all_signals() -> None:
    noisy = _recording(noise_m=2.0, carrier=True, odometry=False)
    rms = [
        float(np.sqrt(np.mean(np.square(_driven(noisy, ["spp"], services={"spp": {"smoothing_s": s}}).errors_en_m()))))
        for s in (0.0, 100.0)
    ]
    assert rms[1] < 0.6 * rms[0]
    lost = _recording()
    gone = lost.tracked & ((lost.time_s < 20.0) | (lost.time_s > 26.0))[:, None]
    drive = _driven(replace(lost, tracked=gone), ["spp"])
    within = (drive.time_s > 22.0) & (drive.time_s < 26.0) & (drive.epoch >= 0)
    assert (drive.mode[within] == Mode.IMU_ODOMETER).all()
    assert np.isfinite(drive.pl_m[within]).all()
    assert np.hypot(*drive.errors_en_m().T).max() < 1.0


def test_without_wheels_nothing_lies_between_positions() -> None:
    alone = _recording(odometry=False)
    gone = alone.tracked & (alone.time_s < 20.0)[:, None]
    drive = _driven(replace(alone, tracked=gone), ["spp"])
    assert (drive.mode[drive.time_s < 19.0] == Mode.SPP).all()
    after = drive.time_s > 20.5
    assert np.isinf(drive.pl_m[after]).all()  # the position stays, without a level


def test_corrections_of_a_station_take_common_errors_away() -> None:
    plain = _recording(odometry=False)
    wrong = 4.0 * np.sin(np.arange(16.0))
    bad = replace(plain, code_m=plain.code_m + wrong)
    found = StationCorrections(np.tile(wrong + 50.0, (150, 1)), np.ones((150, 16), bool), np.zeros(150))
    drive = _driven(replace(bad, station=found), ["dgps"])
    assert np.hypot(*drive.errors_en_m().T).max() < 1e-3
    assert (drive.mode == Mode.DGPS).all()
    old = _driven(replace(bad, station=replace(found, age_s=np.full(150, 40.0))), ["dgps"])
    assert (old.mode == Mode.NONE).all()  # older than services.dgps.max_age_s


def test_a_position_whose_risk_is_too_large_is_kept_without_a_level() -> None:
    """A fault of all Galileo satellites leaves too few GPS satellites: no level, but the position is judged."""
    plain = _recording(odometry=False)
    gps = np.flatnonzero(plain.system == int(System.GPS))
    tracked = plain.tracked.copy()
    tracked[:, gps[3:]] = False
    drive = _driven(replace(plain, tracked=tracked), ["spp"])
    assert (drive.mode == Mode.SPP).all()
    assert np.isinf(drive.pl_m).any(-1).all()
    assert np.hypot(*drive.errors_en_m().T).max() < 1e-3
    assert not drive.available.any()
    assert drive.alert.all()
    found = summarise_service(drive)
    assert (found["no_level"], found["no_position"], found["judged"]) == (1.0, 0.0, 150)
    assert {status_of(drive, n) for n in range(150)} == {"no level"}
    dark = _driven(replace(plain, tracked=tracked & (plain.time_s < 10.0)[:, None]), ["spp"])
    assert summarise_service(dark)["no_position"] == pytest.approx(2.0 / 3.0, abs=0.02)


@pytest.mark.parametrize(
    ("names", "station", "message"),
    [
        (["wifi"], True, "service must be among rtk, nrtk"),
        (["sbas_l1"], True, "needs messages of SBAS satellites, which a test does not hold"),
        (["spp", "ppp"], True, "needs precise orbits and clocks"),
        (["nrtk"], True, "needs a virtual station"),
        (["dgps"], False, "needs the observations of a base"),
        (["rtk"], True, "leave it out"),
    ],
)
def test_a_service_that_the_recording_cannot_serve_is_refused(names: list[str], station: bool, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        require_possible(names, station, "a test")


def test_what_would_silently_do_nothing_is_refused() -> None:
    epochs = _recording()
    with pytest.raises(ConfigError, match=r"services\.spp\.smoothing_s must be 0 where no carrier .*, got 100"):
        config_of(epochs, ["spp"], DT_S, {"services": {"spp": {"smoothing_s": 100.0}}})
    with pytest.raises(ConfigError, match=r"services\.dgps must be of a service that is used, spp: add dgps to --serv"):
        config_of(epochs, ["spp"], DT_S, {"services": {"dgps": {"max_hdop": 3.0}}})
    assert config_of(epochs, ["spp"], DT_S, {"services": {"preference": 3.0}}).services.preference == 3.0
    with pytest.raises(InputError, match=r"dt_s must divide the time between epochs, got 0\.3 s"):
        drive_service(epochs, config_of(epochs, ["spp"], 0.3))
    with pytest.raises(InputError, match="has none: give its truth"):
        _driven(replace(epochs, known=np.zeros(150, bool)), ["spp"]).record()


def test_services_keep_their_declared_errors_where_a_recording_changes_one_of_them() -> None:
    epochs = _recording(odometry=False)
    config = config_of(epochs, ["spp"], 0.2, {"services": {"spp": {"elevation_mask_deg": 15.0}}})
    assert config.services.spp.errors == RtkReckoningConfig().services.spp.errors
    assert config.services.spp.interval_s == 0.0


def test_a_car_in_berlin_on_single_point_positioning(tmp_path: Any) -> None:
    found, written = replay_folder(real("smartloc_berlin_potsdamer"), tmp_path, service=["spp"])
    assert found["recording"] == "smartloc"
    assert found["epochs"] == 724
    assert found["judged"] > 300
    assert found["horizontal"]["p95_m"] < 60.0
    assert {path.name for path in written} == {"service.json", "service.csv", "series.png"}
    assert found["at"]["exceeded"] <= 0.01 * found["judged"]
    with pytest.raises(InputError, match="satellite positions"):
        replay_folder(real("comma2k19_segment40"), tmp_path, service=["spp"])


def test_a_car_with_a_station_five_kilometres_away(tmp_path: Any) -> None:
    """Codes of a car on loops against its fixed RTK positions, with the corrections of the base and without."""
    folder = real("rtk_cssrlib_4p7km_doy265")
    plain, _ = replay_folder(folder, tmp_path, {"risk": {"integrity_risk": 1e-3}}, service=["spp"])
    smooth = {"services": {"dgps": {"smoothing_s": 100.0}}}
    corrected, _ = replay_folder(folder, tmp_path, service=["dgps"])
    smoothed, _ = replay_folder(folder, tmp_path, smooth, service=["dgps"])
    assert plain["judged"] > 350
    assert 0.5 < plain["horizontal"]["p95_m"] < 6.0  # S2 table 1: 1 to 6 m
    assert corrected["horizontal"]["p95_m"] < 1.0
    assert smoothed["horizontal"]["median_m"] < 0.6 * corrected["horizontal"]["median_m"]
    for found in (plain, corrected, smoothed):
        assert found["at"]["exceeded"] == found["ct"]["exceeded"] == 0
