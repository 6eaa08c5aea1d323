"""The reference of vehicle filters: derivatives by differences, exact linear cases, consistency of matched models.

The kernels equal the reference (``tests/integrity/navigators/test_filter_kernels.py``).
"""

import numpy as np
from plain_kalman import correct, innovate
from plain_vehicle_filters import ProcessNoise, SigmaWeights, predict_extended, predict_unscented, sigma_points
from plain_vehicle_models import MotionInput, jacobian, noise_gain, scan_sigmas, transition
from scipy.stats import chi2

from lanebound.integrity.navigators.vehicle_filter.parameters import gate_threshold
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import NOISES, STATES

BOTH = np.array([False, True])


def any_state(rng, *shape):
    """States of plausible size."""
    scale = np.array([100, 100, 3, 0.5, 15, 0.2, 0.02, 0.1, 0.01, 0.01, 3, 0.01, 0.1, 0.05, 5, 5.0])
    return scale * rng.standard_normal((*shape, STATES))


def motion(accelerated=True, batch=()):
    turn = np.full((*batch, 1), 0.03)
    return MotionInput(0.1, turn, np.full((*batch, 1), 1.3), accelerated, 0.99, 0.98)


def test_jacobian_is_the_derivative_of_the_transition():
    rng = np.random.default_rng(1)
    x = any_state(rng, 20, 1)
    for accelerated in (True, False):
        u = motion(accelerated)
        f, step = jacobian(x, u), 1e-6
        for j in range(STATES):
            up, down = x.copy(), x.copy()
            up[..., j] += step
            down[..., j] -= step
            slope = (transition(up, u) - transition(down, u)) / (2.0 * step)
            np.testing.assert_allclose(f[..., j], slope, atol=2e-7)


def test_noise_gain_is_the_motion_under_a_constant_acceleration():
    """A yaw acceleration, an acceleration, a slip acceleration over a scan, against the integral of the motion."""
    x, dt, steps = np.zeros((1, STATES)), 0.1, 20_000
    x[0, [S.HEADING, S.SPEED, S.SLIP]] = 0.4, 12.0, 0.05
    push = np.array([0.02, 0.5, 0.01, 0.0, 0.0, 0.0, 0.0])  # small, so that the gain is linear
    pushed = transition(x, motion(False)) + (noise_gain(x, dt, np.array([True])) @ push[:, None])[..., 0]
    t = (np.arange(steps) + 0.5) * dt / steps
    course = 0.45 + 0.5 * push[0] * t**2 + 0.5 * push[2] * t**2
    speed = 12.0 + push[1] * t
    truth = np.array([np.sum(speed * np.sin(course)), np.sum(speed * np.cos(course))]) * dt / steps
    np.testing.assert_allclose(pushed[0, :2], truth, atol=1e-4)  # of third order
    np.testing.assert_allclose(pushed[0, S.HEADING] - 0.4, 0.5 * push[0] * dt**2, rtol=1e-9)
    assert noise_gain(x, dt, BOTH[:1])[0, S.SLIP, 2] == dt
    assert noise_gain(x, dt, BOTH[:1])[0, S.SLIP_RATE, 2] == 0.0


def test_a_linear_case_equals_batch_least_squares():
    """Constant velocity, positions measured: the filter's state is the weighted adjustment of all epochs to 1e-9."""
    rng = np.random.default_rng(2)
    dt, n = 0.5, 40
    f, g = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[0.5 * dt * dt], [dt]])
    q, r, h = 0.3**2, 2.0**2, np.array([[1.0, 0.0]])
    x, p = np.array([1.0, 2.0]), np.diag([9.0, 4.0])
    z = rng.standard_normal(n) * 5.0 + np.arange(n)
    rows, target, weight = [np.eye(2, 2 + n)[0], np.eye(2, 2 + n)[1]], [1.0, 2.0], [1 / 9.0, 1 / 4.0]
    state = np.eye(2, 2 + n)  # of the unknowns: start and n accelerations
    for k in range(n):
        x, p = f @ x, f @ p @ f.T + g @ g.T * q
        found = innovate(x, p, z[k : k + 1], h, np.array([[r]]))
        x, p, _ = correct(x, p, h, found)
        state = f @ state + g @ np.eye(1, 2 + n, 2 + k)
        rows += [state[0], np.eye(1, 2 + n, 2 + k)[0]]
        target += [z[k], 0.0]
        weight += [1 / r, 1 / q]
    a, w = np.array(rows), np.array(weight)
    normal = a.T @ (w[:, None] * a)
    solved = np.linalg.solve(normal, a.T @ (w * np.array(target)))
    np.testing.assert_allclose(x, state @ solved, atol=1e-9)
    np.testing.assert_allclose(p, state @ np.linalg.inv(normal) @ state.T, atol=1e-9)


def test_both_predictions_agree_where_the_motion_is_linear():
    """Without uncertainty of angles and rates the motion is linear in the rest of the state."""
    rng = np.random.default_rng(5)
    x = any_state(rng, 7, 2)
    x[:, 0, S.SLIP_RATE] = 0.0  # of the straight model
    root = rng.standard_normal((7, 2, STATES, STATES)) * 0.1
    fixed = [S.HEADING, S.SLIP, S.SLIDE, S.YAW_RATE, S.SLIP_RATE]
    root[..., fixed, :] = 0.0
    p = root @ np.swapaxes(root, -1, -2)
    noise = ProcessNoise(BOTH, np.tile([0.0, 0.3, 0.0, 0.0], (2, 1)), np.diag(np.full(STATES, 1e-4)))
    u = motion()
    ekf, ukf = predict_extended(x, p, u, noise), predict_unscented(x, p, u, noise)
    np.testing.assert_allclose(ukf[0], ekf[0], atol=1e-6)
    np.testing.assert_allclose(ukf[1], ekf[1], atol=1e-6)


def test_sigma_points_have_the_moments_of_the_state():
    rng = np.random.default_rng(6)
    root = rng.standard_normal((3, 5, 5))
    x, p = rng.standard_normal((3, 5)), root @ np.swapaxes(root, -1, -2)
    scale, mean, covariance = SigmaWeights().of(5)
    points = sigma_points(x, p, scale)
    assert mean[0] == 0.0  # alpha 1, kappa 0
    assert covariance[0] == 2.0  # beta 2
    np.testing.assert_allclose(mean @ points, x, atol=1e-12)
    apart = points - x[:, None]
    np.testing.assert_allclose(np.swapaxes(covariance[:, None] * apart, -1, -2) @ apart, p, atol=1e-9)


def test_the_unscented_mean_sees_the_curvature():
    """A heading of variance s^2 shortens the mean displacement by exp(-s^2/2); the extended filter misses that."""
    x, p = np.zeros((1, STATES)), np.zeros((1, STATES, STATES))
    x[0, S.SPEED], p[0, S.HEADING, S.HEADING] = 10.0, 0.1**2
    noise = ProcessNoise(BOTH[:1], np.zeros((1, NOISES)), np.zeros((STATES, STATES)))
    u = MotionInput(0.1, np.zeros(1), np.zeros(1))
    ukf = predict_unscented(x, p, u, noise)[0][0, S.NORTH]
    np.testing.assert_allclose(ukf, np.exp(-0.5 * 0.1**2), rtol=2e-4)
    assert predict_extended(x, p, u, noise)[0][0, S.NORTH] == 1.0


def simulate(predict, vehicles=400, epochs=60, seed=11):
    """Vehicles that move as the straight model says; NEES of the last state and NIS of all positions."""
    rng = np.random.default_rng(seed)
    shape, sigma = (vehicles, 1), np.array([[0.02, 0.3, 0.004, 0.0]])
    errors = np.zeros((STATES, STATES))
    errors[S.GYRO_ANGLE, S.GYRO_ANGLE] = 1e-6
    noise = ProcessNoise(np.array([False]), sigma, errors)
    x, p = np.zeros((*shape, STATES)), np.zeros((*shape, STATES, STATES))
    x[..., S.SPEED] = 12.0
    start = {S.EAST: 1.0, S.NORTH: 1.0, S.HEADING: 0.02, S.YAW_RATE: 0.01, S.SPEED: 0.3, S.SLIP: 0.01}
    for place, sd in start.items():
        p[..., place, place] = sd**2
    truth = x + np.sqrt(np.diagonal(p, axis1=-2, axis2=-1)) * rng.standard_normal(x.shape)
    h, r = np.zeros((3, STATES)), np.diag([1.0, 1.0, 0.05**2])
    h[0, S.EAST] = h[1, S.NORTH] = h[2, S.SPEED] = 1.0
    nis = []
    for _ in range(epochs):
        u = MotionInput(0.1, np.zeros(1), np.zeros(1), accelerated=False)
        g = noise_gain(truth, 0.1, noise.curved)
        truth = (
            transition(truth, u)
            + (g @ (scan_sigmas(sigma) * rng.standard_normal((*shape, NOISES + 3)))[..., None])[..., 0]
        )
        truth[..., S.GYRO_ANGLE] += 1e-3 * rng.standard_normal(shape)
        x, p, _ = predict(x, p, u, noise)
        z = (h @ truth[..., None])[..., 0] + np.sqrt(np.diag(r)) * rng.standard_normal((*shape, 3))
        found = innovate(x, p, z, h, r)
        nis.append(found.nis[:, 0])
        x, p, _ = correct(x, p, h, found)
    seen = [S.EAST, S.NORTH, S.HEADING, S.SPEED]
    error, part = (truth - x)[:, 0, seen], p[:, 0][:, seen][:, :, seen]
    return np.einsum("bi,bij,bj->b", error, np.linalg.inv(part), error), np.array(nis)


def test_errors_are_as_large_as_the_filters_say():
    """NEES of 4 states and NIS of 3 observations, summed over vehicles, within 95 % bands of chi-square."""
    for predict in (predict_extended, predict_unscented):
        nees, nis = simulate(predict)
        for total, freedom in ((nees.sum(), 4 * nees.size), (nis.sum(), 3 * nis.size)):
            low, high = chi2.ppf([0.025, 0.975], freedom)
            assert low < total < high


def test_the_gate_rejects_as_often_as_declared():
    """5,000 right observations of 2 dimensions, gate at 1 %: between 0.6 and 1.5 % fail (binomial, 1e-3 of chance)."""
    rng = np.random.default_rng(8)
    p, h, r = np.diag([2.0, 3.0]), np.eye(2), np.eye(2)
    z = rng.standard_normal((5000, 2)) * np.sqrt([3.0, 4.0])
    nis = innovate(np.zeros((5000, 2)), np.broadcast_to(p, (5000, 2, 2)), z, h, r).nis
    assert 0.006 < (nis > gate_threshold(0.01, 2)).mean() < 0.015


def test_an_observation_that_is_not_used_changes_nothing():
    rng = np.random.default_rng(9)
    x, p = rng.standard_normal((4, 3)), np.broadcast_to(np.eye(3), (4, 3, 3)).copy()
    h, used = np.eye(1, 3), np.array([True, False, True, False])
    found = innovate(x, p, np.ones((4, 1)), h, np.eye(1))
    after, covariance, gain = correct(x, p, h, found, used)
    assert np.array_equal(after[~used], x[~used])
    assert np.array_equal(covariance[~used], p[~used])
    assert (gain[~used] == 0.0).all()
    assert (covariance[used, 0, 0] == 0.5).all()
