"""smartLoc drives, whole, cut and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import RAW, SMARTLOC, SMARTLOC_TRUTH, real, survives

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import read_smartloc, read_smartloc_raw

FUZZ = settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def written(folder: Path, text: str | bytes, name: str = "drive.txt") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_a_small_drive(tmp_path: Path) -> None:
    drive = read_smartloc(written(tmp_path, SMARTLOC), written(tmp_path, SMARTLOC_TRUTH, "truth.txt"))
    assert drive.stopped is None
    assert drive.ranges.satellite.tolist() == [12, 320, 12]
    assert drive.ranges.system.tolist() == ["G", "R", "G"]
    assert np.degrees(drive.ranges.elevation_rad[0]) == pytest.approx(85.1)
    assert drive.odometry.speed_mps.tolist() == [5.0, 5.1]
    assert drive.odometry.yaw_rate_left_radps.tolist() == [-0.01, -0.02]
    assert drive.truth is not None
    position, known = drive.truth.at(np.array([0.1, 9.0]))
    np.testing.assert_allclose(position[0], [3785107.35, 899901.55, 5037234.9])
    assert known.tolist() == [True, False]


def test_a_cut_drive_gives_what_was_read_and_where_it_stopped(tmp_path: Path) -> None:
    drive = read_smartloc(written(tmp_path, SMARTLOC[:-20]))
    assert drive.ranges.satellite.tolist() == [12, 320]
    assert drive.stopped is not None
    assert drive.stopped.line == 5
    assert drive.truth is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("19949087.65 ", "nan ", "line 2, pseudorange must lie in"),
        (" 40\n", "\n", "line 3, pseudorange3 must have 10 columns, got 9"),
        ("odom3 0.2", "odom4 0.2", "line 4: the first word must be one of"),
        ("85.1 49", "95.1 49", "line 2, elevation must lie in"),
    ],
)
def test_damage_inside_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_smartloc(written(tmp_path, SMARTLOC.replace(old, new, 1)))


def test_the_wrong_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pseudorange3"):
        read_smartloc(written(tmp_path, SMARTLOC_TRUTH))
    with pytest.raises(InputError, match="the first word must be one of point3"):
        read_smartloc(written(tmp_path, SMARTLOC), written(tmp_path, SMARTLOC, "truth.txt"))


def test_raw_signals(tmp_path: Path) -> None:
    raw = read_smartloc_raw(written(tmp_path, RAW))
    assert raw.stopped is None
    assert raw.system.tolist() == ["G", "R", "S"]
    assert raw.reflected.tolist() == [0, 1, -1]
    assert raw.range_m[0] == 19834597.8
    assert raw.week.tolist() == [1900] * 3


def test_signals_that_go_back_in_time_are_left_out_and_counted(tmp_path: Path) -> None:
    head, *rows = RAW.splitlines()
    later = [rows[-1].replace("126641.7", f"{126642 + 0.2 * k:.1f}") for k in range(30)]
    text = "\n".join([head, *rows, *later[:10], rows[0], *later[10:], ""])
    raw = read_smartloc_raw(written(tmp_path, text))
    assert raw.tow_s.size == len(rows) + 30
    assert (np.diff(raw.tow_s) >= 0.0).all()
    assert raw.timing.note == "1 of 34 rows left out that repeat another"


def test_raw_damage_is_named_and_a_cut_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 2, column 'gnss identifier' must be one of"):
        read_smartloc_raw(written(tmp_path, RAW.replace("GPS;12", "XYZ;12")))
    with pytest.raises(InputError, match="line 1 must name a column"):
        read_smartloc_raw(written(tmp_path, RAW.replace("NLOS", "LOS")))
    cut = read_smartloc_raw(written(tmp_path, RAW[:-4]))
    assert cut.range_m.size == 2
    assert cut.stopped is not None


@FUZZ
@given(st.data())
def test_no_damage_hangs_or_crashes(tmp_path: Path, data: st.DataObject) -> None:
    which = data.draw(st.booleans())
    text = bytearray((SMARTLOC if which else RAW).encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text)))
        text[at : at + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=40))
    path = written(tmp_path, bytes(text))
    survives((lambda: read_smartloc(path)) if which else (lambda: read_smartloc_raw(path)))


@FUZZ
@given(st.binary(max_size=400))
def test_no_noise_hangs_or_crashes(tmp_path: Path, noise: bytes) -> None:
    path = written(tmp_path, noise)
    survives(lambda: read_smartloc(path))
    survives(lambda: read_smartloc_raw(path))


def test_the_berlin_drive() -> None:
    folder = real("smartloc_berlin_potsdamer")
    drive = read_smartloc(folder / "Berlin_Potsdamer_Platz_Input.txt.gz", folder / "Berlin_Potsdamer_Platz_GT.txt")
    assert drive.stopped is None
    assert drive.ranges.time_s.size == 10_677
    assert drive.odometry.time_s.size == 724
    assert set(drive.ranges.system) == {"G", "R"}


def test_the_berlin_excerpt() -> None:
    raw = read_smartloc_raw(real("smartloc_berlin_excerpt") / "tu_chemnitz_berlin_1_raw.csv")
    assert raw.range_m.size == 545
    assert np.unique(raw.tow_s).size == 31
    assert [(raw.reflected == k).sum() for k in (1, 0, -1)] == [263, 279, 3]
