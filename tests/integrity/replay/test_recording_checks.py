"""Segments and drives with sensors in other units, on other axes, mirrored, late or with gaps."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.recorded.comma import Comma, ReceiverFixes, Reference, Series, read_comma
from lanebound.integrity.recorded.smartloc import GroundTruth, Odometry, SmartLoc, read_smartloc
from lanebound.integrity.recorded.source import in_order
from lanebound.integrity.replay.outages import OutageConfig, motion_of, run_outages, write_outages
from lanebound.integrity.replay.sensor_checks import aligned_comma, check_comma, check_smartloc

HOME = ecef_from_geodetic(np.radians(52.5), np.radians(13.37), 80.0)
AXES = ecef_from_enu_matrix(np.radians(52.5), np.radians(13.37))
DEG_M = 111_300.0


def _way(time: np.ndarray) -> dict[str, np.ndarray]:
    """A car with bends and changing speed at times (T,), integrated from 0 every millisecond."""
    fine = np.arange(-5.0, time[-1] + 5.0, 1e-3)
    speed = 11.0 + 4.0 * np.sin(0.35 * fine)
    rate = np.radians(14.0) * np.sin(0.4 * fine) * np.sin(0.09 * fine)
    course = 0.6 + np.cumsum(rate) * 1e-3
    place = np.cumsum(speed[:, None] * np.stack([np.sin(course), np.cos(course)], -1), 0) * 1e-3
    columns = {"speed": speed, "rate": rate, "course": course, "ahead": np.gradient(speed, 1e-3),
               "east": place[:, 0], "north": place[:, 1]}  # fmt: skip
    return {name: np.interp(time, fine, column) for name, column in columns.items()}


def _series(name: str, rate_hz: float, values) -> Series:
    time = np.arange(0.0, 60.0, 1.0 / rate_hz)
    return Series(time, values(_way(time)), in_order(name, time)[1])


def segment() -> Comma:
    time, fixed = np.arange(0.0, 60.0, 0.05), np.arange(0.0, 60.0, 0.1)
    way, at = _way(time), _way(fixed)
    flat = np.stack([way["east"], way["north"], 0.0 * time], -1)
    velocity = way["speed"][:, None] * np.stack([np.sin(way["course"]), np.cos(way["course"]), 0.0 * time], -1)
    reference = Reference(time, HOME + flat @ AXES.T, velocity @ AXES.T, np.tile([1.0, 0.0, 0.0, 0.0], (time.size, 1)))
    return Comma(
        reference, _series("CAN/speed/t", 80.0, lambda w: w["speed"]),
        _series("CAN/wheel_speed/t", 80.0, lambda w: np.stack(4 * [w["speed"]], -1)),
        _series("IMU/accelerometer/t", 100.0,
                lambda w: np.stack([w["ahead"], w["speed"] * w["rate"], 0 * w["rate"] - 9.8], -1)),
        _series("IMU/gyro/t", 100.0, lambda w: np.stack([0 * w["rate"], 0 * w["rate"], w["rate"]], -1)),
        ReceiverFixes(fixed, 52.5 + at["north"] / DEG_M, 13.37 + at["east"] / DEG_M / np.cos(np.radians(52.5)),
                      at["speed"], np.degrees(at["course"]) % 360.0),
    )  # fmt: skip


def changed(s: Comma, name: str, **new) -> Comma:
    return replace(s, **{name: replace(getattr(s, name), **new)})


def test_sane_sensors_agree_with_slopes_near_one() -> None:
    found = check_comma(segment())
    assert set(found) >= {"CAN/speed 0", "CAN/wheel_speed 3", "yaw rate", "forward acceleration", "receiver speed"}
    assert all(of.tested and of.slope == pytest.approx(1.0, abs=0.02) for of in found.values())


@pytest.mark.parametrize(("name", "change", "message"), [
    ("speed", lambda v: 3.6 * v, "speed of CAN/speed .* slope on it is 3.6 .*probably in km/h"),
    ("speed", lambda v: 1e3 * v, "probably in mm/s"),
    ("wheel_speed", lambda v: v * [1.0, 1.0, 2.23694, 1.0], "CAN/wheel_speed .*probably in mph"),
    ("speed", lambda v: -v, "its sign is reversed"),
    ("speed", lambda v: 0.0 * v, "without a signal"),
    ("rotation_rate", np.degrees, "yaw rate of IMU/gyro .*probably in deg/s, not in rad/s"),
    ("rotation_rate", lambda v: -v, "its sign is reversed"),
    ("rotation_rate", lambda v: v[:, [2, 1, 0]], "yaw rate of IMU/gyro must change .* keeps one value, 0, for"),
    ("speed", lambda v: v * np.where(np.arange(len(v)) > 2400, 1.25, 1.0), r"scale of CAN/speed .* 1\.00 .* 1\.25 "),
    ("wheel_speed", lambda v: np.where(np.arange(len(v))[:, None] // 960 == 2, 0.0, v), "wheel_speed .* one value, 0,"),
    ("wheel_speed", lambda v: np.where(np.arange(len(v))[:, None] // 960 == 2, 9.0, v), "wheel_speed .* one value, 9,"),
    ("acceleration", lambda v: v / 9.80665, "feel gravity in m/s.2, its mean is 1: it is probably in g"),
    ("acceleration", lambda v: v * [1.0, -1.0, -1.0], "axes forward, right, down"),
    ("acceleration", lambda v: v * [-1.0, 1.0, 1.0], "acceleration of IMU/accelerometer .*its sign is reversed"),
])  # fmt: skip
def test_sensors_of_a_segment_that_contradict_its_reference(name: str, change, message: str) -> None:
    sane = segment()
    with pytest.raises(InputError, match=message):
        check_comma(changed(sane, name, value=change(getattr(sane, name).value)))


def test_a_velocity_of_the_reference_in_another_unit_is_named() -> None:
    sane = segment()
    for factor, likely in ((3.6, "km/h"), (100.0, "cm/s")):
        with pytest.raises(InputError, match=f"global_pose/frame_velocities .*probably in {likely}"):
            check_comma(changed(sane, "reference", velocity_ecef_mps=factor * sane.reference.velocity_ecef_mps))


@pytest.mark.parametrize(("column", "change", "message"), [
    ("latitude_deg", np.radians, "are probably of another drive"),
    ("course_deg", np.radians, "probably in radians"),
    ("course_deg", lambda v: 90.0 - v, "probably counterclockwise from East"),
    ("course_deg", lambda v: -v, "probably counterclockwise from North"),
    ("course_deg", lambda v: v + 180.0, "probably of the opposite direction"),
    ("speed_mps", lambda v: 3.6 * v, "speed of GNSS/live_gnss_ublox .*probably in km/h"),
])  # fmt: skip
def test_fixes_that_contradict_the_reference(column: str, change, message: str) -> None:
    sane = segment()
    with pytest.raises(InputError, match=message):
        check_comma(changed(sane, "fixes", **{column: change(getattr(sane.fixes, column))}))


def test_times_in_ms_of_another_clock_or_scale_are_named(tmp_path: Path) -> None:
    sane = segment()
    assert sane.fixes is not None
    with pytest.raises(InputError, match=r"times of GNSS/live_gnss_ublox .* must agree .* with times -9\.0 s later"):
        check_comma(changed(sane, "fixes", time_s=sane.fixes.time_s + 9.0))
    with pytest.raises(InputError, match=r"times of IMU/gyro must be those of the reference, 0\.4 to 59\..* one clock"):
        check_comma(changed(sane, "rotation_rate", time_s=sane.rotation_rate.time_s + 1e4))
    for name in ("rotation_rate", "reference"):
        late = changed(sane, name, time_s=1e3 * getattr(sane, name).time_s)
        with pytest.raises(InputError, match=r"must be in s, most rows are \d+ s apart: are they in ms\?"):
            read_comma(_saved(tmp_path / name, late))


def test_fixes_in_radians_or_exchanged_are_named() -> None:
    sane = segment()
    f = sane.fixes
    for new, message in (
        ({"latitude_deg": np.radians(f.latitude_deg), "longitude_deg": np.radians(f.longitude_deg)}, "in radians"),
        ({"latitude_deg": f.longitude_deg, "longitude_deg": f.latitude_deg}, "exchanged"),
    ):
        with pytest.raises(InputError, match=f"positions are .* m from the reference .*: they are probably {message}"):
            check_comma(changed(sane, "fixes", **new))


def test_a_reference_in_kilometres_and_a_gyro_that_is_always_0_are_named() -> None:
    sane = segment()
    with pytest.raises(InputError, match=r"global_pose/frame_positions must be ECEF positions in m, .*, got 63\d\d"):
        check_comma(changed(sane, "reference", position_ecef_m=1e-3 * sane.reference.position_ecef_m))
    with pytest.raises(InputError, match=r"keeps one value, 0, for 60\.0 s .* without a signal"):
        check_comma(changed(sane, "rotation_rate", value=0.0 * sane.rotation_rate.value))


def test_a_sensor_that_is_a_second_late_is_refused() -> None:
    sane = segment()
    for name in ("speed", "rotation_rate"):
        with pytest.raises(InputError, match=r"clocks of .* must agree within 0.5 s, .*\+1\.\d+ s later"):
            check_comma(changed(sane, name, time_s=getattr(sane, name).time_s + 1.0))


def test_a_lag_that_the_drive_shows_is_taken_out_and_one_that_it_does_not_is_not_tested() -> None:
    sane = segment()
    late = changed(changed(sane, "speed", time_s=sane.speed.time_s + 0.3), "rotation_rate",
                   time_s=sane.rotation_rate.time_s - 0.2)  # fmt: skip
    aligned, found = aligned_comma(late)
    assert (found["CAN/speed 0"].lag_s, found["yaw rate"].lag_s) == pytest.approx((0.3, -0.2), abs=0.02)
    assert found["yaw rate"].corrected
    for name in ("speed", "rotation_rate"):
        np.testing.assert_allclose(getattr(aligned, name).time_s, getattr(sane, name).time_s, atol=0.02)
    slipping, found = aligned_comma(changed(sane, "speed", time_s=sane.speed.time_s - 0.05))
    assert found["CAN/speed 0"].lag_s == pytest.approx(-0.05, abs=0.011)
    np.testing.assert_array_equal(slipping.speed.time_s, sane.speed.time_s - 0.05)
    turn = sane.rotation_rate.value * [1.0, 1.0, 0.0] + np.random.default_rng(3).normal(0.0, 1e-3, (6000, 3))
    place = HOME + (sane.speed.time_s[::4, None] * [[0.0, 11.0, 0.0]]) @ AXES.T
    straight = changed(
        changed(sane, "rotation_rate", value=turn), "reference", position_ecef_m=place,
        velocity_ecef_mps=np.tile([0.0, 11.0, 0.0], (1200, 1)) @ AXES.T,
    )  # fmt: skip
    still = np.random.default_rng(3).normal(11.0, 0.01, 4800)
    straight = changed(changed(straight, "speed", value=still), "wheel_speed", value=np.tile(still[:, None], 4))
    aligned, found = aligned_comma(replace(straight, fixes=None))
    assert found["yaw rate"].lag_s is found["CAN/speed 0"].lag_s is None
    assert aligned.speed is straight.speed


def _saved(folder: Path, s: Comma) -> Path:
    arrays = {
        "global_pose/frame_times": s.reference.time_s, "global_pose/frame_positions": s.reference.position_ecef_m,
        "global_pose/frame_velocities": s.reference.velocity_ecef_mps,
        "global_pose/frame_orientations": s.reference.quaternion,
    }  # fmt: skip
    for name, series in (("CAN/speed", s.speed), ("CAN/wheel_speed", s.wheel_speed),
                         ("IMU/accelerometer", s.acceleration), ("IMU/gyro", s.rotation_rate)):  # fmt: skip
        arrays |= {f"{name}/t": series.time_s, f"{name}/value": series.value}
    for name, array in arrays.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        np.save(folder / f"{name}.npy", array)
    return folder


def test_outages_at_a_gap_are_left_out_and_counted(tmp_path: Path) -> None:
    sane = segment()
    config = OutageConfig(longest_s=10.0)
    whole = run_outages(motion_of(read_comma(_saved(tmp_path / "whole", sane)), config)[0], config)
    keep = (sane.speed.time_s < 30.0) | (sane.speed.time_s > 36.0)
    holed = changed(sane, "speed", time_s=sane.speed.time_s[keep], value=sane.speed.value[keep])
    found, _ = write_outages(_saved(tmp_path / "holed", holed), tmp_path / "out", config)
    touching = (whole.start_s > 20.0 - 0.11) & (whole.start_s < 36.0 + 0.11)
    assert found["left_out_at_gaps"] == touching.sum()
    assert found["outages"] == whole.start_s.size - touching.sum()
    assert found["stopped"] == {"CAN/speed/t": "1 gap, the longest of 6.03 s"}
    assert [found["all_ages"][axis]["exceeded"] for axis in ("at", "ct")] == [0, 0]
    with pytest.raises(InputError, match=r"first 35 s must be without gaps, 1 gap, the longest of 6.03 s"):
        write_outages(tmp_path / "holed", tmp_path / "out", config.replace(calibration_s=35.0))


@pytest.mark.parametrize(("name", "wrong"), [
    ("rotation_rate", lambda s: s.value + np.where(s.time_s > 25.0, np.radians(2.0), 0.0)[:, None]),
    ("speed", lambda s: s.value * np.where(s.time_s > 25.0, 1.2, 1.0)),
])  # fmt: skip
def test_errors_far_beyond_the_declared_ones_are_doubted(tmp_path: Path, name: str, wrong) -> None:
    sane, config = segment(), OutageConfig(longest_s=10.0)
    found, _ = write_outages(_saved(tmp_path / "sane", sane), tmp_path / "out", config)
    assert found["doubt"] is None
    series = getattr(sane, name)
    bad = changed(sane, name, value=wrong(series))
    found, _ = write_outages(_saved(tmp_path / "bad", bad), tmp_path / "out", config)
    assert re.match(
        r"errors exceed their levels in \d\d of \d\d outages, at a risk of 0\.001: the recording", found["doubt"]
    )


def test_a_jump_of_half_a_second_is_told_and_a_clock_that_is_set_back_refused(tmp_path: Path) -> None:
    sane, config = segment(), OutageConfig(longest_s=10.0)
    time = sane.rotation_rate.time_s
    jumped = changed(sane, "rotation_rate", time_s=time + 0.5 * (time > 57.0))
    found, _ = write_outages(_saved(tmp_path / "jump", jumped), tmp_path / "out", config)
    assert found["stopped"] == {"IMU/gyro/t": "1 gap, the longest of 0.51 s"}
    back = changed(sane, "speed", time_s=sane.speed.time_s - 5.0037 * (sane.speed.time_s > 57.0))
    with pytest.raises(InputError, match=r"CAN/speed/t must have times that increase, 2\d\d of 4800 rows go back"):
        read_comma(_saved(tmp_path / "back", back))


def drive() -> SmartLoc:
    time = np.arange(0.0, 100.0, 0.2)
    way = _way(time)
    flat = np.stack([way["east"], way["north"], 0.0 * time], -1)
    none = np.zeros(time.size)
    return SmartLoc(
        None, Odometry(time, way["speed"], -way["rate"], none, none), GroundTruth(time, HOME + flat @ AXES.T), None
    )  # type: ignore[arg-type]  # codes are not looked at


@pytest.mark.parametrize(("new", "message"), [
    ({"speed_mps": lambda o: 3.6 * o.speed_mps}, "speed of odom3 .*probably in km/h"),
    ({"yaw_rate_left_radps": lambda o: -o.yaw_rate_left_radps}, "yaw rate of odom3 .*its sign is reversed"),
    ({"yaw_rate_left_radps": lambda o: np.degrees(o.yaw_rate_left_radps)}, "probably in deg/s, not in rad/s"),
    ({"speed_mps": lambda o: np.where(o.time_s // 12.0 == 3.0, 7.0, o.speed_mps)}, r"odom3 .* one value, 7, for 11"),
    ({"yaw_rate_left_radps": lambda o: np.where(o.time_s // 12.0 == 3.0, 0.1, o.yaw_rate_left_radps)},
     "yaw rate of odom3 .* one value, -0.1, for 11.* from 36.0 s on: the sensor was frozen"),
    ({"time_s": lambda o: o.time_s + 2.0}, r"clocks of odom3 .*\+2\.0\d s later"),
])  # fmt: skip
def test_wheels_and_gyro_of_a_smartloc_drive(new, message: str) -> None:
    sane = drive()
    assert all(of.tested and of.slope == pytest.approx(1.0, abs=0.03) for of in check_smartloc(sane).values())
    values = {name: change(sane.odometry) for name, change in new.items()}
    with pytest.raises(InputError, match=message):
        check_smartloc(replace(sane, odometry=replace(sane.odometry, **values)))
    assert check_smartloc(replace(sane, truth=None)) == {}
    assert sane.truth is not None
    with pytest.raises(InputError, match=r"point3 must be ECEF positions in m, .*, got 63\d\d"):
        check_smartloc(replace(sane, truth=replace(sane.truth, position_ecef_m=1e-3 * sane.truth.position_ecef_m)))


def test_rows_of_a_drive_that_go_back_are_counted(tmp_path: Path) -> None:
    lines = [f"odom3 {0.2 * k:.1f} 5.0 0 0 0 0 -0.01 1 1 1 1 1 1" for k in range(40)]
    codes = [f"pseudorange3 {0.2 * k:.1f} 2e7 25 14567933.9 2809850.9 21875628.0 {n} 1 45.0 49"
             for k in range(40) for n in (1, 2)]  # fmt: skip
    lines.insert(20, lines[10])
    path = tmp_path / "drive.txt"
    path.write_text("\r\n".join([*lines[:30], *lines[36:], *codes, ""]))
    found = read_smartloc(path)
    assert found.odometry.time_s.size == 34
    assert found.notes == {"odom3": "1 of 35 rows left out that repeat another; 1 gap, the longest of 1.40 s"}
    assert found.bridged(np.array([5.5, 6.5]), after_s=0.1).tolist() == [False, True]
