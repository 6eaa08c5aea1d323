"""Several arrivals of one signal: against the discriminator on a grid, the numerical derivative, limits and bounds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.sensors.arrival_kernel import (
    ARRIVAL,
    Loops,
    code_delay,
    combine,
    follow_carrier,
    strongest_of,
)

L1_M, CHIP_M = 0.190294, 293.05
LOOPS = Loops(L1_M, CHIP_M, 0.1, 1.0, 15.0)


def arrivals_of(*rows: tuple[float, float, float, float]) -> Any:
    """Records ARRIVAL from rows (amplitude, phase, excess, rate), new in this epoch."""
    return np.array([(*row, row[2], 0.0, 0.0) for row in rows], dtype=ARRIVAL)


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
    arrivals = arrivals_of((1.0, 0.0, 0.0, 0.0), (a, shift, excess, 0.0))
    found, carrier_m = combine(arrivals, 2, 0, LOOPS), follow_carrier(arrivals, 2, 0, LOOPS, math.nan)
    c, s = a * math.cos(phase), a * math.sin(phase)
    assert found.code_m == pytest.approx(c * excess / (1.0 + c), abs=1e-9)
    assert carrier_m == pytest.approx(L1_M / (2 * math.pi) * math.atan2(s, 1.0 + c), abs=1e-12)
    assert found.amplitude == pytest.approx(math.hypot(1.0 + c, s), abs=1e-12)
    assert abs(carrier_m) < 0.25 * L1_M


def test_a_long_reflection_does_not_disturb_the_code_but_does_the_carrier() -> None:
    late = 1.06 * CHIP_M
    arrivals = arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 1.0, late, 0.0))
    assert combine(arrivals, 2, 0, LOOPS).code_m == 0.0
    assert follow_carrier(arrivals, 2, 0, LOOPS, math.nan) != 0.0


def test_a_signal_without_its_direct_ray_is_late_by_the_whole_detour() -> None:
    arrivals = arrivals_of((0.2, 0.0, 31.0, -3.0))
    found = combine(arrivals, 1, 0, LOOPS)
    assert (found.code_m, found.rate_mps) == (31.0, -3.0)
    assert follow_carrier(arrivals, 1, 0, LOOPS, math.nan) == 31.0
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
        arrivals = arrivals_of((1.0, 0.0, 0.0, 0.0), (a, phase, excess + rate * t, rate))
        return float(follow_carrier(arrivals, 2, 0, LOOPS, math.nan))

    h = 1e-5
    numeric = (carrier(h) - carrier(-h)) / (2.0 * h)
    found = combine(arrivals_of((1.0, 0.0, 0.0, 0.0), (a, phase, excess, rate)), 2, 0, LOOPS)
    assert found.rate_mps == pytest.approx(numeric, abs=1e-5)


def test_motion_averages_what_a_loop_cannot_follow() -> None:
    still = arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 0.3, 8.0, 0.0))
    fast = arrivals_of((1.0, 0.0, 0.0, 0.0), (0.5, 0.3, 8.0, 15.0))
    codes = [abs(combine(rays, 2, 0, LOOPS).code_m) for rays in (still, fast)]
    carriers = [abs(follow_carrier(rays, 2, 0, LOOPS, math.nan)) for rays in (still, fast)]
    assert codes[1] < 0.05 * codes[0]
    assert carriers[1] < 0.3 * carriers[0]


SLOW_LOOP = LOOPS._replace(carrier_hz=1e6)  # follows all turns: the sum is that of the amplitudes


Pair = tuple[float, float]  # of the two reflections


def swept(sizes: Pair, starts: Pair, rates: Pair, times: np.ndarray) -> np.ndarray:
    """Carrier of a direct ray and two reflections at the given times [m], epoch by epoch."""
    last, found, before = math.nan, [], None
    for t in times:
        rows = [(1.0, 0.0, 0.0, 0.0)]
        rows += [(a, 0.3 * i, x + v * t, v) for i, (a, x, v) in enumerate(zip(sizes, starts, rates, strict=True))]
        arrivals = arrivals_of(*rows)
        if before is not None:
            arrivals["before_m"] = before
        last, before = float(follow_carrier(arrivals, 3, 0, SLOW_LOOP, last)), arrivals["excess_m"].copy()
        found.append(last)
    return np.array(found)


def phase_of_sum(sizes: Pair, starts: Pair, rates: Pair, t: Any) -> Any:
    """The sum as a complex number, by definition."""
    turns = [(x + v * t) / L1_M + 0.3 * i / (2.0 * math.pi) for i, (x, v) in enumerate(zip(starts, rates, strict=True))]
    return 1.0 + sum(a * np.exp(2j * math.pi * n) for a, n in zip(sizes, turns, strict=True))


@pytest.mark.parametrize("rates", [(0.6, 0.6), (1.3, -0.4), (4.0, 3.9), (9.0, 8.7)])
@pytest.mark.parametrize("sizes", [(0.9, 0.8), (0.7, 0.6), (0.4, 0.5), (0.95, 0.3)])
def test_the_carrier_follows_the_sum_around_the_origin(sizes: Pair, rates: Pair) -> None:
    """Against the unwrapped phase in steps of 0.1 ms, until the sum first fades below what a loop follows."""
    starts, fine = (4.0, 9.0), np.linspace(0.0, 12.0, 120_001)
    sums = phase_of_sum(sizes, starts, rates, fine)
    faded = np.flatnonzero(np.abs(sums) < 0.11)
    end = faded[0] // 1000 * 1000 if faded.size else 120_000
    expected = L1_M / (2.0 * math.pi) * np.unwrap(np.angle(sums))[: end + 1 : 1000]
    found = swept(sizes, starts, rates, fine[: end + 1 : 1000])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_reflections_stronger_than_the_tracked_arrival_take_the_carrier_along() -> None:
    """Two that turn together encircle the direct ray: a cycle for each turn, not an angle within half a cycle."""
    found = swept((0.9, 0.8), (4.0, 4.0 - 0.3 * L1_M / (2.0 * math.pi)), (1.0, 1.0), np.arange(0.0, 20.0, 0.1))
    turns = 1.0 * 19.9 / L1_M
    assert abs(found[-1] - found[0]) > (turns - 1.0) * L1_M


def test_a_fade_that_no_loop_follows_ends_at_the_nearest_cycle() -> None:
    times = np.arange(0.0, 3.0, 0.1)
    together = 4.0, 4.0 - 0.3 * L1_M / (2.0 * math.pi)
    found = swept((0.7, 0.35), together, (L1_M, L1_M), times)  # a turn a second, past the origin at 0.05
    assert (np.abs(np.diff(found)) <= 0.5 * L1_M).all()
