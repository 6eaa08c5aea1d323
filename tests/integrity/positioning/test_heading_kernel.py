import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.positioning.correlation import overbounding_walk
from lanebound.integrity.positioning.heading_kernel import (
    HEADING,
    TURN,
    correct,
    doppler_heading_usable,
    doppler_heading_variance,
    expect_turn,
    predict_heading,
    rest_heading,
)
from lanebound.integrity.positioning.motion_config import HeadingConfig
from lanebound.integrity.positioning.parameters import calibration_parameters

DT_S = 0.1
ARW = 2.5e-4  # angle random walk [rad/sqrt(s)]
BIAS_WALK = 1e-6  # [rad/s/sqrt(s)]
HEADING_SIGMA, BIAS_SIGMA, SCALE_SIGMA = math.radians(10.0), 7e-3, 4e-3
DOPPLER_SIGMA, TAU_S = 0.01, 0.54  # 0.1 m/s at 10 m/s, correlated over 0.54 s
few = settings(max_examples=40, deadline=None, derandomize=True)


NAMES = ("p_hh", "p_hb", "p_hs", "p_bb", "p_bs", "p_ss")
PRIOR = np.diag([HEADING_SIGMA**2, BIAS_SIGMA**2, SCALE_SIGMA**2])


def _filter(angle=0.0, bias=0.0, p=PRIOR, scale=0.0):
    h = np.zeros(1, HEADING)[0]
    h["angle"], h["gyro_bias"], h["gyro_scale"] = angle, bias, scale
    for name, value in zip(NAMES, np.asarray(p)[np.triu_indices(3)], strict=True):
        h[name] = value
    return h


def _covariance(h):
    out = np.zeros((3, 3))
    out[np.triu_indices(3)] = [h[name] for name in NAMES]
    return out + np.triu(out, 1).T


def _matrix(p):
    return np.array([[p[0], p[1]], [p[1], p[2]]])


joint_covariances = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9).map(
    lambda a: np.reshape(a, (3, 3)) @ np.reshape(a, (3, 3)).T + 1e-3 * np.eye(3)
)
covariances = st.tuples(st.floats(1e-6, 1.0), st.floats(-0.99, 0.99), st.floats(1e-6, 1.0)).map(
    lambda t: np.array([t[0], t[1] * math.sqrt(t[0] * t[2]), t[2]])
)


@few
@given(angle=st.floats(-1e3, 1e3))
def test_wrapping_keeps_the_direction_and_the_range(angle):
    assert -math.pi <= wrap(angle) <= math.pi
    assert math.remainder(wrap(angle) - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_wrapping_at_the_seam():
    assert [wrap(a) for a in (math.pi, -math.pi, 0.0)] == [-math.pi, -math.pi, 0.0]


@few
@given(
    p=joint_covariances,
    dt=st.floats(1e-3, 1.0),
    bias=st.floats(-0.01, 0.01),
    scale=st.floats(-0.01, 0.01),
    increment=st.floats(-0.5, 0.5),
)
def test_prediction_is_the_matrix_form(p, dt, bias, scale, increment):
    # the true bias and scale turn the vehicle less than the gyro says: d' = d - dt b - increment c
    F = np.array([[1.0, -dt, -increment], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    J = 0.5 * (np.eye(3)[0] + F[0])
    q = np.diag([ARW**2 * dt, BIAS_WALK**2 * dt, 0.0])
    h, turn = _filter(3.0, bias, p, scale), np.zeros(1, TURN)[0]
    expect_turn(increment, dt, ARW, 0.0, h, turn)
    predict_heading(increment, dt, ARW, BIAS_WALK, h)
    expected = 3.0 + increment * (1.0 - scale) - bias * dt
    assert math.remainder(h["angle"] - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(_covariance(h), F @ p @ F.T + q, rtol=1e-9, atol=1e-12)
    assert turn["mean_variance"] == pytest.approx(J @ p @ J + 0.25 * q[0, 0], rel=1e-9, abs=1e-12)
    joint = [turn[name] for name in ("joint_h", "joint_b", "joint_s")]
    np.testing.assert_allclose(joint, F @ p @ J + 0.5 * q[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("turns", "times"), [([0.05] * 60 + [-0.05] * 60, 0.0), ([0.1] * 63, 6.3)])
def test_a_turn_there_and_back_cancels_the_scale_and_a_circle_adds_it_up(turns, times):
    h = _filter(p=np.diag([1e-8, 0.0, SCALE_SIGMA**2]))
    for turn in turns:
        predict_heading(turn, DT_S, 1e-9, 1e-9, h)
    assert h["p_hh"] == pytest.approx(1e-8 + (times * SCALE_SIGMA) ** 2, rel=1e-6)


@few
@given(
    p=joint_covariances,
    h=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    variance=st.floats(1e-4, 10.0),
    innovation=st.floats(-0.3, 0.3),
)
def test_correction_is_the_matrix_form(p, h, variance, innovation):
    H, P = np.array([[*h, 0.0]]), p
    K = P @ H.T / (H @ P @ H.T + variance)
    state = _filter(0.2, 0.001, p, 0.002)
    gains = correct(innovation, *h, variance, state)
    np.testing.assert_allclose(gains, K[:, 0], rtol=1e-9, atol=1e-12)
    assert state["gyro_scale"] == pytest.approx(0.002 + K[2, 0] * innovation, abs=1e-11)
    assert math.remainder(state["angle"] - 0.2 - K[0, 0] * innovation, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-11)
    assert state["gyro_bias"] == pytest.approx(0.001 + K[1, 0] * innovation, abs=1e-11)
    joseph = (np.eye(3) - K @ H) @ P @ (np.eye(3) - K @ H).T + K * variance @ K.T
    np.testing.assert_allclose(_covariance(state), joseph, rtol=1e-8, atol=1e-11)
    assert np.linalg.eigvalsh(_covariance(state)).min() > 0.0


def test_a_correction_crosses_north_and_south_the_short_way():
    h = _filter(math.pi - 0.01, 0.0, np.eye(3))
    correct(0.1, 1.0, 0.0, 1.0, h)
    assert h["angle"] == pytest.approx(-math.pi + 0.04)


def test_standstill_teaches_the_bias_and_leaves_the_heading():
    # At rest the gyro reads its bias plus white noise of variance arw^2 / dt: the information adds up.
    rng = np.random.default_rng(4)
    true_bias, h, n = 0.006, _filter(1.0), 200
    variance = ARW**2 / DT_S
    for noise in rng.normal(size=n) * math.sqrt(variance):
        correct(true_bias + noise - h["gyro_bias"], 0.0, 1.0, variance, h)
    assert h["angle"] == 1.0
    assert h["p_bb"] == pytest.approx(1.0 / (1.0 / BIAS_SIGMA**2 + n / variance))
    assert (h["p_hh"], h["p_hb"]) == (HEADING_SIGMA**2, 0.0)
    assert abs(h["gyro_bias"] - true_bias) < 3.29 * math.sqrt(h["p_bb"])  # fails by chance once in 1000 seeds


def test_the_bias_wanders_at_a_long_stop_as_declared():
    """A Gauss-Markov bias of 100 s; a stop of 300 s. The mean square over the variance fails by chance once in 1000."""
    rng, vehicles, tau_s, sigma = np.random.default_rng(8), 400, 100.0, 3e-5
    walk = overbounding_walk(sigma, tau_s, 0.0)
    decay = math.exp(-DT_S / tau_s)
    bias = sigma * rng.standard_normal(vehicles)
    filters = [_filter(p=np.diag([1e-8, 2.0 * sigma**2, 0.0])) for _ in range(vehicles)]
    for _ in range(3000):
        bias = decay * bias + sigma * math.sqrt(1.0 - decay**2) * rng.standard_normal(vehicles)
        noise = ARW * math.sqrt(DT_S) * rng.standard_normal(vehicles)
        for b, n, h in zip(bias, noise, filters, strict=True):
            rest_heading(b * DT_S + n, DT_S, ARW, walk, h)
    share = np.mean([(h["gyro_bias"] - b) ** 2 / h["p_bb"] for b, h in zip(bias, filters, strict=True)])
    assert share < chi2.ppf(1.0 - 1e-3, vehicles) / vehicles


def test_standstill_while_drifting_stops_the_heading_too():
    # The heading error came from the bias, so learning the bias at rest corrects the heading it has already turned.
    true_bias, h = 0.006, _filter(p=np.diag([1e-8, BIAS_SIGMA**2, 0.0]))
    for _ in range(100):
        predict_heading(true_bias * DT_S, DT_S, 1e-9, 1e-9, h)
    assert h["angle"] == pytest.approx(0.06)
    correct(true_bias - h["gyro_bias"], 0.0, 1.0, 1e-12, h)
    assert h["gyro_bias"] == pytest.approx(true_bias, rel=1e-5)
    assert h["angle"] == pytest.approx(0.0, abs=1e-6)


def _calibrate(inflation, runs=150, epochs=400, seed=6):
    """Errors (runs, 3) of heading, bias, scale, and filters (runs,), after epochs of gyro and Doppler courses."""
    rng = np.random.default_rng(seed)
    true = np.full(runs, 3.0)
    gyro_bias, scale = BIAS_SIGMA * rng.normal(size=runs), SCALE_SIGMA * rng.normal(size=runs)
    h = np.repeat(np.array([_filter()]), runs)
    h["angle"] = true + HEADING_SIGMA * rng.normal(size=runs)
    phi = math.exp(-DT_S / TAU_S)
    doppler_error = DOPPLER_SIGMA * rng.normal(size=runs)
    for k in range(epochs):
        turn = 0.03 * math.sin(0.05 * k)
        true = true + turn
        gyro_bias = gyro_bias + BIAS_WALK * math.sqrt(DT_S) * rng.normal(size=runs)
        increment = (1.0 + scale) * turn + gyro_bias * DT_S + ARW * math.sqrt(DT_S) * rng.normal(size=runs)
        white = math.sqrt(1.0 - phi**2) * DOPPLER_SIGMA * rng.normal(size=runs)
        doppler_error = phi * doppler_error + white
        for i in range(runs):
            predict_heading(increment[i], DT_S, ARW, BIAS_WALK, h[i])
            innovation = wrap(true[i] + doppler_error[i] - h["angle"][i])
            correct(innovation, 1.0, 0.0, inflation * DOPPLER_SIGMA**2, h[i])
    heading_error = np.array([wrap(angle) for angle in true - h["angle"]])
    return np.column_stack([heading_error, gyro_bias - h["gyro_bias"], scale - h["gyro_scale"]]), h


def _nees(errors, h):
    return np.array([e @ np.linalg.solve(_covariance(q), e) for e, q in zip(errors, h, strict=True)])


def test_calibration_converges_and_its_covariance_is_honest():
    errors, p = _calibrate(2.0 * TAU_S / DT_S)
    nees = _nees(errors, p)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], df=errors.size)  # fails by chance once in 1000 seeds
    assert low < nees.sum() < high
    heading_rms, bias_rms, _ = np.sqrt(np.mean(errors**2, axis=0))
    assert heading_rms < math.radians(0.3)  # from 10 degrees
    assert bias_rms < 0.05 * BIAS_SIGMA


@pytest.mark.parametrize("tau_s", [100.0, 300.0, 1e3, 1e4])
def test_the_declared_walk_overbounds_a_wander_of_any_longer_correlation_time(tau_s):
    # the kernel of the walk, less that of the wander, is positive semidefinite: no linear filter exceeds the bound
    sigma, shortest_s = 3e-5, 100.0
    walk, t = overbounding_walk(sigma, shortest_s), np.linspace(0.0, 120.0, 241)
    bound = 2.0 * sigma**2 + walk**2 * np.minimum.outer(t, t)
    wander = sigma**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / tau_s)
    assert np.linalg.eigvalsh((bound - wander) / sigma**2).min() > -1e-9


def test_a_wander_of_a_shorter_correlation_time_is_beyond_the_declared_walk():
    walk, t = overbounding_walk(3e-5, 100.0), np.linspace(0.0, 120.0, 241)
    wander = 3e-5**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / 5.0)
    bound = 2.0 * 3e-5**2 + walk**2 * np.minimum.outer(t, t)
    assert np.linalg.eigvalsh((bound - wander) / 3e-5**2).min() < -0.1


@pytest.mark.parametrize("tau_s", [100.0, 1e3, 1e4])
def test_errors_by_a_wandering_bias_stay_within_the_covariance(tau_s):
    """1500 gyros calibrated for 20 s, then 40 s alone; RMS above sigma once in 1000 runs if the bound were tight."""
    rng, runs, sigma, walk_k = np.random.default_rng(8), 1500, 3e-5, 2e-6
    walk = overbounding_walk(sigma, 100.0, walk_k)
    h = _filter(p=np.diag([1e-4, 2.0 * sigma**2, 0.0]))
    wander, random_walk, error = sigma * rng.normal(size=runs), np.zeros(runs), 1e-2 * rng.normal(size=runs)
    known, phi = np.zeros(runs), math.exp(-DT_S / tau_s)
    for k in range(600):
        wander = phi * wander + math.sqrt(1.0 - phi * phi) * sigma * rng.normal(size=runs)
        random_walk += walk_k * math.sqrt(DT_S) * rng.normal(size=runs)
        error = error + DT_S * (wander + random_walk - known) + 1e-5 * math.sqrt(DT_S) * rng.normal(size=runs)
        predict_heading(0.0, DT_S, 1e-5, walk, h)
        if k < 200:
            gains = correct(0.0, 1.0, 0.0, 1e-6, h)
            seen = error + 1e-3 * rng.normal(size=runs)  # estimate less truth, as a course shows it
            error, known = error - gains[0] * seen, known - gains[1] * seen
    errors = np.stack([error, known - wander - random_walk])
    allowed = chi2.isf(1e-3, runs) / runs
    assert ((errors**2).mean(-1) <= allowed * np.array([h["p_hh"], h["p_bb"]])).all()


def test_repeating_a_correlated_heading_as_if_white_feigns_precision():
    errors, p = _calibrate(1.0)
    assert _nees(errors, p).sum() > 3.0 * chi2.ppf(1.0 - 1e-9, df=errors.size)


LIMITS = calibration_parameters(HeadingConfig())[0]  # S1 table 1, third column; S2 section 2.2
USABLE = {"v_gnss": 5.0, "v_ss": 5.0, "hdop": 1.0, "jump": 0.0}


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("v_gnss", 6.499, 6.5),
        ("v_gnss", 3.501, 3.5),
        ("hdop", 2.499, 2.5),
        ("jump", math.radians(1.999), math.radians(2.0)),
        ("jump", -math.radians(1.999), -math.radians(2.0)),
    ],
)
def test_each_condition_of_doppler_calibration_on_both_sides(name, inside, outside):
    assert doppler_heading_usable(*(USABLE | {name: inside}).values(), LIMITS)
    assert not doppler_heading_usable(*(USABLE | {name: outside}).values(), LIMITS)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_odometer_must_turn_either_way(direction):
    assert doppler_heading_usable(0.6, direction * 0.501, 1.0, 0.0, LIMITS)
    assert not doppler_heading_usable(0.6, direction * 0.5, 1.0, 0.0, LIMITS)


def test_an_infinite_hdop_or_undefined_speed_is_not_usable():
    assert not doppler_heading_usable(5.0, 5.0, math.inf, 0.0, LIMITS)
    assert not doppler_heading_usable(math.nan, 5.0, 1.0, 0.0, LIMITS)


@few
@given(theta=st.floats(-math.pi, math.pi), speed=st.floats(0.5, 40.0), q=covariances)
def test_heading_variance_is_propagated_through_the_azimuth(theta, speed, q):
    v_e, v_n = speed * math.sin(theta), speed * math.cos(theta)
    step = 1e-6 * speed
    jacobian = np.array(
        [
            wrap(math.atan2(v_e + step, v_n) - math.atan2(v_e - step, v_n)) / (2.0 * step),
            wrap(math.atan2(v_e, v_n + step) - math.atan2(v_e, v_n - step)) / (2.0 * step),
        ]
    )
    expected = jacobian @ _matrix(q) @ jacobian
    assert doppler_heading_variance(v_e, v_n, *q) == pytest.approx(expected, rel=1e-6, abs=1e-6 * q.max() / speed**2)


def test_heading_variance_is_that_across_the_motion():
    assert doppler_heading_variance(0.0, 10.0, 0.04, 0.0, 9.0) == pytest.approx(0.04 / 100.0)
    assert doppler_heading_variance(-10.0, 0.0, 9.0, 0.0, 0.04) == pytest.approx(0.04 / 100.0)
    # North-east, correlation +1: all the noise is along the motion
    assert doppler_heading_variance(3.0, 3.0, 0.01, 0.01, 0.01) == pytest.approx(0.0, abs=1e-15)
