"""Kernels of the filters by themselves: vectors that are not finite, and the noise of white accelerations."""

import numpy as np
import pytest

from lanebound.integrity.positioning.filters.correction_kernel import UNTESTED, Models, observe, vector_of
from lanebound.integrity.positioning.filters.motion_kernel import fill_noise
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import MODEL, STATES, WHITE


@pytest.mark.parametrize("threshold", [UNTESTED, 9.0])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_vector_that_is_not_finite_changes_nothing(threshold, wrong):
    for angular in (False, True):
        filters, vector = np.zeros(2, MODEL), vector_of(3)
        filters["p"] = np.eye(STATES)
        models, row = Models(filters, np.zeros((2, STATES, 3))), vector.row[0]
        row["z"][0], row["h"][0, S.HEADING] = wrong, 1.0
        row["r"][0, 0] = row["single"][0, 0] = 1.0
        _, used = observe(models, vector, 1, threshold, angular)
        assert not used
        assert not filters["x"].any()
        assert not filters["likelihood"].any()
        np.testing.assert_array_equal(filters["p"], np.tile(np.eye(STATES), (2, 1, 1)))


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
