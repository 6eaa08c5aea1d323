"""The true motion of an epoch from poses alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.envs.batch.motion_kernel import MOTION, advance, fill_motion
from lanebound.envs.records import azimuth_of, enu_of
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.motion.truth_kernel import TRUTH

STEP, PER_EPOCH = 0.05, 2
ROWS = (2, 0)
HERE = np.zeros(1, dtype=np.int64)


def _poses(k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two vehicles in bends, at step k."""
    t = STEP * k
    heading = np.array([0.3 * t, 1.0 - 0.2 * t])
    return np.array([[10.0 * t, 0.2 * t * t], [3.0, -4.0 * t]]), heading


def _enter(motions: Any, row: int, position: Any, heading: float, speed: float) -> None:
    """A vehicle that has come straight on."""
    ahead = speed * np.array([np.cos(heading), np.sin(heading)])
    m = motions[0, row : row + 1]
    m["position"], m["start"], m["start_velocity"] = position, position, ahead
    m["chord"] = m["chord_before"] = STEP * ahead
    m["heading_rad"] = m["start_heading_rad"] = heading


def _advance(motions: Any, k: int) -> None:
    for row, (x, y), heading in zip(ROWS, *_poses(k), strict=True):
        advance(motions[0, row], x, y, heading)


def _epoch(motions: Any, epoch_s: float) -> Truth:
    """The truth of the epoch that ends now."""
    rows = np.zeros(motions.size, TRUTH)
    fill_motion(motions, HERE, STEP, -GRAVITY_MPS2 * epoch_s, rows)
    return Truth.of(0.4, epoch_s, rows)


def _moved(steps: int) -> Any:
    motions = np.zeros((1, 3), MOTION)
    for row, position, heading in zip(ROWS, *_poses(0), strict=True):
        _enter(motions, row, position, float(heading), 5.0)
    for k in range(1, steps + 1):
        _advance(motions, k)
    return motions


def _velocity(motions: Any) -> Any:
    return (1.5 * motions["chord"][0] - 0.5 * motions["chord_before"][0]) / STEP


def test_an_epoch_is_the_truth_between_the_poses_and_velocities_at_its_ends() -> None:
    motions = _moved(6)
    _epoch(motions, 0.3)
    before, velocity, heading = motions["position"][0].copy(), _velocity(motions), motions["heading_rad"][0].copy()
    for k in (7, 8):
        _advance(motions, k)
    expected = Truth.between(  # not checked: these vehicles drive sideways
        0.4,
        0.1,
        (enu_of(before), enu_of(motions["position"][0])),
        (enu_of(velocity), enu_of(_velocity(motions))),
        (azimuth_of(heading), azimuth_of(motions["heading_rad"][0])),
        np.zeros(3),
        np.zeros(3, np.int64),
    )
    found = _epoch(motions, 0.1)
    for name in ("position_enu_m", "velocity_enu_mps", "heading_rad", "delta_theta_rad", "delta_v_mps", "distance_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_velocities_over_time_give_the_positions_back() -> None:
    motions, place = _moved(4), []
    velocity = []
    for k in range(5, 45):
        _advance(motions, k)
        place.append(motions["position"][0, 0].copy())
        velocity.append(_velocity(motions)[0])
    mean = 0.5 * (np.array(velocity[1:]) + np.array(velocity[:-1]))
    np.testing.assert_allclose(STEP * mean.sum(0), place[-1] - place[0], atol=0.02)


def test_places_without_a_vehicle_stay_where_they_are() -> None:
    motions = _moved(3)
    assert motions["position"][0, 1].tolist() == [0.0, 0.0]
    assert _epoch(motions, 0.15).distance_m[1] == 0.0


def test_a_vehicle_that_enters_has_come_straight_on() -> None:
    motions = np.zeros((1, 1), MOTION)
    _enter(motions, 0, [10.0, 0.0], 0.0, 8.0)
    advance(motions[0, 0], 10.4, 0.0, 0.0)
    truth = _epoch(motions, STEP * PER_EPOCH)
    assert truth.distance_m[0] == pytest.approx(0.4)
    np.testing.assert_allclose(truth.velocity_enu_mps[0], [8.0, 0.0, 0.0], atol=1e-12)
