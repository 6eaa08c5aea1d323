"""A recorded sky on a lane network: walls stay on their side whatever way the lane runs, and environments play it."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from city_drives import simulated, walled
from highway_env.road.road import RoadNetwork
from recorded_skies import LENGTH_M, wall_on_the_left

from lanebound.envs.config import EnvConfig
from lanebound.envs.sky import SkyLevel, Street, build_street, cache
from lanebound.envs.worlds.networks import city_loop
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.replay.sky_record import record_sky
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SignalPath

TURN = 2.0 * np.pi


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "streets")
    monkeypatch.setattr(cache, "_recent", OrderedDict())
    path = tmp_path / "wall.csv"
    wall_on_the_left().save(path)
    return path


def straight(length_m: float = LENGTH_M) -> RoadNetwork:
    return RoadNetwork.straight_road_network(2, length=length_m)


def looked(street: Street, lane: tuple[str, str, int], s: float, azimuth_deg: float, elevation_deg: float) -> tuple:
    azimuth, elevation = np.radians([[azimuth_deg]]), np.radians([[elevation_deg]])
    arc, row = street.where(lane, s)
    one, none = np.array([[True]]), np.zeros((1, 1))
    view = SkyView(
        np.zeros((1, 1, 3)), elevation, azimuth, none, none, one, np.zeros(1, np.int64), np.ones(1, np.int64),
        np.zeros(1, np.int64),
    )  # fmt: skip
    found = street.mask.look(np.array([arc]), np.array([row]), view)
    assert int(street.forecast.count(np.array([arc]), np.array([row]), view)[0]) == (
        found.path[0, 0] <= SignalPath.FOLIAGE
    )
    return SignalPath(found.path[0, 0]), float(found.excess_m[0, 0])


def test_a_straight_road_eastward_has_the_wall_in_its_north(file: Path) -> None:
    street = build_street(straight(), SkyLevel.named(str(file)), 0)
    north = np.array([looked(street, ("0", "1", 0), s, 0.0, 45.0)[0] == SignalPath.BLOCKED for s in range(0, 400, 5)])
    assert 35 <= north.sum() <= 45  # 200 of 400 m
    assert np.abs(np.diff(north.astype(int))).sum() <= 3  # in one piece of a loop
    inside = [s for s, wall in zip(range(0, 400, 5), north, strict=True) if wall][len(north) // 8]
    assert looked(street, ("0", "1", 1), inside, 180.0, 45.0) == (SignalPath.LOS, 0.0)
    assert looked(street, ("0", "1", 1), inside, 180.0, 15.0) == (SignalPath.REFLECTED, 25.0)


def test_on_a_loop_the_wall_stays_to_the_left(file: Path) -> None:
    network = city_loop(4.0)
    street = build_street(network, SkyLevel.named(str(file)), 3, (("a", "b", 0.0, 100.0, "tunnel"),))
    lost = 0
    for a, b in (("a", "b"), ("b", "c"), ("c", "d"), ("d", "a")):
        lane = network.get_lane((a, b, 0))
        for s in np.arange(0.0, lane.length, 20.0):
            travel = 90.0 + np.degrees(lane.heading_at(float(s)))
            right = looked(street, (a, b, 0), s, (travel + 90.0) % 360.0, 45.0)
            left = looked(street, (a, b, 0), s, (travel - 90.0) % 360.0, 45.0)
            assert right == (SignalPath.LOS, 0.0)
            lost += left[0] == SignalPath.BLOCKED
    assert 60 <= lost <= 90  # half of 3 km


def test_layouts_begin_elsewhere_and_equal_ones_are_equal(file: Path) -> None:
    level = SkyLevel.named(str(file))
    tables = [build_street(straight(), level, n, reuse=False).mask.path for n in (0, 0, 1)]
    np.testing.assert_array_equal(tables[0], tables[1])
    assert (tables[0] != tables[2]).any()


def test_a_street_is_built_anew_when_the_file_has_changed(file: Path) -> None:
    first = build_street(straight(), SkyLevel.named(str(file)), 0)
    assert build_street(straight(), SkyLevel.named(str(file)), 0) is first
    cache._recent.clear()
    kept = build_street(straight(), SkyLevel.named(str(file)), 0)
    np.testing.assert_array_equal(kept.mask.path, first.mask.path)
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("reflected,25.00", "reflected,125.00"), encoding="utf-8")
    again = build_street(straight(), SkyLevel.named(str(file)), 0)
    assert again.mask.excess_m.max() == 125.0


def test_files_that_cannot_be_played_are_named(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv', which is none: make it by 'lanebound record-sky'"):
        EnvConfig.build({"base": "highway-v0"}, {"sky": "none.csv"})
    level = SkyLevel.named(str(file))
    file.write_text(file.read_text(encoding="utf-8")[:-10], encoding="utf-8")
    with pytest.raises(InputError, match=r"must be a whole recording, got .*wall\.csv, stopped at line"):
        build_street(straight(), level, 0)
    file.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        build_street(straight(), level, 0)


def test_its_link_and_instruments_are_those_of_a_level_in_town(file: Path) -> None:
    recorded, urban = SkyLevel.named(str(file)), SkyLevel.named("urban")
    assert recorded.navigator() == urban.navigator()
    assert recorded.recording == str(file)


def test_what_was_recorded_is_received_where_it_was(file: Path) -> None:
    recording = record_sky(walled(simulated(50.0), 15.0, 35.0))
    recording.save(file)
    network = RoadNetwork.straight_road_network(1, length=recording.length_m + 1.0)
    for layout in range(3):
        street = build_street(network, SkyLevel.named(str(file)), layout, reuse=False)
        phase = recording.length_m * named_generator(layout, "city").random(1)[0]
        place = np.mod(recording.arc_m - phase, recording.length_m)
        n, one = recording.arc_m.size, np.zeros((recording.arc_m.size, 1))
        azimuth = np.mod(recording.azimuth_rad + 0.5 * np.pi, TURN)  # the road runs East
        view = SkyView(
            np.zeros((n, 1, 3)), recording.elevation_rad[:, None], azimuth[:, None], one, one, one == 0.0,
            np.zeros(1, np.int64), np.ones(1, np.int64), np.arange(n),
        )  # fmt: skip
        found = street.mask.look(place, np.zeros(n, np.int64), view)
        same = found.path[:, 0] == recording.path
        assert same.mean() > 0.95  # stations do not fall on the middles of stretches
        late = same & (recording.path == SignalPath.REFLECTED)
        assert late.sum() > 10
        np.testing.assert_allclose(found.excess_m[late, 0], recording.excess_m[late], atol=8.0)  # of a neighbour


def test_an_environment_plays_a_recorded_drive(file: Path) -> None:
    record_sky(walled(simulated(60.0), 20.0, 40.0, blocked_deg=80.0)).save(file)
    env = gymnasium.make("lanebound/UrbanCanyon-v0", config={"sky": str(file), "world": {"vehicles_count": 0}})
    env.reset(seed=3)
    satellites = []
    for _ in range(120):
        _, _, terminated, truncated, _ = env.step(1)
        satellites.append(env.unwrapped.belief_loop.belief().satellites)
        if terminated or truncated:
            break
    env.close()
    assert min(satellites) < 0.75 * max(satellites)
