"""The files of a pair in a folder: by name, by motion, and refusals that name the candidates."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from baselines import AXES, PLACE, navigation_text, observation_text, receiver, sky
from recordings import real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.replay.baseline import solve_baseline
from lanebound.integrity.replay.datasets import find_pair, kind_of
from lanebound.integrity.sky.ephemeris import Ephemerides
from lanebound.integrity.sky.rinex_navigation import parse_navigation, read_navigation

TIME = np.arange(0.0, 8.0)
WIDE = sky()
TABLE = parse_navigation(navigation_text(replace(WIDE, prn=np.arange(len(WIDE.prn)) % 90 + 1)))


def put(folder: Path, name: str, speed_mps: float, seed: int) -> None:
    """Write observations of a receiver that drives North."""
    place = PLACE + (TIME[:, None] * [0.0, speed_mps, 0.0]) @ AXES.T
    (folder / name).write_text(observation_text(receiver(TABLE, TIME, place, clock_s=1e-4, seed=seed)))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "SITE2650.21P").write_text(navigation_text(TABLE))
    (tmp_path / "readme.txt").write_text("recorded on a Monday\n")
    return tmp_path


def test_the_receiver_that_moves_is_the_rover(folder: Path) -> None:
    put(folder, "3034265G.21O", 0.0, 1)
    put(folder, "SEPT265G.21O", 20.0, 2)
    assert kind_of(folder) == "rinex"
    pair = find_pair(folder)
    assert (pair.rover.name, pair.base.name) == ("SEPT265G.21O", "3034265G.21O")
    assert [path.name for path in pair.navigation] == ["SITE2650.21P"]


def test_names_come_before_motion(folder: Path) -> None:
    put(folder, "rover_1.24O", 0.0, 1)
    put(folder, "ref.rnx", 20.0, 2)
    pair = find_pair(folder)
    assert (pair.rover.name, pair.base.name) == ("rover_1.24O", "ref.rnx")


def test_packed_files_of_a_pair_are_named_and_other_archives_left_alone(folder: Path) -> None:
    put(folder, "rover_1.24O", 0.0, 1)
    put(folder, "ref.rnx", 20.0, 2)
    (folder / "photos.zip").write_bytes(b"PK\x03\x04")
    assert find_pair(folder).rover.name == "rover_1.24O"
    for name, head in (("C.24O.Z", b"\x1f\x9d\x90"), ("C.obs.zip", b"PK\x03\x04")):
        (folder / name).write_bytes(head)
        with pytest.raises(InputError, match=f"{name} must be plain text or gzip, is .*: unpack it"):
            find_pair(folder)
        (folder / name).unlink()
    line = f"{'3.0                 COMPACT RINEX FORMAT':<60}CRINEX VERS   / TYPE\n".encode()
    for name, body in (("C.24d", line), ("C.crx.gz", gzip.compress(line))):
        (folder / name).write_bytes(body)
        with pytest.raises(InputError, match=f"{name} must be a plain RINEX file: it is Hatanaka-compressed .*crx2rnx"):
            find_pair(folder)
        (folder / name).unlink()


def test_two_receivers_at_rest_are_named_in_the_refusal(folder: Path) -> None:
    put(folder, "A.24O", 0.0, 1)
    put(folder, "B.24O", 0.0, 2)
    with pytest.raises(InputError, match=r"neither of A\.24O, B\.24O moves: name them rover\.obs and base\.obs"):
        find_pair(folder)
    put(folder, "C.24O", 0.0, 3)
    with pytest.raises(InputError, match=r"must hold observations of two receivers, has A\.24O, B\.24O, C\.24O"):
        find_pair(folder)


def test_navigation_files_are_merged(folder: Path) -> None:
    put(folder, "rover.obs", 0.0, 1)
    put(folder, "base.obs", 0.0, 2)
    gps, galileo = (TABLE.take(TABLE.system == s) for s in (0, 1))
    (folder / "SITE2650.21P").write_text(navigation_text(gps))
    (folder / "SITE2650.21L").write_text(navigation_text(galileo))
    pair = find_pair(folder)
    merged = Ephemerides.merged([read_navigation(path) for path in pair.navigation])
    assert merged.satellites.tolist() == TABLE.satellites.tolist()
    joined = parse_navigation(navigation_text(gps) + navigation_text(galileo))
    assert joined.satellites.tolist() == TABLE.satellites.tolist()


def test_navigation_of_another_day_is_named() -> None:
    place = np.tile(PLACE, (TIME.size, 1))
    rover, base = (receiver(TABLE, TIME, place, clock_s=0.0, seed=k) for k in (1, 2))
    day = 86_400.0
    late = replace(TABLE, toe_s=TABLE.toe_s + day, toc_s=TABLE.toc_s + day)
    with pytest.raises(InputError, match=r"2024-06-24 08:20 to 2024-06-24 08:20, got 2024-06-25 08:20 .* of that day"):
        solve_baseline(rover, base, late, PLACE)


def test_the_recorded_pair_is_found_by_its_motion() -> None:
    pair = find_pair(real("rtk_cssrlib_4p7km_doy265"))
    assert (pair.rover.name, pair.base.name) == ("SEPT265G.21O", "3034265G.21O")
