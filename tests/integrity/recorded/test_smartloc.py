"""smartLoc drives, whole, cut and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import SMARTLOC, SMARTLOC_TRUTH, real, survives

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import read_smartloc

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


@FUZZ
@given(st.data())
def test_no_damage_hangs_or_crashes(tmp_path: Path, data: st.DataObject) -> None:
    text = bytearray(SMARTLOC.encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text)))
        text[at : at + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=40))
    path = written(tmp_path, bytes(text))
    survives(lambda: read_smartloc(path))


@FUZZ
@given(st.binary(max_size=400))
def test_no_noise_hangs_or_crashes(tmp_path: Path, noise: bytes) -> None:
    path = written(tmp_path, noise)
    survives(lambda: read_smartloc(path))


def test_the_berlin_drive() -> None:
    folder = real("smartloc_berlin_potsdamer")
    drive = read_smartloc(folder / "Berlin_Potsdamer_Platz_Input.txt.gz", folder / "Berlin_Potsdamer_Platz_GT.txt")
    assert drive.stopped is None
    assert drive.ranges.time_s.size == 10_677
    assert drive.odometry.time_s.size == 724
    assert set(drive.ranges.system) == {"G", "R"}
