"""The context monitor on recordings: road networks of files, epochs of each kind, verdicts on right and wrong maps."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from baselines import AXES, PLACE, navigation_text, observation_text, receiver, sky
from city_drives import as_files, simulated
from recordings import real
from road_files import collection, roads_at
from typer.testing import CliRunner

from lanebound.agents.cli import app
from lanebound.agents.cli.recorded import _share
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import geodetic_from_ecef
from lanebound.integrity.monitoring.context.monitor import ContextReason
from lanebound.integrity.positioning.map_matching.road_map import NO_LINK
from lanebound.integrity.recorded.comma import read_comma
from lanebound.integrity.recorded.road_file import read_roads
from lanebound.integrity.replay.context_drive import (
    ContextReplayConfig,
    drive_context,
    network_near,
    picked,
    read_context_epochs,
)
from lanebound.integrity.replay.datasets import replay_folder
from lanebound.integrity.replay.window import LocalFrame

SPEED, CORNER = 10.0, np.array([0.0, 400.0])
FRAME = LocalFrame(PLACE, AXES)
DRIVEN = ([[0.0, -100.0], [0.0, 400.0], [500.0, 400.0]], {"name": "driven", "maxspeed": 50})
CROSSING = ([[0.0, 400.0], [0.0, 900.0]], {"name": "ahead"})
BESIDE = ([[25.0, -100.0], [25.0, 375.0], [500.0, 375.0]], {"name": "beside"})
IONOSPHERE = "".join(
    f"{name}   0.0000E+00  0.0000E+00  0.0000E+00  0.0000E+00       IONOSPHERIC CORR\n" for name in ("GPSA", "GPSB")
)


def driven(time_s: np.ndarray) -> np.ndarray:
    """To the North for 40 s, then to the East, (T, 2)."""
    arc = SPEED * time_s
    return np.column_stack([np.maximum(arc - CORNER[1], 0.0), np.minimum(arc, CORNER[1])])


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A receiver in RINEX on the driven road, and its true places as a file is not there."""
    folder = tmp_path_factory.mktemp("drive")
    wide = sky(wanted=9)
    table = replace(wide, prn=np.arange(len(wide.prn)) % 90 + 1)
    time = np.arange(81.0)
    place = PLACE + np.column_stack([driven(time), np.zeros(81)]) @ AXES.T
    data = receiver(table, time, place, clock_s=1e-4, seed=3, code_m=0.4)
    (folder / "rover.obs").write_text(observation_text(data))
    text = navigation_text(table).split("\n", 1)
    (folder / "base.nav").write_text(f"{text[0]}\n{IONOSPHERE}{text[1]}")
    return folder


def verdicts(drive: Path, out: Path, *roads: Any, **changes: Any) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """The summary and the rows of a replay on a map."""
    path = collection(out / "map.geojson", *roads_at(PLACE, *roads))
    found, _ = replay_folder(drive, out, {"position": {"alert_limit_m": 40.0}, **changes}, roads=path)
    with (out / "context.csv").open(encoding="utf-8") as file:
        return found, list(csv.DictReader(file))


def test_lines_are_cut_where_they_share_a_vertex(tmp_path) -> None:
    ring = ([[300.0, 0.0], [310.0, 10.0], [300.0, 20.0], [300.0, 0.0]], {"name": "ring", "oneway": "yes"})
    through = ([[200.0, 0.0], [300.0, 0.0], [400.0, 0.0]], {"name": "through"})
    crossing = ([[250.0, -50.0], [250.0, 50.0]], {"name": "bridge"})  # no vertex in common: another level
    path = collection(tmp_path / "a.geojson", *roads_at(PLACE, ring, through, crossing))
    found = network_near(read_roads(path), FRAME, np.zeros((1, 2)), 500.0)
    m = found.road_map
    assert sorted(found.names) == ["bridge"] * 2 + ["ring"] + ["through"] * 4
    assert len(m.node_en_m) == 5
    loop = found.names.index("ring")
    assert m.link_from[loop] == m.link_to[loop]
    assert m.twin[loop] == NO_LINK
    assert (m.twin[[i for i, name in enumerate(found.names) if name == "through"]] != NO_LINK).all()
    np.testing.assert_allclose(np.sort(m.length_m)[-4:], 100.0, atol=5e-3)  # vertices to 1e-7 degrees
    first = m.near(np.array([[225.0, 3.0]]), 20.0, 1)
    assert found.names[first.link[0, 0]] == "through"
    assert first.distance_m[0, 0] == pytest.approx(3.0, abs=0.01)


def test_roads_far_away_are_left_out_also_those_that_only_pass_by(tmp_path) -> None:
    long = ([[-9000.0, 80.0], [9000.0, 80.0]], {"name": "passes"})
    far = ([[0.0, 3000.0], [10.0, 3000.0]], {"name": "far"})
    path = collection(tmp_path / "a.geojson", *roads_at(PLACE, long, far))
    assert set(network_near(read_roads(path), FRAME, np.zeros((3, 2)), 100.0).names) == {"passes"}
    with pytest.raises(InputError, match=r"a road within 50 m of the drive, the nearest is 3\.0 km away"):
        network_near(read_roads(collection(tmp_path / "b.geojson", *roads_at(PLACE, far))), FRAME, np.zeros((1, 2)), 50)


@pytest.mark.parametrize(("spacing", "count"), [(0.1, 11), (0.2, 11), (0.25, 11), (1.0, 10), (2.0, 5)])
def test_epochs_are_picked_once_in_an_interval(spacing, count) -> None:
    time = np.arange(0.0, 9.999, spacing) + 0.004 * np.sin(np.arange(round(10.0 / spacing)))
    at = picked(time, 1.0)
    assert len(at) == count
    assert abs(time[at][-1] - 9.0) < 1.1
    assert (np.diff(time[at]) > 0.75).all()


def test_a_right_map_gives_the_right_roads_and_a_parallel_one_the_wrong_road(drive, tmp_path) -> None:
    for name in ("right", "wrong", "none"):
        (tmp_path / name).mkdir()
    found, rows = verdicts(drive, tmp_path / "right", DRIVEN, CROSSING, BESIDE)
    assert found["skipped"] == {}
    assert any("changes of carriers" in note for note in found["notes"])
    roads = [row["road"] for row in rows]
    assert roads.count("driven") >= 79
    late = [row["reason"] for row in rows[12:]]
    assert late.count("TRUSTED") >= len(late) - 2  # one or two at the corner
    assert set(roads[:38] + roads[43:]) == {"driven"}
    assert float(rows[20]["speed_mps"]) == pytest.approx(SPEED, abs=0.1)
    # the driven road is missing: the one beside is matched, and heading, distance and speed agree with it
    _, rows = verdicts(drive, tmp_path / "wrong", BESIDE, CROSSING)
    assert [row["road"] for row in rows[12:36]] == ["beside"] * 24
    assert {row["reason"] for row in rows[12:36]} == {"TRUSTED"}
    # it is missing, and a road across is near: a wrong road whose heading differs is warned of
    across = ([[-200.0, 150.0], [200.0, 150.0]], {"name": "across"})
    _, rows = verdicts(drive, tmp_path / "none", across)
    near = [row for row in rows[12:] if row["road"] == "across"]
    assert near
    assert {row["reason"] for row in near} == {"DOUBTFUL_ROAD"}
    assert {row["reason"] for row in rows[25:]} == {"NO_ROAD"}


def test_limits_and_thresholds_decide(drive, tmp_path) -> None:
    across = ([[-200.0, 150.0], [200.0, 150.0]], {"name": "across"})
    _, rows = verdicts(drive, tmp_path, across)
    scores = {float(row["score"]) for row in rows[12:] if row["road"]}
    assert max(scores) < 71.0
    for threshold, reason in ((min(scores) - 1.0, "TRUSTED"), (max(scores) + 1.0, "DOUBTFUL_ROAD")):
        _, rows = verdicts(drive, tmp_path, across, map={"threshold": threshold})
        assert {row["reason"] for row in rows[12:] if row["road"]} == {reason}
    _, high = verdicts(drive, tmp_path, DRIVEN, position={"alert_limit_m": 2.0})
    assert {row["reason"] for row in high} == {"UNAVAILABLE"}


def test_what_the_reference_says_is_counted(drive, tmp_path) -> None:
    """With the given place of the rover, which a car does not stay at: all positions after it are on no road of it."""
    latitude, longitude, height = geodetic_from_ecef(PLACE)
    place = f"{np.degrees(latitude):.9f} {np.degrees(longitude):.9f} {height:.3f}\n"
    folder = tmp_path / "standing"
    folder.mkdir()
    for file in drive.iterdir():
        (folder / file.name).write_text(file.read_text())
    (folder / "rover_position.txt").write_text(place)
    found, rows = verdicts(folder, tmp_path, DRIVEN, CROSSING)
    assert found["judged"] == 81
    rates = found["rates"]
    assert rates["always warn"]["missed"] == rates["never warn"]["false_alarms"] == 0
    assert rates["never warn"]["missed"] == rates["never warn"]["wrong"] == sum(row["right"] == "0" for row in rows)
    assert rates["all phases"]["points"] == 81
    assert json.loads((tmp_path / "context.json").read_text())["rates"] == rates


def test_a_drive_without_doppler_skips_the_speed_phase_and_says_so(tmp_path) -> None:
    made = simulated(60.0)
    folder = tmp_path / "city"
    folder.mkdir()
    as_files(made, folder)
    epochs, _ = read_context_epochs(folder, "smartloc", ContextReplayConfig())
    path = epochs.truth_en_m[::5]
    roads = collection(tmp_path / "map.geojson", *roads_at(epochs.frame.origin_ecef_m, (path, {"name": "driven"})))
    changes: dict[str, Any] = {"position": {"alert_limit_m": 100.0}, "codes": {"errors": {"reflections_m": 3.0}}}
    zigzag, _ = replay_folder(folder, tmp_path, changes, roads=roads)
    assert zigzag["reasons"]["doubtful_road"] > 20  # white errors of codes of 3 m: their path is much too long
    changes["map"] = {"threshold": 60.0}
    found, _ = replay_folder(folder, tmp_path, changes, roads=roads)
    assert list(found["skipped"]) == ["speed"]
    assert "no Doppler speed" in found["skipped"]["speed"]
    assert found["reasons"]["trusted"] > 30
    assert found["reasons"]["trusted"] + found["reasons"]["collecting"] >= 0.9 * found["epochs"]
    course = np.arctan2(*epochs.fix.velocity_en_mps[20:].T)
    true = np.arctan2(*np.diff(epochs.truth_en_m, axis=0)[19:].T)
    assert np.rad2deg(np.abs(course - true)).max() < 10.0  # by wheels, gyro and code positions
    assert epochs.fix.has_velocity[20:].all()


def test_options_exclude_one_another_and_changes_are_checked(drive, tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"map\.threshold must lie in \[0, 100\], got 200"):
        replay_folder(drive, tmp_path, {"map": {"threshold": 200}}, roads=tmp_path / "a.geojson")
    told = CliRunner().invoke(app, [
        "replay", str(drive), "--context", str(tmp_path / "a.geojson"), "--service", "spp", "--out",
        str(tmp_path / "out"),
    ])  # fmt: skip
    assert told.exit_code == 2
    assert "leave out the others" in told.stderr
    map_file = collection(tmp_path / "map.geojson", *roads_at(PLACE, DRIVEN, CROSSING))
    told = CliRunner().invoke(app, ["replay", str(drive), "--context", str(map_file), "--out", str(tmp_path / "b")])
    assert told.exit_code == 0, told.output
    assert "Context monitor" in told.output
    assert "note: the recording has no wheels" in told.output
    assert {p.name for p in (tmp_path / "b").iterdir()} >= {
        "context.json", "context.csv", "warnings.csv", "context.png"
    }  # fmt: skip


def test_a_minute_of_highway_with_doppler_and_wheels(tmp_path) -> None:
    """comma2k19; the map is the reference itself, so that only speeds and the reader are tested."""
    folder = real("comma2k19_segment40")
    reference = read_comma(folder).reference.position_ecef_m
    origin = reference[0]
    axes = read_context_epochs(folder, "comma2k19", ContextReplayConfig())[0].frame.axes
    path = ((reference - origin) @ axes)[::20, :2]
    roads = collection(tmp_path / "map.geojson", *roads_at(origin, (path, {"name": "driven"})))
    found, _ = replay_folder(folder, tmp_path, roads=roads)
    assert list(found["skipped"]) == ["position"]
    assert found["reasons"] == {"trusted": 50, "collecting": 10}
    wrong = read_context_epochs(folder, "comma2k19", ContextReplayConfig())[0]
    slip = replace(wrong, wheel_mps=1.1 * wrong.wheel_mps)
    judged = drive_context(slip, read_roads(roads), ContextReplayConfig())
    assert ContextReason.count(judged.reason)["speed_fault"] == 50  # wheels that turn a tenth too fast


def test_berlin_on_its_own_reference(tmp_path) -> None:
    """Levels of weighted RAIM in a street with reflections: mostly above 15 m, and yet exceeded; none is trusted."""
    folder = real("smartloc_berlin_potsdamer")
    epochs, _ = read_context_epochs(folder, "smartloc", ContextReplayConfig())
    path = epochs.truth_en_m[epochs.known]
    path = path[np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > 1.0])]
    roads = collection(tmp_path / "map.geojson", *roads_at(epochs.frame.origin_ecef_m, (path, {"name": "driven"})))
    found, _ = replay_folder(folder, tmp_path, roads=roads)
    assert found["level"]["within_limit"] < 0.1
    assert set(found["reasons"]) == {"unavailable", "position_fault"}
    assert found["rates"]["third phase, of points that reach it"]["ocdr"] is None
    assert _share(None) == "-"
    assert 15.0 < found["level"]["median_m"] < 30.0
    assert found["error"]["beyond_level"] > 30
