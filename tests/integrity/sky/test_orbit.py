"""Kepler's equation, and orbits that obey Newton."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.orbit import (
    EARTH_RATE_RADPS,
    MU_M3PS2,
    OrbitElements,
    nodal_regression_radps,
    propagate,
    solve_kepler,
)


def _elements(**changes: float) -> OrbitElements:
    columns = {
        "semi_major_m": 26_559_700.0,
        "eccentricity": 0.02,
        "inclination_rad": 0.96,
        "node_longitude_rad": 1.0,
        "node_rate_radps": 0.0,
        "perigee_rad": 0.7,
        "mean_anomaly_rad": 0.3,
        "epoch_s": 1e9,
    }
    return OrbitElements.build(1, **(columns | changes))


@settings(max_examples=60, deadline=None)
@given(st.floats(-50.0, 50.0), st.floats(0.0, 0.99))
def test_kepler_equation_is_solved_for_any_ellipse(mean: float, e: float) -> None:
    big = solve_kepler(mean, e)
    assert big - e * np.sin(big) == pytest.approx(mean, abs=1e-11)
    assert abs(big - mean) <= e + 1e-12


def test_kepler_equation_golden() -> None:
    # Vallado, Fundamentals of Astrodynamics, example 2-1: M = 235.4 deg, e = 0.4 -> E = 220.512074767522 deg
    assert np.rad2deg(solve_kepler(np.deg2rad(235.4), 0.4)) == pytest.approx(220.512074767522, abs=1e-9)


@pytest.mark.parametrize("e", [-0.1, 1.0, np.nan])
def test_eccentricity_out_of_range_is_refused(e: float) -> None:
    with pytest.raises(InputError, match="eccentricity"):
        solve_kepler(0.1, e)


@pytest.mark.parametrize("e", [0.0, 0.02, 0.3])
def test_inertial_motion_obeys_newton(e: float) -> None:
    el = _elements(eccentricity=e)
    h = 20.0
    t = 1e9 + 5000.0 + h * np.arange(-1, 2)
    position, _ = propagate(el, t)
    turn = EARTH_RATE_RADPS * (t - t[1])
    c, s = np.cos(turn), np.sin(turn)
    x = position[:, 0]
    inertial = np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], -1)
    acceleration = (inertial[2] - 2.0 * inertial[1] + inertial[0]) / h**2
    gravity = -MU_M3PS2 * inertial[1] / np.linalg.norm(inertial[1]) ** 3
    np.testing.assert_allclose(acceleration, gravity, atol=2e-6)


def test_velocity_is_the_derivative_of_position() -> None:
    el = _elements(eccentricity=0.1, node_rate_radps=-8e-9)
    t = 1e9 + np.linspace(0.0, 43_000.0, 7)
    difference = (propagate(el, t + 0.5)[0] - propagate(el, t - 0.5)[0]) / 1.0
    np.testing.assert_allclose(propagate(el, t)[1], difference, atol=1e-4)


def test_perigee_and_apogee() -> None:
    el = _elements(eccentricity=0.1, mean_anomaly_rad=0.0)
    half = np.pi / el.mean_motion_radps[0]
    radius = np.linalg.norm(propagate(el, 1e9 + np.array([0.0, half]))[0][:, 0], axis=-1)
    np.testing.assert_allclose(radius, 26_559_700.0 * np.array([0.9, 1.1]), rtol=1e-12)


def test_nodal_regression_of_gps() -> None:
    # GPS SPS Performance Standard 2001, table A-2-1: -4.4874e-7 deg/s at 26 559.7 km and 55 deg
    rate = nodal_regression_radps(26_559_700.0, 0.0, np.deg2rad(55.0))
    assert np.rad2deg(rate) == pytest.approx(-4.4874e-7, rel=2e-3)


def test_join_and_take_keep_order() -> None:
    both = OrbitElements.join([_elements(perigee_rad=0.1), _elements(perigee_rad=0.2)])
    assert len(both) == 2
    assert both.take(np.array([1])).perigee_rad == 0.2
