import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.frames import (
    ecef_from_enu_matrix,
    ecef_from_geodetic,
    enu_from_ecef,
    geodetic_from_ecef,
    rotate_covariance,
    track_from_enu_matrix,
    wrap_angle,
)

ANGLES = st.floats(-20.0, 20.0)
COORDINATES = st.floats(-1e4, 1e4)
few = settings(max_examples=40, deadline=None, derandomize=True)


def _rad(degrees, minutes=0.0, seconds=0.0):
    return math.radians(degrees + minutes / 60.0 + seconds / 3600.0)


@pytest.mark.parametrize(
    ("azimuth_deg", "at", "ct"),
    [  # of the point 3 m East, 4 m North; R = sqrt(1/2) or the 30-60-90 triangle, by hand
        (0.0, 4.0, 3.0),
        (90.0, 3.0, -4.0),
        (180.0, -4.0, -3.0),
        (270.0, -3.0, 4.0),
        (45.0, 7.0 / math.sqrt(2.0), -1.0 / math.sqrt(2.0)),
        (135.0, -1.0 / math.sqrt(2.0), -7.0 / math.sqrt(2.0)),
        (225.0, -7.0 / math.sqrt(2.0), 1.0 / math.sqrt(2.0)),
        (315.0, 1.0 / math.sqrt(2.0), 7.0 / math.sqrt(2.0)),
        (30.0, 1.5 + 2.0 * math.sqrt(3.0), 1.5 * math.sqrt(3.0) - 2.0),
    ],
)
def test_along_and_cross_track_in_every_quadrant(azimuth_deg, at, ct):
    np.testing.assert_allclose(track_from_enu_matrix(math.radians(azimuth_deg)) @ [3.0, 4.0], [at, ct], atol=1e-12)


@few
@given(theta=ANGLES)
def test_the_track_matrix_is_a_reflection(theta):
    r = track_from_enu_matrix(theta)
    np.testing.assert_array_equal(r, r.T)
    assert np.linalg.det(r) == pytest.approx(-1.0, abs=1e-12)
    np.testing.assert_allclose(r @ r, np.eye(2), atol=1e-12)


@few
@given(theta=ANGLES)
def test_motion_is_along_track_and_its_right_hand_is_cross_track(theta):
    forward = np.array([math.sin(theta), math.cos(theta)])
    right = np.array([math.sin(theta + math.pi / 2.0), math.cos(theta + math.pi / 2.0)])
    r = track_from_enu_matrix(theta)
    np.testing.assert_allclose(r @ forward, [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(r @ right, [0.0, 1.0], atol=1e-12)


def test_rotated_covariance_by_hand_and_in_batches():
    q = np.array([[4.0, 1.0], [1.0, 9.0]])
    np.testing.assert_allclose(rotate_covariance(q, 0.0), [[9.0, 1.0], [1.0, 4.0]], atol=1e-12)
    np.testing.assert_allclose(rotate_covariance(q, math.pi / 2.0), [[4.0, -1.0], [-1.0, 9.0]], atol=1e-12)
    # t = 45 deg: (E + N)/sqrt 2 and (E - N)/sqrt 2, so variances (4 + 9 +- 2)/2 and covariance (4 - 9)/2
    np.testing.assert_allclose(rotate_covariance(q, math.pi / 4.0), [[7.5, -2.5], [-2.5, 5.5]], atol=1e-12)
    theta = np.linspace(-4.0, 4.0, 15).reshape(3, 5)
    batch = rotate_covariance(np.broadcast_to(q, (3, 5, 2, 2)), theta)
    assert batch.shape == (3, 5, 2, 2)
    np.testing.assert_allclose(batch[2, 1], rotate_covariance(q, theta[2, 1]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.eigvalsh(batch), np.broadcast_to(np.linalg.eigvalsh(q), (3, 5, 2)), atol=1e-9)


@few
@given(angle=st.floats(-1e4, 1e4))
def test_wrapping_keeps_the_direction_and_the_range(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.remainder(wrapped - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-11)


def test_wrapping_at_the_seam():
    np.testing.assert_allclose(
        wrap_angle(np.array([math.pi, -math.pi, 3.0 * math.pi, 0.0])), [-math.pi, -math.pi, -math.pi, 0.0]
    )
    assert wrap_angle(np.zeros((2, 3))).shape == (2, 3)


def test_published_geocentric_coordinates():
    # IOGP (EPSG) Guidance Note 7-2, geographic/geocentric conversions, WGS 84 example
    found = ecef_from_geodetic(_rad(53, 48, 33.820), _rad(2, 7, 46.380), 73.0)
    np.testing.assert_allclose(found, [3771793.968, 140253.342, 5124304.349], atol=6e-4)
    lat, lon, height = geodetic_from_ecef([3771793.968, 140253.342, 5124304.349])
    assert lat == pytest.approx(_rad(53, 48, 33.820), abs=2e-10)
    assert lon == pytest.approx(_rad(2, 7, 46.380), abs=2e-10)
    assert height == pytest.approx(73.0, abs=1e-3)


def test_published_topocentric_coordinates():
    # IOGP (EPSG) Guidance Note 7-2, geocentric/topocentric conversions, WGS 84 example
    lat, lon = _rad(55), _rad(5)
    origin = ecef_from_geodetic(lat, lon, 200.0)
    np.testing.assert_allclose(origin, [3652755.3058, 319574.6799, 5201547.3536], atol=6e-5)
    found = enu_from_ecef(np.array([3771793.968, 140253.342, 5124304.349]) - origin, lat, lon)
    np.testing.assert_allclose(found, [-189013.869, -128642.040, -4220.171], atol=6e-4)


def test_axes_of_the_ellipsoid():
    np.testing.assert_allclose(ecef_from_geodetic(0.0, 0.0, 0.0), [6378137.0, 0.0, 0.0], atol=1e-6)
    # semi-minor axis b: NIMA TR8350.2, table 3.3
    np.testing.assert_allclose(ecef_from_geodetic(math.pi / 2.0, 0.0, 0.0), [0.0, 0.0, 6356752.3142], atol=1e-4)
    np.testing.assert_allclose(ecef_from_geodetic(0.0, math.pi / 2.0, 10.0), [0.0, 6378147.0, 0.0], atol=1e-6)


@few
@given(
    lat=st.floats(-math.pi / 2.0, math.pi / 2.0),
    lon=st.floats(-math.pi + 1e-9, math.pi - 1e-9),
    height=st.floats(-5e3, 3e7),  # from the deepest sea to beyond the satellites
)
def test_geodetic_round_trip(lat, lon, height):
    p = ecef_from_geodetic(lat, lon, height)
    found = geodetic_from_ecef(p)
    assert found[0] == pytest.approx(lat, abs=1e-11)
    assert found[2] == pytest.approx(height, abs=1e-6)
    np.testing.assert_allclose(ecef_from_geodetic(*found), p, atol=1e-6)


@few
@given(lat=st.floats(-1.57, 1.57), lon=st.floats(-math.pi, math.pi))
def test_local_axes_are_right_handed_and_point_as_named(lat, lon):
    m = ecef_from_enu_matrix(lat, lon)
    np.testing.assert_allclose(m.T @ m, np.eye(3), atol=1e-12)
    assert np.linalg.det(m) == pytest.approx(1.0)
    step = 1e-6
    here = ecef_from_geodetic(lat, lon, 0.0)
    for axis, moved in enumerate(
        [
            ecef_from_geodetic(lat, lon + step, 0.0),
            ecef_from_geodetic(lat + step, lon, 0.0),
            ecef_from_geodetic(lat, lon, 1.0),
        ]
    ):
        direction = (moved - here) / np.linalg.norm(moved - here)
        assert direction @ m[:, axis] == pytest.approx(1.0, abs=1e-6)


def test_geodesy_takes_leading_batch_axes():
    lat, lon, height = np.full((2, 3), 0.7), np.linspace(-1.0, 1.0, 3), 50.0
    p = ecef_from_geodetic(lat, lon, height)
    assert p.shape == (2, 3, 3)
    assert [v.shape for v in geodetic_from_ecef(p)] == [(2, 3)] * 3
    assert ecef_from_enu_matrix(lat, lon).shape == (2, 3, 3, 3)
    v = np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(enu_from_ecef(v, lat, lon)[1, 2], enu_from_ecef(v, 0.7, 1.0), atol=1e-14)
    np.testing.assert_allclose(
        np.linalg.norm(enu_from_ecef(v, lat, lon), axis=-1), np.full((2, 3), np.linalg.norm(v)), atol=1e-12
    )
