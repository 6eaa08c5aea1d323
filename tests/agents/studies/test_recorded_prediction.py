"""Predicted and received satellites of a recorded drive: hand-made cases, and a made-up recording in a real model."""

from __future__ import annotations

import gzip
import shutil

import numpy as np
import pytest
from recordings import real

from lanebound.agents.studies import recorded_prediction as study
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import GroundTruth
from lanebound.integrity.sky.broadcast import positions, read_navigation
from lanebound.integrity.sky.scene import City, prisms
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS

MODEL, MESSAGES = "city3d_berlin_lod2", "smartloc_potsdamer_raw_first150s"
CONFIG = study.RecordedPredictionConfig()
BEGAN_S = 1900 * 604_800 + 130_925.8  # GPS time of the truth's time 0, by recorded satellite positions


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])


def street() -> tuple[study.RecordedSky, City]:
    """Two places; 10 m north of the first is a wall of 20 m, over 200 m. Six satellites, received as they should be."""
    wall = City.of(prisms(np.array([[(-100.0, 10.0), (100.0, 10.0), (100.0, 12.0), (-100.0, 12.0)]]), 0.0, 20.0))
    wall = City(wall.triangles_enu_m, wall.surface, np.zeros(len(wall), np.int64))
    los = np.array([direction(*at) for at in ((0, 30), (0, 75), (180, 30), (90, 50), (270, 40), (10, 5))])
    cn0 = np.array([[0.0, 45.0, 46.0, 47.0, 48.0, 40.0], [44.0, 45.0, 46.0, 47.0, 33.0, 40.0]])
    place = np.array([[0.0, 0.0, 1.5], [0.0, -200.0, 1.5]])
    above = np.tile(los[:, 2] >= np.sin(np.radians(10.0)), (2, 1))
    return study.RecordedSky(
        np.arange(2.0), place, np.tile(los, (2, 1, 1)), cn0, above, np.arange(1, 7), 0.0, np.array([0, 1])
    ), wall


def test_a_wall_blocks_what_is_low_behind_it() -> None:
    sky, city = street()
    assert study.predicted(sky, city).tolist() == [
        [False, True, True, True, True, False], [True, True, True, True, True, False]
    ]  # fmt: skip


def test_numbers_and_pairs_are_counted_above_the_mask() -> None:
    sky, city = street()
    found = study.compared(sky, city, CONFIG.replace(height_sigmas_m=[0.0], least_cn0_dbhz=[0.0, 40.0]))
    everything, strong = found["differences"]
    assert (everything["mean"], everything["mean_abs"], everything["agree"]) == (0.0, 0.0, 1.0)
    assert everything["pdop"] == pytest.approx(0.0)
    assert (strong["mean"], strong["mean_abs"], strong["most"]) == (-0.5, 0.5, 1.0)
    assert strong["agree"] == pytest.approx(0.9)
    assert found["cn0_dbhz"]["in sight"] == {"pairs": 9, "received": 9, "quartiles": [45.0, 46.0, 47.0]}
    assert found["cn0_dbhz"]["blocked"] == {"pairs": 1, "received": 0, "quartiles": None}
    assert found["series"]["40"] == [4, 4]
    by = {(d["passage"], d["cn0_dbhz"]): (d["places"], d["mean"]) for d in found["passages"]}
    assert by == {(0, 0.0): (1, 0.0), (0, 40.0): (1, 0.0), (1, 0.0): (1, 0.0), (1, 40.0): (1, -1.0)}
    for rows in (study.recorded_rows, study.passage_rows, study.sight_rows):
        head, cells = rows(found)
        assert all(len(row) == len(head) for row in cells)


def test_errors_of_heights_change_what_is_near_the_edge_alone() -> None:
    sky, city = street()
    found = study.compared(sky, city, CONFIG.replace(height_sigmas_m=[0.0, 5.0], least_cn0_dbhz=[0.0]))
    assert found["differences"][1]["agree"] > 0.98  # 30 degrees are 7 m high at the wall
    low = sky._replace(los_enu=np.where(np.arange(6)[:, None] == 0, direction(0, 60), sky.los_enu))  # 18.8 m there
    again = study.compared(low, city, CONFIG.replace(height_sigmas_m=[5.0], least_cn0_dbhz=[0.0]))
    assert 0.91 < again["differences"][0]["agree"] < 0.99  # a fifth to a half of one pair in ten


def test_places_inside_and_apart() -> None:
    _, city = street()
    square = City.of(prisms(np.array([[(0.0, 0.0), (100.0, 0.0), (100.0, 60.0), (0.0, 60.0)]]), 0.0, 5.0))
    assert len(city)
    inside = study._inside_m(square, np.array([[50.0, 30.0], [95.0, 30.0], [-4.0, 30.0]]))
    assert inside == pytest.approx([30.0, 5.0, -4.0])
    line = np.column_stack([np.arange(0.0, 20.0, 2.0), np.zeros(10)])
    assert study._spaced(line, np.arange(10) != 0, 5.0).tolist() == [1, 4, 7]


def made_up(folder) -> None:
    """The real truth and model, with satellites of the messages, all received at 45 dB-Hz."""
    for path in (*real(MODEL).glob("*GT*"), *real(MODEL).glob("*.citygml.gz"), *real(MESSAGES).glob("*n.gz")):
        shutil.copy(path, folder)
    truth = np.loadtxt(next(folder.glob("*GT*")), usecols=(1, 2, 3, 4))
    path, lines = GroundTruth(truth[:, 0], truth[:, 1:]), []
    messages = read_navigation(next(folder.glob("brdc*")))
    for time_s in (385.0, 390.0, 395.0, 655.0):
        states = positions(messages, [BEGAN_S + time_s], 0.075)
        seen = states.position_ecef_m[0]
        place = path.at(np.array([time_s]))[0][0]
        for k in np.flatnonzero(states.usable[0]):
            up = (seen[k] - place) @ place / np.linalg.norm(place) / np.linalg.norm(seen[k] - place)
            if up > 0.1:
                words = [
                    time_s,
                    0.075 * SPEED_OF_LIGHT_MPS,
                    25.0,
                    *seen[k].tolist(),
                    states.satellite[k, 1],
                    1,
                    40.0,
                    45,
                ]
                lines.append("pseudorange3 " + " ".join(map(repr, map(float, words[:6]))) + " " + " ".join(
                    str(int(w)) for w in words[6:]))  # fmt: skip
    with gzip.open(folder / "Made_Input.txt.gz", "wt") as out:
        out.write("\n".join(lines) + "\n")


def test_time_and_places_of_a_recording_are_found(tmp_path) -> None:
    made_up(tmp_path)
    sky, city = study.read_recorded(tmp_path, CONFIG)
    assert sky.misfit_m < 1.0
    assert sky.time_s.tolist() == [385.0, 390.0, 395.0, 655.0]
    assert (sky.cn0_dbhz[sky.above] == 45.0).all()  # all that the messages have above the mask was written
    assert sky.above.sum(1).min() >= 7
    assert sky.passage.tolist() == [0, 0, 0, 1]  # the drive leaves the model between 395 and 655 s
    blocked = sky.above & ~study.predicted(sky, city)
    assert blocked.any(1).all()  # streets between buildings
    with pytest.raises(InputError, match="inside of its city model"):
        study.read_recorded(tmp_path, CONFIG.replace(inside_m=150.0))
    other = tmp_path / "Made_Input.txt.gz"
    text = gzip.decompress(other.read_bytes()).decode().splitlines()
    words = [line.split() for line in text]
    for each in words:
        each[4] = repr(float(each[4]) + 3e5)
    other.write_bytes(gzip.compress("\n".join(" ".join(each) for each in words).encode()))
    with pytest.raises(InputError, match="messages of the day"):
        study.read_recorded(tmp_path, CONFIG)


def test_a_folder_without_a_model_is_refused(tmp_path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match="city model"):
            study.read_recorded(folder, CONFIG)


def test_errors_of_heights_leave_walls_where_they_are() -> None:
    sky, city = street()
    low = sky._replace(los_enu=np.where(np.arange(6)[:, None] == 0, direction(0, 60), sky.los_enu))  # 18.8 m there
    near = low._replace(place_enu_m=np.array([[0.0, 9.9, 1.5], [0.0, -200.0, 1.5]]))  # a wall moved by 0.7 m passes it
    found = study.compared(near, city, CONFIG.replace(height_sigmas_m=[0.0, 0.5], least_cn0_dbhz=[0.0]))
    assert found["differences"][0]["agree"] == found["differences"][1]["agree"]
