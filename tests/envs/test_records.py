"""The plane of highway-env and the ground: positions, headings and lane coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.envs.records import azimuth_of, enu_of, xy_of
from lanebound.integrity.core.frames import track_from_enu_matrix

ANGLES = st.floats(-20.0, 20.0)
COORDINATES = st.floats(-1e4, 1e4)
few = settings(max_examples=40, deadline=None, derandomize=True)


@pytest.mark.parametrize(
    ("heading_deg", "azimuth_deg"),
    [(0.0, 90.0), (90.0, -180.0), (-90.0, 0.0), (180.0, -90.0), (45.0, 135.0), (-45.0, 45.0), (-135.0, -45.0)],
)
def test_highway_heading_to_azimuth(heading_deg, azimuth_deg):
    theta = azimuth_of(math.radians(heading_deg))
    assert math.cos(theta - math.radians(azimuth_deg)) == pytest.approx(1.0)
    assert math.sin(theta) == pytest.approx(math.sin(math.radians(azimuth_deg)))


@few
@given(x=COORDINATES, y=COORDINATES, h=ANGLES)
def test_highway_mapping_is_undone_and_keeps_directions(x, y, h):
    p = np.array([x, y])
    e, n = enu_of(p)
    assert (e, n) == (x, -y)
    np.testing.assert_array_equal(xy_of(enu_of(p)), p)
    theta = azimuth_of(h)
    moved = enu_of(p + np.array([math.cos(h), math.sin(h)])) - enu_of(p)
    np.testing.assert_allclose(moved, [math.sin(theta), math.cos(theta)], atol=1e-10)


@few
@given(h=ANGLES, x=COORDINATES, y=COORDINATES)
def test_track_coordinates_equal_highway_lane_coordinates(h, x, y):
    start = np.array([12.0, -7.0])
    lane = StraightLane(start, start + 100.0 * np.array([math.cos(h), math.sin(h)]))
    position = np.array([x, y])
    offset = enu_of(position) - enu_of(start)
    track = track_from_enu_matrix(azimuth_of(lane.heading)) @ offset
    np.testing.assert_allclose(track, lane.local_coordinates(position), atol=1e-8)
