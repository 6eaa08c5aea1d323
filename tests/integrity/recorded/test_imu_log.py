"""Inertial logs with time tags, and solutions with velocities: files written here, whole, cut and wrong."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.recorded.imu_log import G_MPS2, GPS_EPOCH_S, levelled, read_imu_log, read_solution_track

START = 1_751_999_658  # 2025-07-08 18:34:18 by GPS time, in seconds since 1970
ROLL, PITCH = np.deg2rad(3.0), np.deg2rad(-5.0)


def _write(folder: Path, drift: float = 1.0, cut: bool = True, wide: bool = False) -> Path:
    """10 s at 100 Hz of a level car whose sensor is mounted askew, with a turn of 10 deg/s from 5 s on."""
    (cr, sr), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (ROLL, PITCH))
    to_body = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]]).T
    lines, ends = ["13,0.991,0.1,-0.2,0.3,2619" if cut else ""], []
    body = (lines[0] + "\n").encode() if cut else b""
    tags = []
    for n in range(1000):
        time = 0.01 * n
        force = to_body @ np.array([0.0, 0.0, -1.0]) + 1e-3 * np.sin(n)  # up, in g
        rate = to_body @ np.array([0.0, 0.0, 10.0 if time >= 5.0 else 0.0])
        values = [*(np.array([1.0, -1.0, -1.0]) * force), *(np.array([1.0, -1.0, -1.0]) * rate)]
        body += (",".join(f"{v:.6f}" for v in values) + f",{261_906 + round(1000 * time * drift)}\n").encode()
        if n % 10 == 9:
            tags.append((round(1000 * time), len(body)))
        ends.append(len(body))
    path = folder / "imu.csv"
    path.write_bytes(body + (b"0.1,0.0" if cut else b""))
    head = b"TIMETAG RTKLIB demo5".ljust(60, b"\0") + struct.pack("<IId", 77, START, 0.499)
    (folder / "imu.csv.tag").write_bytes(head + b"".join(struct.pack("<IQ" if wide else "<II", *t) for t in tags))
    return path


@pytest.mark.parametrize("wide", [False, True])
def test_a_log_is_read_on_gps_time_in_units_and_axes_of_the_house(tmp_path: Path, wide: bool) -> None:
    log = read_imu_log(_write(tmp_path, wide=wide))
    assert len(log.gps_time_s) == 1000
    assert log.stopped is not None  # the last line is cut
    assert log.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert log.gps_time_s[0] == pytest.approx(START + 0.499 - GPS_EPOCH_S, abs=2e-3)
    level, roll, pitch = levelled(log)
    assert (roll, pitch) == (pytest.approx(ROLL, abs=2e-3), pytest.approx(PITCH, abs=2e-3))
    np.testing.assert_allclose(level.force_mps2.mean(0), [0.0, 0.0, -G_MPS2], atol=0.02)
    turned = np.trapezoid(level.rate_radps[:, 2], level.gps_time_s)
    assert np.rad2deg(turned) == pytest.approx(50.0, abs=0.2)  # clockwise


def test_a_clock_that_runs_fast_is_tied_to_the_tags(tmp_path: Path) -> None:
    log = read_imu_log(_write(tmp_path, drift=1.002, cut=False))
    assert log.stopped is None
    assert log.gps_time_s[-1] - log.gps_time_s[0] == pytest.approx(9.99, abs=2e-3)
    with pytest.raises(InputError, match=r"within 1 % of its time tags, got a factor of 0\.9"):
        read_imu_log(_write(tmp_path, drift=1.05))


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    path = _write(tmp_path)
    (tmp_path / "imu.csv.tag").write_bytes(b"nothing")
    with pytest.raises(InputError, match="must begin with 'TIMETAG'"):
        read_imu_log(path)
    with pytest.raises(InputError, match="must be a readable file"):
        read_imu_log(path, tmp_path / "other.tag")
    path = _write(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:50], "1,2,x,4,5,6,7", *lines[50:]]) + "\n")
    with pytest.raises(InputError, match="line 51, specific force z must be a number, got 'x'"):
        read_imu_log(path)
    path.write_text("\n".join(lines[1:5]) + "\n")
    with pytest.raises(InputError, match="at least 10 samples, got 4"):
        read_imu_log(path)
    moving = read_imu_log(_write(tmp_path))
    with pytest.raises(InputError, match="must be at rest"):
        levelled(type(moving)(moving.gps_time_s, 1.2 * moving.force_mps2, moving.rate_radps, None))


def test_a_solution_with_velocities_is_read(tmp_path: Path) -> None:
    head = "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn sde sdu sdne sdeu sdun age ratio vn ve vu sdvn\n"
    row = "2025/07/08 18:34:{} 40.0966268 -105.1474483 1601.474 1 21 0.0099 0.0098 0.01 0 0 0 0 0 {} -0.002 0.009 0.05"
    path = tmp_path / "gnss.pos"
    path.write_text(head + "".join(row.format(f"{18 + 0.25 * k:.3f}", 0.5 * k) + "\n" for k in range(4)))
    track = read_solution_track(path)
    np.testing.assert_allclose(track.gps_time_s, START - GPS_EPOCH_S + 0.25 * np.arange(4), atol=1e-6)
    latitude, longitude, height = geodetic_from_ecef(track.position_ecef_m[0])
    assert np.rad2deg([latitude, longitude]) == pytest.approx([40.0966268, -105.1474483], abs=1e-9)
    assert height == pytest.approx(1601.474, abs=1e-4)
    np.testing.assert_allclose(track.velocity_neu_mps[:, 0], [0.0, 0.5, 1.0, 1.5])
    assert track.quality.tolist() == [1, 1, 1, 1]
    path.write_text(head + " ".join(row.format("18.000", 0).split()[:15]) + "\n" + row.format("19.000", 0) + "\n")
    with pytest.raises(InputError, match="velocities in columns 16 to 18, got 15"):
        read_solution_track(path)
    path.write_text(head)
    with pytest.raises(InputError, match="at least one position"):
        read_solution_track(path)
