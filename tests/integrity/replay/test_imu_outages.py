"""Inertial outages of a recorded drive: a drive written here with a known mount, lag, biases and hills."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.recorded.imu_log import G_MPS2, read_imu_log, read_solution_track
from lanebound.integrity.replay.datasets import kind_of, replay_folder
from lanebound.integrity.replay.imu_outages import ImuOutageConfig, motion_of_log, run_inertial_outages

START = 1_751_999_658.0
ROLL, PITCH, AZIMUTH = np.deg2rad([2.0, -4.0, 170.0]).tolist()
LAG_S = 0.12
HOME = np.deg2rad([40.0966, -105.1474]), 1600.0


def _drive(length_s: float, jump_mps2: float = 0.0) -> dict[str, np.ndarray]:
    """100 Hz: 8 s at rest, then speeds of 5 to 13 m/s, bends and hills; the last third has a jump of the force."""
    t = np.arange(0.0, length_s, 0.01)
    on = np.clip((t - 8.0) / 4.0, 0.0, 1.0)
    speed = on * (9.0 + 4.0 * np.sin(0.35 * (t - 8.0)))
    yaw = on * np.deg2rad(12.0) * np.sin(0.21 * t) * (np.sin(0.05 * t) > -0.3)
    heading = 0.7 + np.concatenate([[0.0], np.cumsum(0.01 * yaw)[:-1]])
    slope = on * np.deg2rad(3.0) * np.sin(0.1 * t)
    east = np.concatenate([[0.0], np.cumsum(0.01 * speed * np.sin(heading))[:-1]])
    north = np.concatenate([[0.0], np.cumsum(0.01 * speed * np.cos(heading))[:-1]])
    force = np.stack([np.gradient(speed, t) + G_MPS2 * np.sin(slope), speed * yaw, -G_MPS2 * np.cos(slope)], -1)
    force[:, 0] += 0.05 + jump_mps2 * (t > length_s * 2 / 3)
    rate = np.stack([0.0 * t, np.gradient(slope, t), yaw], -1) + np.deg2rad([0.3, -0.2, 0.25])
    return {"t": t, "speed": speed, "heading": heading, "east": east, "north": north, "force": force, "rate": rate}


def _write(folder: Path, length_s: float = 180.0, end: str = "\n", **given: float) -> Path:
    """The files of a drive; the sensor's x axis points backward, and its time stamps are late by ``LAG_S``."""
    d, rng = _drive(length_s, **given), np.random.default_rng(5)
    (cr, sr), (cp, sp), (ca, sa) = ((np.cos(a), np.sin(a)) for a in (ROLL, PITCH, AZIMUTH))
    tilt = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])  # sensor to level
    turn = np.array([[ca, -sa, 0.0], [sa, ca, 0.0], [0.0, 0.0, 1.0]])  # level axes of the sensor to the vehicle
    sign = np.array([1.0, -1.0, -1.0])
    force = sign * (d["force"] @ turn @ tilt) / G_MPS2 + 2e-3 * rng.standard_normal(d["force"].shape)
    rate = sign * np.rad2deg(d["rate"] @ turn @ tilt) + 0.3 * rng.standard_normal(d["rate"].shape)
    body, tags = b"", []
    for n in range(d["t"].size):
        row = ",".join(f"{v:.5f}" for v in (*force[n], *rate[n]))
        body += f"{row},{261_906 + round(1000 * d['t'][n])}{end}".encode()
        if n % 10 == 9:
            tags.append((round(1000 * (d["t"][n] + LAG_S)), len(body)))
    (folder / "imu_1834.csv").write_bytes(body)
    head = b"TIMETAG RTKLIB".ljust(60, b"\0") + struct.pack("<IId", 77, int(START), 0.0)
    (folder / "imu_1834.csv.tag").write_bytes(head + b"".join(struct.pack("<II", *tag) for tag in tags))
    (folder / "gnss_1834.pos").write_text("\n".join(["% GPST latitude longitude", *_solution(d)]) + "\n")
    return folder


def _solution(d: dict[str, np.ndarray]) -> list[str]:
    """Lines of a solution, four a second."""
    (latitude, longitude), height = HOME
    axes, origin = ecef_from_enu_matrix(latitude, longitude), ecef_from_geodetic(latitude, longitude, height)
    lines = []
    for n in range(0, d["t"].size, 25):
        place = geodetic_from_ecef(origin + axes @ [d["east"][n], d["north"][n], 0.0])
        when = datetime.fromtimestamp(START + d["t"][n], UTC).strftime("%Y/%m/%d %H:%M:%S.%f")[:-3]
        north, east = d["speed"][n] * np.cos(d["heading"][n]), d["speed"][n] * np.sin(d["heading"][n])
        lines.append(
            f"{when} {np.rad2deg(place[0]):.9f} {np.rad2deg(place[1]):.9f} {place[2]:.4f} 1 21 0.01 0.01 0.01 "
            f"0 0 0 0 0 {north:.4f} {east:.4f} 0.0 0.04 0.04 0.04"
        )
    return lines


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("log"))


def _read(folder: Path):
    return read_imu_log(folder / "imu_1834.csv"), read_solution_track(folder / "gnss_1834.pos")


def test_mount_lag_and_biases_are_found(folder: Path) -> None:
    _, found = motion_of_log(*_read(folder), ImuOutageConfig())
    assert (found["azimuth_deg"] - 170.0 + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=2.0)
    assert found["lag_s"] == pytest.approx(LAG_S, abs=0.03)
    assert (found["roll_deg"], found["pitch_deg"]) == (pytest.approx(2.0, abs=0.3), pytest.approx(-4.0, abs=0.5))
    assert found["coherence"] > 0.9


def test_errors_of_outages_are_small_and_within_their_levels(folder: Path) -> None:
    config = ImuOutageConfig()
    motion, _ = motion_of_log(*_read(folder), config)
    outages = run_inertial_outages(motion, config)
    assert len(outages.start_s) > 60
    assert (np.abs(outages.error_m) < outages.pl_m).all()
    assert np.median(np.abs(outages.error_m[:, -1])) < 1.5
    assert np.median(outages.pl_m[:, -1, 0]) > 5.0


def test_an_acceleration_error_beyond_the_declared_one_shows(tmp_path: Path) -> None:
    """A jump of 1 m/s^2 within the settling or the outage adds up to 50 m in 10 s."""
    config = ImuOutageConfig()
    motion, _ = motion_of_log(*_read(_write(tmp_path, jump_mps2=1.0)), config)
    outages = run_inertial_outages(motion, config)
    over = np.abs(outages.error_m[..., 0]) > outages.pl_m[..., 0]
    across_the_jump = (outages.start_s < 120.0) & (outages.start_s > 112.0)
    assert over[across_the_jump].any()
    assert not over[outages.start_s < 108.0].any()


def test_the_command_s_results_and_lines_that_end_in_two_characters(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert kind_of(_write(tmp_path, end="\r\n")) == "imu_log"
    found, written = replay_folder(tmp_path, out, {"longest_s": 8.0})
    assert [path.name for path in written] == ["replay.json", "drift.png"]
    assert found["by_age"][-1]["age_s"] == 8.0
    assert found["calibration"]["lag_s"] == pytest.approx(LAG_S, abs=0.03)
    with pytest.raises(InputError, match="navigator must be left out for an inertial log"):
        replay_folder(tmp_path, out, navigator="filter")
    with pytest.raises(InputError, match="must move for 900 s of calibration"):
        replay_folder(tmp_path, out, {"calibration_s": 900.0})
    (tmp_path / "second.pos").touch()
    with pytest.raises(InputError, match=r"must have one \*.pos beside its inertial log, has gnss_1834.pos, second"):
        replay_folder(tmp_path, out)


def test_old_velocities_are_not_used(folder: Path, tmp_path: Path) -> None:
    """Where a solution repeats a velocity while the car goes on, its epochs are no reference."""
    log, track = _read(folder)
    velocity = track.velocity_neu_mps.copy()
    velocity[400:420] = -velocity[399]
    old = type(track)(**{**track.__dict__, "velocity_neu_mps": velocity})
    motion, _ = motion_of_log(log, old, ImuOutageConfig())
    at = motion.time_s + 0.5
    assert not motion.known[(at > 100.3) & (at < 104.7)].any()
    assert motion.known[(at > 20.0) & (at < 99.0)].all()
