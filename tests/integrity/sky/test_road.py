"""Roads: poses, lanes, and the way back from a position."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.road import Road

BLOCK = Road.through([(0, 0), (0, 300), (400, 300), (400, 0)], closed=True, lane_count=3, corner_radius_m=20.0)
BEND = Road.through([(0, 0), (100, 0), (150, 80), (300, 80)], lane_count=2, corner_radius_m=30.0)


def test_length_of_a_rounded_block() -> None:
    # four sides less two tangents at each corner, plus a full circle
    assert pytest.approx(1400.0 - 8 * 20.0 + 2 * np.pi * 20.0, abs=1e-9) == BLOCK.length_m


def test_straight_road_in_every_quadrant() -> None:
    for heading in (0.3, 1.9, -2.6, -0.4):
        road = Road.straight(50.0, heading)
        position, found = road.pose_at(10.0, 2.0)
        s, c = np.sin(heading), np.cos(heading)
        np.testing.assert_allclose(position, [10 * s + 2 * c, 10 * c - 2 * s], atol=1e-12)
        assert found == pytest.approx(heading)


@pytest.mark.parametrize("road", [BLOCK, BEND])
def test_heading_is_the_direction_of_motion_and_arc_is_length(road: Road) -> None:
    arc = np.linspace(1.0, road.length_m - 1.0, 701)
    step = 1e-4
    v = (road.pose_at(arc + step)[0] - road.pose_at(arc - step)[0]) / (2 * step)
    _, heading = road.pose_at(arc)
    np.testing.assert_allclose(np.hypot(*v.T), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sin(np.arctan2(v[:, 0], v[:, 1]) - heading), 0.0, atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(-12.0, 12.0), st.sampled_from([BLOCK, BEND]))
def test_project_undoes_pose(share: float, lateral: float, road: Road) -> None:
    arc = share * road.length_m * 0.999
    found_arc, found_lateral = road.project(road.pose_at(arc, lateral)[0])
    apart = abs(found_arc - arc)
    assert min(apart, road.length_m - apart) < 1e-9
    assert found_lateral == pytest.approx(lateral, abs=1e-9)


def test_closed_roads_wrap() -> None:
    here, there = BLOCK.pose_at(25.0, 1.0), BLOCK.pose_at(25.0 + 3 * BLOCK.length_m, 1.0)
    np.testing.assert_allclose(here[0], there[0], atol=1e-9)
    np.testing.assert_allclose(BLOCK.pose_at(-1.0)[0], BLOCK.pose_at(BLOCK.length_m - 1.0)[0], atol=1e-9)
    assert 0.0 <= BLOCK.project(BLOCK.pose_at(BLOCK.length_m - 1e-7)[0])[0] < BLOCK.length_m


def test_open_roads_go_straight_on_past_their_ends() -> None:
    for arc in (-7.0, BEND.length_m + 7.0):
        position, _ = BEND.pose_at(arc, -3.0)
        assert BEND.project(position)[0] == pytest.approx(arc)
        assert BEND.project(position)[1] == pytest.approx(-3.0)


def test_lane_geometry() -> None:
    road = Road.straight(10.0, lane_count=3, lane_width_m=3.0)
    np.testing.assert_allclose(road.lane_lateral_m([0, 1, 2]), [3.0, 0.0, -3.0])  # lane 0 is the rightmost
    assert road.edge_m == 4.5
    two_way = Road.through([(0, 0), (0, 10)], lane_count=2, lane_width_m=3.0, shift_m=3.0)
    np.testing.assert_allclose(two_way.lane_lateral_m([0, 1]), [4.5, 1.5])
    assert two_way.edge_m == 6.0


def test_a_sampled_circle_keeps_its_radius() -> None:
    t = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    road = Road.through(50.0 * np.column_stack([np.sin(t), np.cos(t)]), closed=True, corner_radius_m=np.inf)
    assert road.length_m == pytest.approx(2 * np.pi * 50.0, rel=1e-3)
    np.testing.assert_allclose(np.diff(road.tangent_rad) / np.diff(road.arc_at_m), 1 / 50.0, rtol=2e-3)


@pytest.mark.parametrize(
    ("points", "options", "word"),
    [
        ([(0, 0)], {}, "P >= 2"),
        ([(0, 0), (0, 1)], {"closed": True}, "P >= 3"),
        ([(0, 0), (0, 0)], {}, "repeat"),
        ([(0, 0), (0, 9), (0, 0.5)], {}, "turn back"),
        ([(0, 0), (0, np.nan)], {}, "finite"),
        ([(0, 0, 0), (0, 1, 0)], {}, "shape"),
        ([(0, 0), (0, 9)], {"lane_count": 0}, "lane_count"),
        ([(0, 0), (0, 9)], {"lane_width_m": 0.0}, "lane_width_m"),
        ([(0, 0), (0, 9)], {"spacing_m": 5.0}, "spacing_m"),
        ([(0, 0), (0, 9)], {"corner_radius_m": -1.0}, "corner_radius_m"),
    ],
)
def test_bad_roads_are_refused(points: list[tuple[float, ...]], options: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        Road.through(points, **options)  # type: ignore[arg-type]
