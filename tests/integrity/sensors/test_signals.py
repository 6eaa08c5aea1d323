"""The urban law against the measured table, and the compiled laws against their NumPy forms."""

from __future__ import annotations

import numpy as np
import plain_signals as signals
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.sensors import gnss_kernel as gk

# C/N0 range, median, robust sigma, share above 15 m: single-frequency u-blox, Berlin, Potsdamer Platz (smartLoc data).
# Within the outer bins, 45-54 and 15-25 dB-Hz hold the observations.
BERLIN = [
    (45.0, 54.0, 0.0, 3.4, 0.02),
    (40.0, 45.0, 1.4, 4.9, 0.16),
    (35.0, 40.0, 17.4, 20.0, 0.55),
    (30.0, 35.0, 33.6, 28.2, 0.76),
    (25.0, 30.0, 48.9, 36.9, 0.85),
    (15.0, 25.0, 103.1, 35.3, 0.99),
]
HIGH_SHARE = 0.5  # from here on, 25 % of the share above 15 m is what the table allows


@pytest.mark.parametrize(("low", "high", "median", "sigma", "share"), BERLIN)
def test_the_urban_law_has_the_measured_median_sigma_and_share(
    low: float, high: float, median: float, sigma: float, share: float
) -> None:
    """Each within 25 % or 1 m (1 %); 200,000 draws leave 1 % of scatter, so the seed does not matter."""
    n, rng = 200_000, np.random.default_rng(8)
    error = signals.urban_error_m(rng.uniform(low, high, n), rng.standard_normal(n), rng.standard_normal(n))
    middle = np.median(error)
    assert middle == pytest.approx(median, rel=0.25, abs=1.0)
    assert 1.4826 * np.median(np.abs(error - middle)) == pytest.approx(sigma, rel=0.25, abs=1.0)
    assert (error > 15.0).mean() == pytest.approx(share, rel=0.25, abs=0.01)


@given(cn0=st.floats(10.0, 60.0), u1=st.floats(-6.0, 6.0), u2=st.floats(-6.0, 6.0))
@settings(max_examples=200, deadline=None)
def test_compiled_and_plain_urban_law_agree(cn0: float, u1: float, u2: float) -> None:
    plain = float(signals.urban_error_m(cn0, u1, u2))
    compiled = gk.URBAN_OFFSET_M + gk.URBAN_CORE_M * u1 + gk.urban_excess(cn0, u2)
    assert compiled == pytest.approx(plain, rel=1e-9, abs=1e-9)


@given(cn0=st.floats(10.0, 60.0), u=st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=2))
@settings(max_examples=100, deadline=None)
def test_the_excess_is_one_sided_and_grows_with_its_normal(cn0: float, u: list[float]) -> None:
    low, high = signals.urban_excess_m(cn0, np.sort(u))
    assert 0.0 <= low <= high


def test_the_share_of_excess_is_the_declared_probability() -> None:
    n, rng = 100_000, np.random.default_rng(2)
    hit = (signals.urban_excess_m(40.0, rng.standard_normal(n)) > 0.0).mean()
    p = float(signals.urban_share(40.0))
    assert hit == pytest.approx(p, abs=4.0 * np.sqrt(p * (1 - p) / n))  # fails by chance once in 15000 seeds


def test_the_copula_keeps_the_marginal_and_lasts() -> None:
    """Along an AR(1) path the marginal stays, and an excess is mostly still there one epoch later."""
    rng, n = np.random.default_rng(4), 20_000
    u = rng.standard_normal(n)
    later = signals.ar1(u, 0.1, 3.0, rng.standard_normal(n))
    now, then = signals.urban_excess_m(42.0, u) > 0, signals.urban_excess_m(42.0, later) > 0
    assert then.mean() == pytest.approx(now.mean(), abs=0.02)
    assert then[now].mean() > 0.75


def test_ar1_is_stationary_with_its_correlation_time() -> None:
    rng, n = np.random.default_rng(6), 100_000
    x = rng.standard_normal(n)
    y = signals.ar1(x, 0.27, 0.54, rng.standard_normal(n))
    assert y.var() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / n))  # each fails by chance once in 15000 seeds
    assert (x * y).mean() == pytest.approx(np.exp(-0.5), abs=4.0 * np.sqrt(2.0 / n))


def test_noise_grows_towards_the_horizon_and_with_a_weak_signal() -> None:
    assert signals.elevation_scale(np.pi / 2, 95.0) == pytest.approx(1.0, abs=1e-6)
    # RTKLIB: sqrt(a^2 + (a / sin 30)^2) = a sqrt(5), over the zenith's a sqrt(2)
    assert signals.elevation_scale(np.pi / 6, 95.0) == pytest.approx(np.sqrt(2.5), abs=1e-6)
    assert signals.elevation_scale(np.pi / 2, 35.0) == pytest.approx(np.sqrt(2.0))


def test_atmosphere_is_ppm_of_the_baseline() -> None:
    assert signals.atmosphere_sigma_m(2.0, 10.0, np.pi / 2) == pytest.approx(0.02)
    assert signals.atmosphere_sigma_m(2.0, 10.0, np.pi / 6) == pytest.approx(0.04)
