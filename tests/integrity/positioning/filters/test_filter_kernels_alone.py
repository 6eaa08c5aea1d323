"""Kernels of the filters by themselves: vectors that are not finite, and the noise of white accelerations."""

import numpy as np
import pytest

from lanebound.integrity.positioning.filters.correction_kernel import UNTESTED, Models, observe, vector_of
from lanebound.integrity.positioning.filters.motion_kernel import fill_noise
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES, WHITE


@pytest.mark.parametrize("threshold", [UNTESTED, 9.0])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_vector_that_is_not_finite_changes_nothing(threshold, wrong):
    for angular in (False, True):
        models = Models(
            np.zeros((2, STATES)), np.tile(np.eye(STATES), (2, 1, 1)), np.zeros((2, STATES, 3)), np.zeros(2)
        )
        vector = vector_of(3)
        vector.z[0], vector.h[0, S.HEADING] = wrong, 1.0
        vector.r[0, 0] = vector.single[0, 0] = 1.0
        _, used = observe(models, vector, 1, threshold, angular)
        assert not used
        assert not models.x.any()
        assert not models.likelihood.any()
        np.testing.assert_array_equal(models.p, np.tile(np.eye(STATES), (2, 1, 1)))


def test_a_white_slip_rate_moves_a_straight_model_as_its_integral():
    """Of an angle that is a random walk of density q, a car at speed v moves across by ``v^2 q^2 T^3 / 3``, with a
    covariance of ``v q^2 T^2 / 2`` with the angle."""
    x, g, dt, q = np.zeros(STATES), np.zeros((STATES, WHITE)), 0.1, 0.3
    x[S.SPEED] = 10.0
    fill_noise(x, dt, False, np.array([0.0, 0.0, q, 0.0, 0.0, 0.0, q]) / np.sqrt(dt), g)
    found = g @ g.T
    assert found[S.EAST, S.EAST] == pytest.approx(100.0 * q**2 * dt**3 / 3.0, rel=1e-12)
    assert found[S.EAST, S.SLIP] == pytest.approx(10.0 * q**2 * dt**2 / 2.0, rel=1e-12)
    assert found[S.SLIP, S.SLIP] == pytest.approx(q**2 * dt, rel=1e-12)
    assert found[S.NORTH, S.NORTH] == 0.0
