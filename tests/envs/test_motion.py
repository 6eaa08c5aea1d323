"""The true motion of an epoch from poses alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.envs.motion import Motion
from lanebound.envs.records import azimuth_of, enu_of
from lanebound.integrity.motion.truth import truth_between

STEP, PER_EPOCH = 0.05, 2
ROWS = np.array([2, 0], dtype=np.int64)
NOWHERE = np.zeros(3), np.zeros(3, dtype=np.int64)


def _poses(k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two vehicles in bends, at step k."""
    t = STEP * k
    heading = np.array([0.3 * t, 1.0 - 0.2 * t])
    return np.array([[10.0 * t, 0.2 * t * t], [3.0, -4.0 * t]]), heading


def _moved(steps: int) -> Motion:
    motion = Motion.still(3, STEP)
    for row, (position, heading) in zip(ROWS, zip(*_poses(0), strict=True), strict=True):
        motion.enter(int(row), position, float(heading), 5.0)
    for k in range(1, steps + 1):
        motion.advance(ROWS, *_poses(k))
    return motion


def test_an_epoch_is_the_truth_between_the_poses_and_velocities_at_its_ends() -> None:
    motion = _moved(6)
    before, velocity, heading = motion.position_m.copy(), motion.velocity_mps, motion.heading_rad.copy()
    motion.epoch(0.3, 0.1, *NOWHERE)
    for k in (7, 8):
        motion.advance(ROWS, *_poses(k))
    expected = truth_between(
        0.4,
        0.1,
        (enu_of(before), enu_of(motion.position_m)),
        (enu_of(velocity), enu_of(motion.velocity_mps)),
        (azimuth_of(heading), azimuth_of(motion.heading_rad)),
    )
    found = motion.epoch(0.4, 0.1, *NOWHERE)
    for name in ("position_enu_m", "velocity_enu_mps", "heading_rad", "delta_theta_rad", "delta_v_mps", "distance_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_velocities_over_time_give_the_positions_back() -> None:
    motion, place = _moved(4), []
    velocity = []
    for k in range(5, 45):
        motion.advance(ROWS, *_poses(k))
        place.append(motion.position_m[0].copy())
        velocity.append(motion.velocity_mps[0])
    mean = 0.5 * (np.array(velocity[1:]) + np.array(velocity[:-1]))
    np.testing.assert_allclose(STEP * mean.sum(0), place[-1] - place[0], atol=0.02)


def test_slots_not_named_stay_where_they_are() -> None:
    motion = _moved(3)
    assert motion.position_m[1].tolist() == [0.0, 0.0]
    assert motion.epoch(0.15, 0.15, *NOWHERE).distance_m[1] == 0.0


def test_a_vehicle_that_enters_has_come_straight_on() -> None:
    motion = Motion.still(1, STEP)
    row = np.zeros(1, dtype=np.int64)
    motion.advance(row, np.array([[7.0, 7.0]]), np.zeros(1))
    motion.enter(0, np.array([10.0, 0.0]), 0.0, 8.0)
    motion.advance(row, np.array([[10.4, 0.0]]), np.zeros(1))
    truth = motion.epoch(0.1, STEP * PER_EPOCH, np.zeros(1), np.zeros(1, dtype=np.int64))
    assert truth.distance_m[0] == pytest.approx(0.8)
    np.testing.assert_allclose(truth.velocity_enu_mps[0], [8.0, 0.0, 0.0], atol=1e-12)
