"""The two-state clock: its covariance, and the Allan deviation that comes out of it."""

import numpy as np
import pytest

from lanebound.integrity.sensors.clock import OCXO_H0, OCXO_HM2, TCXO_H0, TCXO_HM2, clock_gains
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS


@pytest.mark.parametrize(("h0", "hm2"), [(TCXO_H0, TCXO_HM2), (OCXO_H0, OCXO_HM2), (0.0, TCXO_HM2), (TCXO_H0, 0.0)])
def test_many_small_steps_have_the_covariance_of_a_large_one(h0, hm2):
    def covariance(dt):
        l11, l21, l22 = clock_gains(h0, hm2, dt)
        root = np.array([[l11, 0.0], [l21, l22]])
        return root @ root.T

    total, move = np.zeros((2, 2)), np.array([[1.0, 0.01], [0.0, 1.0]])
    for _ in range(100):
        total = move @ total @ move.T + covariance(0.01)
    np.testing.assert_allclose(total, covariance(1.0), rtol=1e-9)


def test_a_tcxo_has_its_allan_deviation_at_a_second():
    """``sigma_y^2(tau) = h0 / (2 tau) + (2 pi^2 / 3) tau h-2``: 4.8e-10 at 1 s. 20,000 samples: 4 sigma are 3 %."""
    gains, rng, n = clock_gains(TCXO_H0, TCXO_HM2, 1.0), np.random.default_rng(1), 20_000
    z = rng.standard_normal((n, 2))
    drift = np.cumsum(gains[1] * z[:, 0] + gains[2] * z[:, 1])
    offset = np.cumsum(gains[0] * z[:, 0] + np.append(0.0, drift[:-1])) / SPEED_OF_LIGHT_MPS
    allan = np.sqrt(0.5 * np.mean(np.diff(offset, 2) ** 2))
    assert allan == pytest.approx(np.sqrt(TCXO_H0 / 2 + 2 * np.pi**2 / 3 * TCXO_HM2), rel=0.03)


def test_a_perfect_clock_stands():
    assert clock_gains(0.0, 0.0, 0.1) == (0.0, 0.0, 0.0)
