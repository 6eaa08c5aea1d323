"""The error models of signals against what they state."""

from __future__ import annotations

import numpy as np
import plain_signals as signals
import pytest


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
