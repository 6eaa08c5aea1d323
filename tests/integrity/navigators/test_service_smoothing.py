"""The stated variance of a smoothed code against the mean of a simulated Gauss-Markov error."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.navigators.services.code_kernel import smoothed_share


@pytest.mark.parametrize("tau", [1.0, 10.0])
def test_the_variance_of_a_mean_of_gauss_markov_errors_is_bounded(tau: float) -> None:
    rng, dt, runs = np.random.default_rng(4), 0.1, 20000
    rho, error, total = np.exp(-dt / tau), rng.standard_normal(runs), np.zeros(runs)
    for n in range(1, 1001):
        total += error
        error = rho * error + np.sqrt(1.0 - rho**2) * rng.standard_normal(runs)
        if n in (1, 10, 100, 1000):
            true = float(np.mean((total / n) ** 2))
            assert true / smoothed_share(tau, (n - 1) * dt) <= 1.05  # 5 sigma of 20000 runs
    assert true > 1.5 * tau / (tau + n * dt)  # the half of it is no bound
