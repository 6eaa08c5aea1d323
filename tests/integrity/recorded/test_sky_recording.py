"""A recorded sky is kept to the centimetre, answers by what is nearest, and says where a file is wrong or cut."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from recordings import SKY

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.sky_recording import HEAD, SkyRecording, read_sky_recording
from lanebound.integrity.sky.visibility import SignalPath


def written(folder: Path, text: str = SKY) -> Path:
    path = folder / "sky.csv"
    path.write_text(text, encoding="utf-8")
    return path


def asked(recording: SkyRecording, arc_m: float, azimuth_deg: float, elevation_deg: float = 40.0) -> SignalPath:
    row = recording.nearest(np.array([arc_m]), np.radians([azimuth_deg]), np.radians([elevation_deg]))
    return SignalPath(recording.path[row[0]])


def test_a_file_is_read_and_written_back(tmp_path: Path) -> None:
    first = read_sky_recording(written(tmp_path))
    assert first.satellite.tolist() == ["G01", "G01", "G02", "G02"]
    assert first.path.tolist() == [SignalPath.BLOCKED, SignalPath.LOS, SignalPath.REFLECTED, SignalPath.FOLIAGE]
    assert first.excess_m.tolist() == [0.0, 0.0, 35.25, 0.0]
    assert (first.length_m, first.stopped) == (20.0, None)
    first.save(tmp_path / "again.csv")
    again = read_sky_recording(tmp_path / "again.csv")
    for name in ("arc_m", "azimuth_rad", "elevation_rad", "cn0_dbhz", "excess_m"):
        order = np.argsort(first.arc_m, kind="stable")
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name)[order])
    packed = tmp_path / "packed.csv.gz"
    packed.write_bytes(gzip.compress(SKY.encode()))
    assert read_sky_recording(packed).digest == first.digest


def test_what_is_nearest_answers_and_the_drive_is_a_loop(tmp_path: Path) -> None:
    sky = read_sky_recording(written(tmp_path))
    assert asked(sky, 2.0, 265.0) is SignalPath.BLOCKED
    assert asked(sky, 12.0, 275.0) is SignalPath.LOS
    assert asked(sky, 3.0, 90.0) is SignalPath.REFLECTED
    assert asked(sky, 13.0, 90.0) is SignalPath.FOLIAGE
    assert asked(sky, 19.0, 270.0) is SignalPath.BLOCKED  # 3.5 m on the drive begins anew
    assert asked(sky, 42.5, 270.0 - 720.0) is SignalPath.BLOCKED
    assert asked(sky, -17.5, 270.0) is SignalPath.BLOCKED


def test_towards_the_zenith_azimuth_says_less_than_at_the_horizon(tmp_path: Path) -> None:
    rows = "G01,2.5,10.0,85.0,blocked,0,0\nG02,2.5,100.0,60.0,los,0,48\n"
    sky = read_sky_recording(written(tmp_path, SKY[: SKY.index("G01")] + rows))
    assert asked(sky, 2.5, 190.0, 85.0) is SignalPath.BLOCKED


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("blocked", "hidden", "line 3, path must be one of los, foliage, reflected, blocked, got 'hidden'"),
        ("35.25", "0.00", "excess_m must be above 0 for reflected signals"),
        ("G02,2.50,90.00", "G02,2.50,east", "line 5, azimuth_deg must be a number, got 'east'"),
        ("satellite,arc_m", "satellite,arc", "line 2, the head must be"),
        ("length_m=20.00", "length_m=2.00", "at least its largest arc_m 12.5, got 2"),
        ("# length_m=20.00\n", "", "must give '# length_m=' of the drive"),
        ("G01,2.50", ",2.50", "satellite must have 1 to 8 letters"),
        (",46.0", "", "must have 7 columns, got 6"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_sky_recording(written(tmp_path, SKY.replace(old, new, 1)))


def test_a_cut_file_gives_what_was_read(tmp_path: Path) -> None:
    cut = read_sky_recording(written(tmp_path, SKY[:-8]))
    assert cut.path.size == 3
    assert "line 6" in str(cut.stopped)
    ended = read_sky_recording(written(tmp_path, SKY[:-8] + "\n"))
    assert ended.path.size == 3
    assert "7 columns" in str(ended.stopped)
    with pytest.raises(InputError, match="must hold rows"):
        read_sky_recording(written(tmp_path, SKY[:90]))


def test_what_decides_names_a_recording(tmp_path: Path) -> None:
    plain = read_sky_recording(written(tmp_path)).digest
    assert read_sky_recording(written(tmp_path, SKY.replace("35.25", "35.26"))).digest != plain
    assert read_sky_recording(written(tmp_path, SKY.replace("20.00", "21.00"))).digest != plain


def test_angles_in_radians_and_a_part_without_rows_are_refused(tmp_path: Path) -> None:
    def text(azimuth: float, elevation: float, missing: tuple[int, int] = (0, 0)) -> str:
        rows = [f"G01,{5 * k + 2.5},{azimuth + 0.01 * k:.3f},{elevation:.3f},los,0.0,45.0" for k in range(60)
                if not missing[0] < k < missing[1]]  # fmt: skip
        return "\n".join(["# length_m=300.00", HEAD, *rows, ""])

    for given, message in (
        (text(200.0, 0.7), "elevations of .* must be in degrees, the largest of 60 is 0.7"),
        (text(2.0, 40.0), "azimuths of .* must be in degrees, the largest of 60 is 2.59"),
        (text(200.0, 40.0, (10, 40)), r"must have rows along the whole drive, has none between 52\.5 and 202\.5 m"),
    ):
        (tmp_path / "sky.csv").write_text(given)
        with pytest.raises(InputError, match=message):
            read_sky_recording(tmp_path / "sky.csv")
    (tmp_path / "sky.csv").write_text(text(200.0, 40.0, (10, 20)))
    assert read_sky_recording(tmp_path / "sky.csv").arc_m.size == 51
