"""Reflection and diffraction against closed forms, limits and published values."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from lanebound.integrity.sky.propagation_kernel import (
    antenna_amplitude,
    arrival_direction,
    diffraction_loss_db,
    edge_detour,
    excess_path,
    excess_rate,
    fresnel_parameter,
    permittivity,
    reflection_coefficients,
)

L1_HZ, C = 1575.42e6, 299792458.0
angles = st.floats(0.01, 1.5)
turns = st.floats(0.0, 2.0 * math.pi)


def unit(azimuth: float, elevation: float) -> np.ndarray:
    c = math.cos(elevation)
    return np.array([c * math.sin(azimuth), c * math.cos(azimuth), math.sin(elevation)])


@settings(max_examples=200, deadline=None)
@given(turns, angles, turns, st.floats(0.5, 80.0))
def test_excess_is_that_of_the_image_and_of_the_closed_form(az: float, el: float, az_n: float, d: float) -> None:
    """The mirrored antenna is farther from the satellite by exactly L; a vertical face gives S3's formula."""
    e, n = unit(az, el), unit(az_n, 0.0)
    if e @ n <= 0.0:
        n = -n
    excess = excess_path(e, n, d)
    assert excess == pytest.approx(2.0 * d * math.cos(el) * abs(math.cos(az - az_n)), abs=1e-9)
    far = 1e7 * e  # satellite, antenna in the origin; the face at -d n, so the image of the antenna at -2 d n
    image = np.linalg.norm(far + 2.0 * d * n) - np.linalg.norm(far)
    assert image == pytest.approx(excess, abs=2e-3)  # of a wave that is not quite plane: (2 d)^2 / 2e7
    arrival = np.array(arrival_direction(e, n))
    assert arrival @ n == pytest.approx(-(e @ n), abs=1e-12)
    assert np.linalg.norm(arrival) == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(turns, angles, turns, st.floats(0.5, 80.0), turns, st.floats(0.0, 30.0))
def test_doppler_of_a_reflection_is_the_derivative_of_its_path(
    az: float, el: float, az_n: float, d: float, course: float, speed: float
) -> None:
    e, n = unit(az, el), unit(az_n, 0.0)
    if e @ n <= 0.0:
        n = -n
    v = speed * unit(course, 0.0)

    def path(t: float) -> float:
        return float(-(e @ v) * t + excess_path(e, n, d + t * float(n @ v)))

    h = 1e-3
    numeric = (path(h) - path(-h)) / (2.0 * h)
    reflected = -float(np.array(arrival_direction(e, n)) @ v)
    assert reflected == pytest.approx(numeric, abs=1e-6)
    assert -float(e @ v) + excess_rate(e, n, v) == pytest.approx(reflected, abs=1e-9)


def test_a_perfect_conductor_reverses_the_handedness_at_normal_incidence() -> None:
    co, cross = reflection_coefficients(1.0, permittivity(1.0, 1e7, L1_HZ))
    assert abs(co) < 1e-3
    assert abs(cross) == pytest.approx(1.0, abs=1e-3)


def test_grazing_incidence_keeps_it() -> None:
    co, cross = reflection_coefficients(1e-4, permittivity(5.24, 0.066, L1_HZ))
    assert abs(co) == pytest.approx(1.0, abs=1e-3)
    assert abs(cross) < 1e-3


def test_normal_incidence_on_concrete_is_the_index_of_refraction() -> None:
    eps = permittivity(5.24, 0.0, L1_HZ)
    co, cross = reflection_coefficients(1.0, eps)
    index = math.sqrt(5.24)
    assert abs(cross) == pytest.approx((index - 1.0) / (index + 1.0), abs=1e-12)
    assert abs(co) == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(st.floats(1e-3, 1.0), st.floats(1.5, 12.0), st.floats(0.0, 1.0))
def test_no_energy_is_made(cos_theta: float, relative: float, conductivity: float) -> None:
    eps = permittivity(relative, conductivity, L1_HZ)
    co, cross = reflection_coefficients(cos_theta, eps)
    assert abs(co) ** 2 + abs(cross) ** 2 <= 1.0 + 1e-12
    smooth = antenna_amplitude(cos_theta, eps, 0.3, 0.0, C / L1_HZ)
    rough = antenna_amplitude(cos_theta, eps, 0.3, 0.02, C / L1_HZ)
    assert abs(rough) <= abs(smooth) + 1e-15
    assert cmath.isfinite(rough)


@pytest.mark.parametrize(("v", "loss_db"), [(-0.78, 0.0), (0.0, 6.0), (1.0, 13.9), (2.4, 20.5)])
def test_knife_edge_loss_has_the_values_of_the_recommendation(v: float, loss_db: float) -> None:
    """ITU-R P.526 figure 9; at v = 0 half the field, 6.02 dB."""
    assert diffraction_loss_db(v) == pytest.approx(loss_db, abs=0.25)


def test_an_edge_a_few_degrees_above_the_ray_blocks_it() -> None:
    """``v = angle sqrt(2 d / lambda)`` for an edge square to the ray, d away (ITU-R P.526)."""
    angle, d = math.radians(3.0), 15.0
    e, edge = (math.cos(0.5), 0.0, math.sin(0.5)), (d * math.cos(0.5 + angle), 0.0, d * math.sin(0.5 + angle))
    below, excess, _ = edge_detour(e, (0.0, 1.0, 0.0), edge, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert below == pytest.approx(angle, abs=1e-12)
    v = fresnel_parameter(excess, C / L1_HZ)
    assert v == pytest.approx(angle * math.sqrt(2.0 * d * L1_HZ / C), rel=angle**2)
    assert 10.0 < diffraction_loss_db(v) < 15.0


def over_the_edge(e: np.ndarray, t: np.ndarray, p: np.ndarray, x: np.ndarray) -> float:
    """Extra path over the point of the edge by which the path is shortest, searched for (Fermat)."""
    length = lambda s: float(-(e @ (p + s * t)) + np.linalg.norm(p + s * t - x))  # noqa: E731
    near = float((x - p) @ t)
    found = minimize_scalar(length, bounds=(near - 2e3, near + 2e3), method="bounded", options={"xatol": 1e-9})
    return float(found.fun + e @ x)


edges = given(
    turns, angles, turns, st.floats(-0.6, 0.6), st.floats(3.0, 60.0), st.floats(1.0, 40.0), turns, st.floats(0.0, 30.0)
)


@settings(max_examples=200, deadline=None)
@edges
def test_a_ray_over_an_edge_takes_the_shortest_way_and_its_doppler_is_the_derivative(
    az: float, el: float, az_t: float, slope: float, far: float, high: float, course: float, speed: float
) -> None:
    e, t, v = unit(az, el), unit(az_t, slope), speed * unit(course, 0.0)
    p = far * unit(az, 0.0) + np.array([0.0, 0.0, high])
    cone = abs(float(e @ t))
    assume(cone < 0.95 and np.linalg.norm(np.cross(p, t)) > 1.0)
    still = (0.0, 0.0, 0.0)

    def excess(s: float) -> float:
        return float(edge_detour(e, t, p, s * v, still)[1])

    assert excess(0.0) == pytest.approx(over_the_edge(e, t, p, np.zeros(3)), abs=1e-7)
    h = 1e-3
    numeric = (8.0 * (excess(h) - excess(-h)) - (excess(2 * h) - excess(-2 * h))) / (12.0 * h)
    assert edge_detour(e, t, p, np.zeros(3), v)[2] == pytest.approx(numeric, abs=1e-6)


def test_along_an_edge_a_diffracted_ray_has_the_doppler_of_the_direct_one() -> None:
    """A roof 8 m beside the street, the ray 60 degrees from its direction: the point of diffraction moves along."""
    e, north = unit(math.radians(60.0), math.radians(30.0)), np.array([0.0, 1.0, 0.0])
    edge = np.array([8.0, 0.0, 6.47])
    ahead, across = (edge_detour(e, north, edge, np.zeros(3), v) for v in (14.0 * north, np.array([14.0, 0.0, 0.0])))
    assert ahead[0] > 0.05
    assert ahead[2] == pytest.approx(0.0, abs=1e-12)
    assert abs(across[2]) > 0.5
