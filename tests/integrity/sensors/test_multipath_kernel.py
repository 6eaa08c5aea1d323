"""Several arrivals of one signal: against the discriminator on a grid, the numerical derivative, limits and bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.sensors.multipath_kernel import Loops, arrivals_of, code_delay, combine, strongest_of

L1_M, CHIP_M = 0.190294, 293.05
LOOPS = Loops(L1_M, CHIP_M, 0.1, 1.0, 15.0)


def discriminator(t: np.ndarray, weights: list[float], delays: list[float], half: float) -> np.ndarray:
    def triangle(x: np.ndarray) -> np.ndarray:
        return np.maximum(1.0 - np.abs(x), 0.0)

    total = triangle(t - half) - triangle(t + half)
    for w, d in zip(weights, delays, strict=True):
        total = total + w * (triangle(t - d - half) - triangle(t - d + half))
    return np.asarray(total)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-0.4, 0.4), st.floats(0.0, 1.4)), min_size=0, max_size=2),
    st.sampled_from([0.05, 0.1, 0.5, 1.0]),
)
def test_the_code_settles_where_early_and_late_are_equal(others: list[tuple[float, float]], spacing: float) -> None:
    weights, delays = [o[0] for o in others], [o[1] for o in others]
    none = (2 - len(others)) * [0.0]
    got = code_delay((*weights, *none), (*delays, *none), 0.5 * spacing)
    around = discriminator(np.array([got - 1e-6, got + 1e-6]), weights, delays, 0.5 * spacing)
    assert around[0] * around[1] <= 1e-11  # a zero, or a piece that is flat at zero
    assert abs(got) <= 0.5 * spacing * sum(abs(w) for w in weights) + 1e-12


@pytest.mark.parametrize("phase", [0.0, 1.0, math.pi])
def test_a_short_reflection_gives_the_closed_form(phase: float) -> None:
    a, excess = 0.3, 4.0
    shift = phase - 2.0 * math.pi * excess / L1_M  # so that the phase between the two is ``phase``
    found = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (a, shift, excess, 0.0)), 2, 0, LOOPS)
    c, s = a * math.cos(phase), a * math.sin(phase)
    assert found.code_m == pytest.approx(c * excess / (1.0 + c), abs=1e-9)
    assert found.carrier_m == pytest.approx(L1_M / (2 * math.pi) * math.atan2(s, 1.0 + c), abs=1e-12)
    assert found.amplitude == pytest.approx(math.hypot(1.0 + c, s), abs=1e-12)
    assert abs(found.carrier_m) < 0.25 * L1_M


def test_a_long_reflection_does_not_disturb_the_code_but_does_the_carrier() -> None:
    late = 1.06 * CHIP_M
    found = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 1.0, late, 0.0)), 2, 0, LOOPS)
    assert found.code_m == 0.0
    assert found.carrier_m != 0.0


def test_a_signal_without_its_direct_ray_is_late_by_the_whole_detour() -> None:
    found = combine(arrivals_of((0.2, 2.0, 31.0, -3.0)), 1, 0, LOOPS)
    assert (found.code_m, found.carrier_m, found.rate_mps) == (31.0, 0.0, -3.0)
    assert found.amplitude == 0.2


def test_the_strongest_arrival_is_tracked_even_if_it_is_late() -> None:
    arrivals = arrivals_of((0.1, 0.0, 0.0, 0.0), (0.4, 0.0, 20.0, 0.0))
    assert strongest_of(arrivals, 2) == 1
    found = combine(arrivals, 2, 1, LOOPS)
    assert 20.0 - 0.25 * 0.05 * CHIP_M <= found.code_m <= 20.0 + 0.25 * 0.05 * CHIP_M


@settings(max_examples=100, deadline=None)
@given(st.floats(0.05, 0.8), st.floats(0.0, 6.28), st.floats(1.0, 60.0), st.floats(-2.0, 2.0))
def test_the_range_rate_is_the_derivative_of_the_carrier(a: float, phase: float, excess: float, rate: float) -> None:
    """While the loop follows: at this rate of turn its gain is the same on both sides of the moment."""

    def carrier(t: float) -> float:
        found = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (a, phase, excess + rate * t, rate)), 2, 0, LOOPS)
        return float(found.carrier_m)

    h = 1e-5
    numeric = (carrier(h) - carrier(-h)) / (2.0 * h)
    found = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (a, phase, excess, rate)), 2, 0, LOOPS)
    assert found.rate_mps == pytest.approx(numeric, abs=1e-5)


def test_motion_averages_what_a_loop_cannot_follow() -> None:
    still = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 0.3, 8.0, 0.0)), 2, 0, LOOPS)
    fast = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 0.3, 8.0, 15.0)), 2, 0, LOOPS)
    assert abs(fast.code_m) < 0.05 * abs(still.code_m)
    assert abs(fast.carrier_m) < 0.3 * abs(still.carrier_m)
