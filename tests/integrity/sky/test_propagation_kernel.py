"""Reflection and diffraction against closed forms, limits and published values."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.sky.propagation_kernel import (
    antenna_amplitude,
    arrival_direction,
    diffraction_loss_db,
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
    v = fresnel_parameter(math.radians(3.0), 15.0, C / L1_HZ)
    assert v == pytest.approx(math.radians(3.0) * math.sqrt(30.0 * L1_HZ / C))
    assert 10.0 < diffraction_loss_db(v) < 15.0
