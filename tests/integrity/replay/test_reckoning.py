"""Paths from wheel speed and yaw rate, and ranges on a turning Earth."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.replay.reckoning import reckon, turned
from lanebound.integrity.sky.orbit import EARTH_RATE_RADPS, ranges_and_sights
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS


def test_a_circle_to_the_right() -> None:
    t = np.linspace(0.0, 20.0, 2001)
    path = reckon(t, np.full(t.size, 5.0), np.full(t.size, 0.1))  # radius 50 m, centre to the East
    np.testing.assert_allclose(np.hypot(path.position_m[:, 0] - 50.0, path.position_m[:, 1]), 50.0, atol=1e-3)
    np.testing.assert_allclose(path.position_m[-1], [50.0 * (1 - np.cos(2.0)), 50.0 * np.sin(2.0)], atol=1e-3)
    assert path.distance_m[-1] == np.float64(100.0).round(6) or abs(path.distance_m[-1] - 100.0) < 1e-9
    assert abs(path.heading_rad[-1] - 2.0) < 1e-9


def test_a_point_ahead_of_the_axle_swings_out() -> None:
    t = np.linspace(0.0, 20.0, 2001)
    axle, front = (reckon(t, np.full(t.size, 5.0), np.full(t.size, 0.1), ahead) for ahead in (0.0, 3.0))
    lever = 3.0 * np.stack([np.sin(0.1 * t), np.cos(0.1 * t)], -1)
    np.testing.assert_allclose(front.position_m - axle.position_m, lever - lever[0], atol=1e-9)
    np.testing.assert_array_equal(front.distance_m, axle.distance_m)
    np.testing.assert_array_equal(front.position_m[0], [0.0, 0.0])


def test_more_heading_turns_a_path_clockwise() -> None:
    t = np.linspace(0.0, 4.0, 41)
    path = reckon(t, np.full(t.size, 3.0), np.full(t.size, 0.2))
    other = reckon(t, np.full(t.size, 3.0), np.full(t.size, 0.2)).position_m
    np.testing.assert_allclose(turned(other, np.pi / 2.0)[:, 0], path.position_m[:, 1], atol=1e-12)
    np.testing.assert_allclose(turned(other, np.pi / 2.0)[:, 1], -path.position_m[:, 0], atol=1e-12)


def test_the_turn_of_the_earth_is_the_textbook_correction() -> None:
    satellite, place = np.array([2.0e7, 1.2e7, 1.0e7]), np.array([3.8e6, 9.0e5, 5.0e6])
    distance, sight = ranges_and_sights(satellite, place)
    # first order: omega / c (x_s y_r - y_s x_r)
    expected = EARTH_RATE_RADPS / SPEED_OF_LIGHT_MPS * (satellite[0] * place[1] - satellite[1] * place[0])
    assert abs(distance - np.linalg.norm(satellite - place) - expected) < 1e-3
    assert abs(np.linalg.norm(sight) - 1.0) < 1e-12
