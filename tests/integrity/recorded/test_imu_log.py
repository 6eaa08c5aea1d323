"""Inertial logs with time tags, and solutions with velocities: files written here, whole, cut and wrong."""

from __future__ import annotations

import gzip
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.imu_log import G_MPS2, levelled, read_imu_log
from lanebound.integrity.recorded.source import GPS_EPOCH_S

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


def test_copies_with_other_line_ends_separators_or_packing_are_the_same_log(tmp_path: Path) -> None:
    path = _write(tmp_path, cut=False)
    whole, text = read_imu_log(path), path.read_text()
    tags = tmp_path / "crlf.tag"
    data = (tmp_path / "imu.csv.tag").read_bytes()
    counts = np.frombuffer(data[76:], np.dtype([("tick", "<u4"), ("bytes", "<u4")])).copy()
    counts["bytes"] += 10 * np.arange(1, len(counts) + 1, dtype=np.uint32)  # ten lines in a block, one byte each
    tags.write_bytes(data[:76] + counts.tobytes())
    for name, body, tag in (
        ("lf.csv", text.encode(), tags),  # a checkout without the carriage returns that the tags count
        ("crlf.csv", text.replace("\n", "\r\n").encode(), tags),
        ("tab.csv", text.replace(",", "\t").encode(), None),
        ("semicolon.csv", text.replace(",", ";").encode(), None),
        ("imu.csv.gz", gzip.compress(text.encode()), None),
    ):
        (tmp_path / name).write_bytes(body)
        found = read_imu_log(tmp_path / name, tag or tmp_path / "imu.csv.tag")
        np.testing.assert_allclose(found.gps_time_s, whole.gps_time_s, atol=1e-6)
        np.testing.assert_array_equal(found.force_mps2, whole.force_mps2)


def test_tags_that_go_on_after_the_end_of_a_cut_log_do_not_bend_its_clock(tmp_path: Path) -> None:
    path = _write(tmp_path, cut=False)
    whole = read_imu_log(path)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:400]))
    np.testing.assert_allclose(read_imu_log(path).gps_time_s, whole.gps_time_s[:400], atol=1e-3)


def test_a_mark_of_utf_8_changes_nothing(tmp_path: Path) -> None:
    path = _write(tmp_path)
    whole = read_imu_log(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    marked = read_imu_log(path)
    np.testing.assert_array_equal(marked.gps_time_s, whole.gps_time_s)
    np.testing.assert_array_equal(marked.rate_radps, whole.rate_radps)


def test_numbers_of_another_width_and_decimal_commas_are_named(tmp_path: Path) -> None:
    path = _write(tmp_path, cut=False)
    rows = path.read_text().splitlines()
    path.write_text("".join(",".join([f"{float(v):.3f}" for v in row.split(",")]) + "\n" for row in rows))
    with pytest.raises(
        InputError, match=r"Tags count the bytes of the log, \d+ where it has \d+: write changed numbers"
    ):
        read_imu_log(path)
    path.write_text("".join(row.replace(",", ";").replace(".", ",") + "\n" for row in rows))
    with pytest.raises(InputError, match=r"specific force x must be a number, got '-?\d,\d+': write decimal points"):
        read_imu_log(path)


@pytest.mark.parametrize(("clock", "message"), [
    (lambda ms: ms * 1000, r"got a factor of 0\.001.*it is probably in us, not in ms"),
    (lambda ms: ms / 1000, r"got a factor of 1\d\d\d.*it is probably in s, not in ms"),
    (lambda ms: ms + 500.0 * (ms > 266_900), "keep to a line through its time tags within 0.1 s"),
    (lambda ms: ms - 5003.0 * (ms > 271_000), "must have times that increase, 90 of 1000 rows go back"),
    (lambda ms: 600_000.0 - ms, "must have times that increase, 999 of 1000 rows go back"),
])  # fmt: skip
def test_clocks_of_other_units_that_jump_or_go_back_are_refused(tmp_path: Path, clock, message: str) -> None:
    path = _write(tmp_path, cut=False)
    rows = [line.rsplit(",", 1) for line in path.read_text().splitlines()]
    path.write_text("".join(f"{row},{clock(float(ms))}\n" for row, ms in rows))
    with pytest.raises(InputError, match=message):
        read_imu_log(path)


def test_a_force_in_another_unit_is_named(tmp_path: Path) -> None:
    log = read_imu_log(_write(tmp_path))
    for factor, unit in ((G_MPS2, r"m/s\^2"), (1000.0, "mg")):
        with pytest.raises(InputError, match=f"at rest, got a mean force of .*it is probably in {unit}, not in g"):
            levelled(replace(log, force_mps2=factor * log.force_mps2))
