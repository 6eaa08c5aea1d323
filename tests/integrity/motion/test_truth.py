import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.motion.truth import Truth, truth_between

RADIUS_M = 25.0


def _on_circle(t, speed, side, start=0.3):
    """Pose at time t on a circle driven at ``speed`` (negative: in reverse); side +1 has its centre to the right."""
    heading = start + side * speed * t / RADIUS_M
    forward = np.array([math.sin(heading), math.cos(heading)])
    right = np.array([math.cos(heading), -math.sin(heading)])
    centre = side * RADIUS_M * np.array([math.cos(start), -math.sin(start)])
    return centre - side * RADIUS_M * right, speed * forward, heading


def _circle_truth(dt, speed, side, t=1.0):
    (p0, v0, h0), (p1, v1, h1) = _on_circle(t - dt, speed, side), _on_circle(t, speed, side)
    return truth_between(t, dt, (p0, p1), (v0, v1), (h0, h1))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("speed", [12.0, -3.0])
def test_increments_on_a_circle(side, speed):
    dt = 0.1
    truth = _circle_truth(dt, speed, side)
    turn = side * speed * dt / RADIUS_M
    second_order = turn**2 / 24.0  # a chord is shorter than its arc by turn^2 / 24
    np.testing.assert_allclose(truth.delta_theta_rad, [[0.0, 0.0, turn]], atol=1e-12)
    assert truth.distance_m[0] == pytest.approx(speed * dt, rel=1.01 * second_order)
    # the specific force is centripetal: to the right in a right turn, whichever way the vehicle drives it
    centripetal = side * speed**2 / RADIUS_M * dt
    assert truth.delta_v_mps[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert truth.delta_v_mps[0, 1] == pytest.approx(centripetal, rel=1.01 * second_order)
    assert truth.delta_v_mps[0, 2] == pytest.approx(-GRAVITY_MPS2 * dt)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rates_converge_to_finite_differences_at_second_order(side):
    speed, errors = 10.0, []
    for dt in (0.4, 0.2):
        truth = _circle_truth(dt, speed, side, t=1.0 + dt / 2.0)  # epochs centred on the same instant
        step = 1e-4
        before, now, after = (_on_circle(1.0 + k * step, speed, side) for k in (-1, 0, 1))
        acceleration = (after[1] - before[1]) / (2.0 * step)
        right = np.array([math.cos(now[2]), -math.sin(now[2])])
        errors.append(abs(truth.delta_v_mps[0, 1] / dt - right @ acceleration))
        assert truth.delta_theta_rad[0, 2] / dt == pytest.approx((after[2] - before[2]) / (2.0 * step), abs=1e-8)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("azimuth_deg", [10.0, 100.0, 190.0, 280.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_braking_and_distance_along_a_straight_road(azimuth_deg, sign):
    theta, dt = math.radians(azimuth_deg), 0.5
    forward = np.array([math.sin(theta), math.cos(theta)])
    v0, v1 = sign * 8.0, sign * 6.0
    distance = 0.5 * (v0 + v1) * dt
    truth = truth_between(2.0, dt, (0.0 * forward, distance * forward), (v0 * forward, v1 * forward), (theta, theta))
    assert truth.distance_m[0] == pytest.approx(distance)
    np.testing.assert_allclose(truth.delta_v_mps, [[-sign * 2.0, 0.0, -GRAVITY_MPS2 * dt]], atol=1e-12)
    np.testing.assert_array_equal(truth.delta_theta_rad, np.zeros((1, 3)))


def test_standstill_feels_gravity_and_nothing_else():
    zero = np.zeros((3, 2))
    h = np.array([0.0, 2.0, -3.0])
    truth = truth_between(1.0, 0.1, (zero + 5.0, zero + 5.0), (zero, zero), (h, h))
    np.testing.assert_array_equal(truth.distance_m, np.zeros(3))
    np.testing.assert_array_equal(truth.delta_theta_rad, np.zeros((3, 3)))
    np.testing.assert_allclose(truth.delta_v_mps, np.tile([0.0, 0.0, -0.1 * GRAVITY_MPS2], (3, 1)), atol=1e-15)


@pytest.mark.parametrize(
    ("h0", "h1", "turn"),
    [(3.1, -3.1, 2.0 * math.pi - 6.2), (-3.1, 3.1, 6.2 - 2.0 * math.pi), (0.1, 6.3, 6.2 - 2.0 * math.pi)],
)
def test_turns_take_the_short_way_over_the_seam(h0, h1, turn):
    truth = truth_between(1.0, 0.1, ([0.0, 0.0], [0.0, 0.0]), ([0.0, 0.0], [0.0, 0.0]), (h0, h1))
    assert truth.delta_theta_rad[0, 2] == pytest.approx(turn)
    assert -math.pi <= truth.heading_rad[0] <= math.pi
    assert math.cos(truth.heading_rad[0] - h1) == pytest.approx(1.0)


def test_a_slip_sideways_is_seen_as_sideways_force():
    truth = truth_between(1.0, 0.1, ([0.0, 0.0], [0.1, 1.0]), ([0.0, 10.0], [0.5, 10.0]), (0.0, 0.0))
    np.testing.assert_allclose(truth.delta_v_mps[0, :2], [0.0, 0.5], atol=1e-12)
    assert truth.distance_m[0] == pytest.approx(math.hypot(0.1, 1.0))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(rotation=st.floats(-6.0, 6.0), seed=st.integers(0, 10_000))
def test_body_increments_do_not_depend_on_where_north_is(rotation, seed):
    rng = np.random.default_rng(seed)
    p0, v0, v1 = rng.normal(size=(3, 4, 2)) * 5.0
    h0 = rng.uniform(-3.0, 3.0, 4)
    h1 = h0 + rng.uniform(-1.0, 1.0, 4)
    p1 = p0 + v1
    c, s = math.cos(rotation), math.sin(rotation)
    clockwise = np.array([[c, s], [-s, c]])  # azimuths grow by ``rotation``
    place = np.zeros(4), np.zeros(4, np.int64)  # motion that no car can do, and that is not checked
    plain = Truth.between(1.0, 0.1, (p0, p1), (v0, v1), (h0, h1), *place)
    turned = Truth.between(
        1.0,
        0.1,
        (p0 @ clockwise.T, p1 @ clockwise.T),
        (v0 @ clockwise.T, v1 @ clockwise.T),
        (h0 + rotation, h1 + rotation),
        *place,
    )
    for name in ("delta_theta_rad", "delta_v_mps", "distance_m"):
        np.testing.assert_allclose(getattr(turned, name), getattr(plain, name), atol=1e-9)


def test_fields_hold_the_end_of_the_epoch():
    p, v = (np.zeros((2, 2)), np.array([[0.1, 0.2], [0.3, 0.4]])), (np.ones((2, 2)), np.full((2, 2), 2.0))
    truth = truth_between(7, 0.1, p, v, ([0.0, 0.0], [0.1, 0.2]), arc_m=[5.0, 6.0], lane=1)
    assert (truth.batch, truth.time_s, truth.dt_s) == (2, 7.0, 0.1)
    np.testing.assert_array_equal(truth.position_enu_m, [[0.1, 0.2, 0.0], [0.3, 0.4, 0.0]])
    np.testing.assert_array_equal(truth.velocity_enu_mps, [[2.0, 2.0, 0.0], [2.0, 2.0, 0.0]])
    np.testing.assert_allclose(truth.heading_rad, [0.1, 0.2])
    np.testing.assert_array_equal(truth.arc_m, [5.0, 6.0])
    np.testing.assert_array_equal(truth.lane, [1, 1])
    assert truth.lane.dtype == np.int64
    with pytest.raises(dataclasses.FrozenInstanceError):
        truth.time_s = 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt_s": 0.0}, "dt_s must be positive"),
        ({"dt_s": math.nan}, "dt_s must be positive"),
        ({"position_m": ([0.0, math.nan], [0.0, 0.0])}, r"position_m\[1\] = nan"),
        ({"velocity_mps": ([0.0, 0.0], [math.inf, 0.0])}, r"velocity_mps\[0\] = inf"),
        ({"heading_rad": (math.nan, 0.0)}, "heading_rad = nan"),
        ({"arc_m": math.nan}, "arc_m = nan"),
        ({"position_m": ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])}, r"position_m must have shape \(\.\.\., 1, 2\)"),
        ({"velocity_mps": (np.zeros((3, 2)), np.zeros((3, 2)))}, r"velocity_mps must have shape \(\.\.\., 1, 2\)"),
        ({"heading_rad": ([0.0, 0.0], 0.0)}, r"heading_rad must have shape \(\.\.\., 1\)"),
    ],
)
def test_unusable_input_is_refused_by_name(changes, message):
    zeros = ([0.0, 0.0], [0.0, 0.0])
    arguments = {"time_s": 0.0, "dt_s": 0.1, "position_m": zeros, "velocity_mps": zeros, "heading_rad": (0.0, 0.0)}
    with pytest.raises(InputError, match=message):
        truth_between(**(arguments | changes))


@pytest.mark.parametrize(
    ("moved", "velocity", "heading", "message"),
    [
        ([0.0, 100.0], [0.0, 10.0], 0.0, r"position_m must move by .* within 1.10 m, got 100.00 m at 10.00 m/s"),
        ([0.0, 1.0], [0.0, 36.0], 0.0, r"position_m must move by"),  # km/h in place of m/s
        (
            [0.0, 1.0],
            [0.0, 10.0],
            90.0,
            r"heading_rad must lie within 60 degrees .* got 90.00 rad with a course of 0.00",
        ),
        ([1.0, 0.0], [10.0, 0.0], 0.0, r"heading_rad must lie within"),  # an angle from East
        ([0.0, 1.0], [0.0, 10.0], 0.5, ""),
        ([0.0, -1.0], [0.0, -10.0], 0.1, ""),  # in reverse
        ([0.0, 0.0], [2.0, 0.0], 0.0, ""),  # too slow to have a course
    ],
)
def test_motion_that_contradicts_itself_is_refused(moved, velocity, heading, message):
    own = {
        "position_m": ([[0.0, 0.0]], [moved]),
        "velocity_mps": ([velocity], [velocity]),
        "heading_rad": (heading,) * 2,
    }
    if message:
        with pytest.raises(InputError, match=message):
            truth_between(0.1, 0.1, **own)
    else:
        assert truth_between(0.1, 0.1, **own).batch == 1


@pytest.mark.parametrize(("forward_m", "right_m"), [(1.5, 0.0), (0.0, -1.0), (2.0, 0.7)])
def test_another_point_of_a_turning_body_moves_as_its_positions_do(forward_m, right_m):
    dt, turn = 1e-3, 0.4
    still = np.zeros((1, 2))

    def at(heading):
        there = truth_between(0.0, dt, (still, still), (still, still), ([heading - turn * dt], [heading]), arc_m=[0.0])
        return there.at(forward_m, right_m)

    before, after = at(1.0), at(1.0 + turn * dt)
    moved = (after.position_enu_m - before.position_enu_m) / dt
    np.testing.assert_allclose(0.5 * (before.velocity_enu_mps + after.velocity_enu_mps), moved, atol=1e-6)
    along = [np.sin(1.0), np.cos(1.0), 0.0]
    assert before.position_enu_m[0] @ along == pytest.approx(forward_m)
    assert np.array_equal(at(1.0).distance_m, [0.0])
