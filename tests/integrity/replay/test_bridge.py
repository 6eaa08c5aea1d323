"""Levels between solutions: what a solution says of its heading is heeded."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.risk import RiskConfig
from lanebound.integrity.replay.reckoning import Bridge, BridgeConfig

SIGMA = np.ones(2)
STILL = BridgeConfig(heading_sigma_deg=0.0, heading_walk_deg_per_sqrt_s=0.0, speed_sigma_mps=1e-9)


def _sigma_after(metres: float, with_heading: list[float] | None) -> np.ndarray:
    """Sigmas on AT, CT [m] after a way to the North from a solution good to a metre."""
    given = None if with_heading is None else np.array(with_heading)
    bridge = Bridge(STILL, RiskConfig(), np.eye(2), np.zeros(2), SIGMA, 0.0, with_heading=given)
    return np.asarray(bridge.step(1.0, metres, 0.0)[1])


@pytest.mark.parametrize(("covariance", "expected"), [(0.0, np.sqrt(2.0)), (0.1, 2.0), (-0.1, 0.0)])
def test_the_error_of_the_heading_goes_on_as_it_hangs_together_with_the_position(
    covariance: float, expected: float
) -> None:
    """A heading 0.1 rad to the East moves what is 10 m ahead by a metre to the East: errors add up, or cancel."""
    along, across = _sigma_after(10.0, [covariance, 0.0, 0.01])
    assert along == pytest.approx(1.0)
    assert across == pytest.approx(expected, abs=1e-6)


def test_the_larger_of_the_declared_and_the_solutions_own_variance_counts() -> None:
    assert _sigma_after(10.0, None)[1] == pytest.approx(1.0)
    declared = STILL.replace(heading_sigma_deg=10.0)
    for own in (0.0, 0.01):
        bridge = Bridge(declared, RiskConfig(), np.eye(2), np.zeros(2), SIGMA, 0.0, with_heading=np.array([0, 0, own]))
        assert bridge.growth.covariance[5, 5] == pytest.approx(max(np.radians(10.0) ** 2, own))


@pytest.mark.parametrize("turn", [0.5, np.pi, 2.0 * np.pi])
def test_a_wrong_axle_distance_is_bounded_through_a_turn(turn: float) -> None:
    """The reference point is off by the lever's error times the change of the heading's unit vector."""
    bound, level = 0.5, {}
    for declared in (0.0, bound):
        config = STILL.replace(axle_bound_m=declared)
        bridge = Bridge(config, RiskConfig(), 1e-9 * np.eye(2), np.zeros(2), SIGMA, 0.0)
        for heading in np.linspace(0.0, turn, 20):
            level[declared] = bridge.step(0.1, 0.0, heading)[0]
    along, across = bound * (1.0 - np.cos(turn)), bound * np.sin(turn)
    np.testing.assert_allclose(level[bound] - level[0.0], np.abs([along, across]), atol=1e-9)
