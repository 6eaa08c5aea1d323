"""Inertial outages of a recorded drive: a drive written here with a known mount, lag, biases and hills."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic, geodetic_from_ecef
from lanebound.integrity.recorded.imu_log import G_MPS2, read_imu_log
from lanebound.integrity.recorded.rtklib import read_rtk_solution
from lanebound.integrity.replay.datasets import kind_of, replay_folder
from lanebound.integrity.replay.imu_outages import ImuOutageConfig, motion_of_log, run_inertial_outages

START = 1_751_999_658.0
ROLL, PITCH, AZIMUTH = np.deg2rad([2.0, -4.0, 170.0]).tolist()
LAG_S = 0.12
Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
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
    return {
        "t": t,
        "speed": speed,
        "heading": heading,
        "east": east,
        "north": north,
        "force": force,
        "rate": rate,
        "slope": slope,
    }


def _write(
    folder: Path, length_s: float = 180.0, end: str = "\n", change: Change | None = None, late_s: float = LAG_S,
    gap_s: tuple[float, float] = (0.0, 0.0), **given: float,
) -> Path:  # fmt: skip
    """The files of a drive; the sensor's x axis points backward, and its time stamps are late by ``late_s``.

    ``change`` is done to force and rate (N, 3) as the log has them; rows in ``gap_s`` are missing.
    """
    d, rng = _drive(length_s, **given), np.random.default_rng(5)
    (cr, sr), (cp, sp), (ca, sa) = ((np.cos(a), np.sin(a)) for a in (ROLL, PITCH, AZIMUTH))
    tilt = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])  # sensor to level
    turn = np.array([[ca, -sa, 0.0], [sa, ca, 0.0], [0.0, 0.0, 1.0]])  # level axes of the sensor to the vehicle
    sign = np.array([1.0, -1.0, -1.0])
    force = sign * (d["force"] @ turn @ tilt) / G_MPS2 + 2e-3 * rng.standard_normal(d["force"].shape)
    rate = sign * np.rad2deg(d["rate"] @ turn @ tilt) + 0.3 * rng.standard_normal(d["rate"].shape)
    force, rate = (force, rate) if change is None else change(force, rate)
    body, tags = b"", []
    for n in range(d["t"].size):
        if gap_s[0] < d["t"][n] < gap_s[1]:
            continue
        row = ",".join(f"{v:.5f}" for v in (*force[n], *rate[n]))
        body += f"{row},{261_906 + round(1000 * d['t'][n])}{end}".encode()
        if n % 10 == 9:
            tags.append((round(1000 * (d["t"][n] + late_s)), len(body)))
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
            f"0 0 0 0 0 {north:.4f} {east:.4f} {d['speed'][n] * np.tan(d['slope'][n]):.4f} 0.04 0.04 0.04"
        )
    return lines


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _write(tmp_path_factory.mktemp("log"))


def _read(folder: Path):
    return read_imu_log(folder / "imu_1834.csv"), read_rtk_solution(folder / "gnss_1834.pos")


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
    with pytest.raises(InputError, match=r"must have one \*.pos next to its inertial log, has gnss_1834.pos, second"):
        replay_folder(tmp_path, out)


def test_solutions_in_radians_without_usable_rows_or_with_vu_reversed_are_named(folder: Path, tmp_path: Path) -> None:
    log, track = _read(folder)
    text = (folder / "gnss_1834.pos").read_text().splitlines()
    rows = [line.split() for line in text[1:]]
    radians = [" ".join([*w[:2], *(f"{np.radians(float(v)):.9f}" for v in w[2:4]), *w[4:]]) for w in rows]
    path = tmp_path / "radians.pos"
    path.write_text("\n".join([text[0], *radians, ""]))
    with pytest.raises(InputError, match=r"must be in degrees, got 0\.6998, -1\.8352, which fit its velocities as rad"):
        motion_of_log(log, read_rtk_solution(path), ImuOutageConfig())
    single = replace(track, quality=np.full_like(track.quality, 5))
    with pytest.raises(InputError, match=r"rows of Q 1 \(fixed\) or 2 \(float\), its 720 rows have Q 5: process it by"):
        motion_of_log(log, single, ImuOutageConfig())
    down = replace(track, velocity_neu_mps=track.velocity_neu_mps * [1.0, 1.0, -1.0])
    with pytest.raises(
        InputError, match=r"pitch rate of the log, or vu of the solution, must .*: its sign is reversed"
    ):
        motion_of_log(log, down, ImuOutageConfig())


def test_rows_that_are_not_used_and_time_tags_that_end_early_are_noted(tmp_path: Path) -> None:
    _write(tmp_path)
    solution, tag = tmp_path / "gnss_1834.pos", tmp_path / "imu_1834.csv.tag"
    lines = solution.read_text().splitlines()
    single = [line.replace(" 1 21 ", " 5 21 ") for line in lines[-20:]]
    solution.write_text("\n".join([*lines[:-20], *single, ""]))
    tag.write_bytes(tag.read_bytes()[:-403])
    found, _ = replay_folder(tmp_path, tmp_path / "out")
    assert found["stopped"] == {
        "imu_1834.csv.tag": "time tags end 5.1 s before the log, whose later times are those of its own clock",
        "gnss_1834.pos": "20 of 720 rows with another Q than 1 (fixed) or 2 (float) are not used",
    }


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


def test_outages_at_a_gap_are_left_out_and_counted(tmp_path: Path, folder: Path) -> None:
    config = ImuOutageConfig()
    whole = run_inertial_outages(motion_of_log(*_read(folder), config)[0], config)
    found, _ = replay_folder(_write(tmp_path, gap_s=(120.0, 130.0)), tmp_path / "out")
    start = whole.start_s + 0.5  # the first epoch is 0.5 s after the start of the log
    touching = (start + config.longest_s > 120.0) & (start - config.settle_s < 130.0)
    assert found["outages"] + found["left_out_at_gaps"] == whole.start_s.size
    assert touching.sum() <= found["left_out_at_gaps"] <= touching.sum() + 2  # the lag widens the gap
    assert found["stopped"] == {"imu_1834.csv": "1 gap, the longest of 10.00 s"}
    assert [found["all_ages"][axis]["exceeded"] for axis in ("at", "ct")] == [0, 0]


def test_a_gap_of_the_solution_counts_and_one_of_the_log_in_the_calibration_is_refused(tmp_path: Path) -> None:
    config = ImuOutageConfig()
    log, track = _read(_write(tmp_path))
    whole = run_inertial_outages(motion_of_log(log, track, config)[0], config)
    path = tmp_path / "gnss_1834.pos"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:481] + lines[540:]) + "\n")  # 15 s after 120 s
    holed = run_inertial_outages(motion_of_log(log, read_rtk_solution(path), config)[0], config)
    assert 28 <= holed.left_out == whole.start_s.size - holed.start_s.size <= 31
    with pytest.raises(InputError, match=r"without gaps until its calibration ends, .* has 1 gap, the longest of 10\."):
        replay_folder(_write(tmp_path, gap_s=(40.0, 50.0)), tmp_path / "out")


@pytest.mark.parametrize(("change", "message"), [
    (lambda f, w: (f, np.radians(w)), r"yaw rate of the log .* slope on it is 0\.017.* correlation 1.*in rad/s, not"),
    (lambda f, w: (f, w * [1, 1, -1]), r"yaw rate of the log .* slope on it is -\d.*: its sign is reversed"),
    (lambda f, w: (f, w[:, [2, 0, 1]]), "another axis"),
    (lambda f, w: (f, w * [1, 1, 0]), "rate z of the log must change .* it keeps one value, 0, for 120"),
    (lambda f, w: (f, np.where(np.arange(len(w))[:, None] // 2000 == 2, w[4000], w)), r"rate x .* for 20\.. s"),
    (lambda f, w: (np.where(np.arange(len(f))[:, None] // 2000 == 2, f[4000], f), w), r"force x .* for 20\.. s"),
    (lambda f, w: (f, w[:, [1, 0, 2]]), "rate x and rate y of the log .* exchanged .* exchange the two columns"),
    (lambda f, w: (f, w * [1, -1, 1]), "with one axis of the gyro or the accelerometer mirrored"),
    (lambda f, w: (f * [-1, -1, 1], w), "with one axis of the gyro or the accelerometer mirrored"),
    (lambda f, w: (f * G_MPS2, w), r"mean force of 96.* it is probably in m/s\^2, not in g"),
    (lambda f, w: (f * [1, -1, 1], w), "with one axis of the accelerometer mirrored its correlation .* rises"),
    (lambda f, w: (f * [1, 1, -1], w), "its sign is reversed"),  # a sensor upside down has all its axes turned
])  # fmt: skip
def test_units_signs_and_axes_that_contradict_the_solution_are_refused(
    tmp_path: Path, change: Change, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        replay_folder(_write(tmp_path, 120.0, change=change), tmp_path / "out")


@pytest.mark.parametrize("late_s", [0.56, 1.12, 18.0])
def test_a_lag_beyond_the_search_is_refused(tmp_path: Path, late_s: float) -> None:
    with pytest.raises(InputError, match="clocks of the log and of the reference must agree") as refusal:
        replay_folder(_write(tmp_path, 150.0, late_s=late_s), tmp_path / "out")
    named = re.search(r"comes ([+-][\d.]+) s later", str(refusal.value))
    assert named is not None
    assert float(named[1]) == pytest.approx(late_s, abs=0.1)


@pytest.mark.parametrize(("factor", "likely"), [(3.6, "km/h"), (1.94384, "knots"), (-1.0, "sign is reversed")])
def test_velocities_of_the_solution_in_another_unit_are_refused(folder: Path, factor: float, likely: str) -> None:
    log, track = _read(folder)
    with pytest.raises(InputError, match=f"the solution's velocities .*{likely}"):
        motion_of_log(log, replace(track, velocity_neu_mps=factor * track.velocity_neu_mps), ImuOutageConfig())
    with pytest.raises(InputError, match="must have velocities in all rows, has none in some: set out-outvel"):
        motion_of_log(log, replace(track, velocity_neu_mps=None), ImuOutageConfig())
