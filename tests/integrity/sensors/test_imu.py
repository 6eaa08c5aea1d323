"""Increments against a brute-force 100 Hz simulation, signs, units, and the S4 warm-up error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.imu import (
    AxisNoise,
    ImuConfig,
    gauss_markov_step,
    initial_imu,
    random_walk_step,
    sample_imu,
    warm_up,
)

DEG = np.pi / 180.0
SILENT = AxisNoise(density=0.0)
QUIET = ImuConfig(gyro=SILENT, accel=SILENT)


def _truth(batch: int, speed_mps: float = 0.0, turn_rad: float = 0.0, dt_s: float = 0.1) -> Truth:
    start = np.zeros((batch, 2))
    velocity = np.column_stack([np.zeros(batch), np.full(batch, speed_mps)])
    heading = np.zeros(batch)
    return truth_between(
        dt_s, dt_s, (start, start + velocity * dt_s), (velocity, velocity), (heading, heading + turn_rad)
    )


def _sum(config: ImuConfig, truth: Truth, epochs: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Increments of each epoch, (epochs, B, 3) each."""
    streams = Streams(seed, truth.batch)
    state, none = initial_imu(config, streams), FaultEffects.none(truth.batch, 0)
    samples = [sample_imu(config, state, truth, none, streams) for _ in range(epochs)]
    return np.array([s.delta_theta_rad for s in samples]), np.array([s.delta_v_mps for s in samples])


def test_silent_sensor_repeats_the_truth() -> None:
    truth = _truth(2, speed_mps=8.0, turn_rad=0.02)
    theta, delta_v = _sum(QUIET, truth, 1)
    np.testing.assert_allclose(theta[0], truth.delta_theta_rad)
    np.testing.assert_allclose(delta_v[0], truth.delta_v_mps)
    assert theta[0, 0, 2] == pytest.approx(0.02)
    assert delta_v[0, 0, 2] == pytest.approx(-GRAVITY_MPS2 * 0.1)


def test_one_second_of_epochs_has_the_covariance_of_100_hz_samples() -> None:
    """Increments of ten 0.1 s epochs against 100 samples a second, over an instability of tau 0.3 s and a random walk.

    The five variances and covariances below are each compared at 4 sigma: fails by chance once in 3000 seeds.
    """
    n, rate, dt = 20_000, 100, 0.1
    noise = AxisNoise(density=0.01, instability=0.05, instability_s=0.3, random_walk=0.04)
    streams = Streams(11, n)
    config = ImuConfig(gyro=noise, accel=SILENT)
    state, none, truth = initial_imu(config, streams), FaultEffects.none(n, 0), _truth(n)
    fast = np.array([sample_imu(config, state, truth, none, streams).delta_theta_rad[:, 2] for _ in range(10)])
    rng = np.random.default_rng(5)
    h, fine = 1.0 / rate, 4  # four sub-steps a sample, midpoint rule: integration error below 1e-3
    a = np.exp(-h / fine / noise.instability_s)
    bias, walk = noise.instability * rng.standard_normal(n), np.zeros(n)
    slow = np.zeros((10, n))
    for k in range(rate):
        slow[k // 10] += noise.density * np.sqrt(h) * rng.standard_normal(n)
        for _ in range(fine):
            before = bias + walk
            bias = a * bias + noise.instability * np.sqrt(1 - a * a) * rng.standard_normal(n)
            walk = walk + noise.random_walk * np.sqrt(h / fine) * rng.standard_normal(n)
            slow[k // 10] += 0.5 * (before + bias + walk) * h / fine
    pairs = [(fast.sum(0), fast.sum(0), slow.sum(0), slow.sum(0))]
    pairs += [(fast[i], fast[j], slow[i], slow[j]) for i, j in ((0, 0), (9, 9), (0, 1), (0, 9))]
    for x, y, u, v in pairs:
        scatter = np.sqrt(((x * y).var() + (u * v).var()) / n)
        assert abs((x * y).mean() - (u * v).mean()) < 4.0 * scatter
    assert dt * rate == 10


@pytest.mark.parametrize("dt", [1e-3, 0.1, 0.999, 1.001, 30.0])
def test_gauss_markov_step_has_the_closed_form_covariance(dt: float) -> None:
    sigma, tau = 2.0, 100.0
    columns = np.array(
        [[gauss_markov_step(np.zeros(()), sigma, tau, dt, np.eye(2)[i])[k] for i in range(2)] for k in range(2)]
    )
    cov = columns @ columns.T
    r = np.longdouble(dt) / tau
    a = np.exp(-r)
    assert cov[0, 0] == pytest.approx(float(sigma**2 * (1 - a * a)), rel=1e-9)
    assert cov[0, 1] == pytest.approx(float(sigma**2 * tau * (1 - a) ** 2), rel=1e-8)
    # 5e-3: what cancellation leaves of the closed form at the shortest step even in long double
    assert cov[1, 1] == pytest.approx(float((sigma * tau) ** 2 * (2 * r - 3 + 4 * a - a * a)), rel=5e-3)


def test_gauss_markov_integral_tends_to_white_and_to_constant() -> None:
    end, integral = gauss_markov_step(np.array(1.5), 0.0, 100.0, 0.1, np.zeros(2))
    assert end == pytest.approx(1.5 * np.exp(-1e-3))
    assert integral == pytest.approx(1.5 * 100.0 * (1 - np.exp(-1e-3)))


def test_random_walk_step_covariance() -> None:
    columns = np.array(
        [[random_walk_step(np.zeros(()), 3.0, 2.0, np.eye(2)[i])[k] for i in range(2)] for k in range(2)]
    )
    np.testing.assert_allclose(columns @ columns.T, 9.0 * np.array([[2.0, 2.0], [2.0, 8.0 / 3.0]]))


def test_white_noise_has_its_density() -> None:
    n, density = 4000, 0.014 * DEG
    theta, _ = _sum(ImuConfig(gyro=AxisNoise(density=density), accel=SILENT), _truth(n), 1)
    statistic = (theta[0, :, 0] ** 2).sum() / (density**2 * 0.1)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], n)  # fails by chance once in 1000 seeds
    assert low < statistic < high


def test_gyro_fault_turns_the_measured_rate_clockwise() -> None:
    effects = FaultEffects.blank(2, 0)
    effects.gyro_bias_radps[1] = 0.5 * DEG
    streams = Streams(1, 2)
    sample = sample_imu(QUIET, initial_imu(QUIET, streams), _truth(2), effects, streams)
    np.testing.assert_allclose(sample.delta_theta_rad[:, 2], [0.0, 0.05 * DEG])


def test_motion_bias_is_zero_at_rest_and_bounded_in_motion() -> None:
    config = QUIET.replace(grade="s1_consumer", moving_gyro_bias_degps=0.004)
    rest, _ = _sum(config, _truth(500), 1)
    moving, _ = _sum(config, _truth(500, speed_mps=10.0), 1)
    assert not rest.any()
    rate_degps = moving[0, :, 2] / 0.1 / DEG
    assert kstest(rate_degps, "uniform", args=(-0.004, 0.008)).pvalue > 1e-3  # fails by chance once in 1000 seeds


def test_warm_up_error_starts_at_c2_and_ends_at_the_sum() -> None:
    warming = QUIET.replace(mems_exponential=True)
    np.testing.assert_allclose(warm_up(warming, np.array([0.0, 1e6]), 1e-3) / 1e-3, [-0.007, -0.0113], rtol=1e-5)
    _, delta_v = _sum(warming, _truth(1), 600)
    velocity = np.cumsum(delta_v[:, 0, 0])
    # twice the integral of e(t) over 60 s: 12.9 m, as equations.md 12 computes from the published constants
    assert velocity.sum() * 0.1 == pytest.approx(-12.9, abs=0.1)


def test_scale_and_turn_on_are_drawn_once() -> None:
    config = QUIET.replace(gyro={"density": 0.0, "turn_on": 0.01, "scale": 0.1})
    still, _ = _sum(config, _truth(3), 2)
    np.testing.assert_array_equal(still[0], still[1])
    turning, _ = _sum(config, _truth(3, turn_rad=0.1), 1)
    assert np.unique(turning[0, :, 2] - still[0, :, 2]).size == 3


def test_increments_are_those_of_the_plain_steps() -> None:
    """The compiled form against the two steps applied one by one, to 1e-12."""
    config, batch, dt = ImuConfig(moving_gyro_bias_degps=0.1), 3, 0.1
    streams, truth = Streams([1, 2, 3]), _truth(batch, speed_mps=5.0, turn_rad=0.01)
    state = initial_imu(config, streams)
    draws = streams.snapshot()
    for _ in range(3):
        plain = state.copy()
        sample = sample_imu(config, state, truth, FaultEffects.none(batch, 0), streams)
        z = draws.normal("imu", 2, 3, 5)
        rows = ((config.gyro, truth.delta_theta_rad), (config.accel, truth.delta_v_mps))
        expected = []
        for i, (triad, true) in enumerate(rows):
            axes, after = (sensors["axes"][:, i] for sensors in (plain.sensors, state.sensors))
            end, wander = gauss_markov_step(
                axes["instability"], triad.instability, triad.instability_s, dt, z[:, i, :, 1:3]
            )
            walk_end, walk = random_walk_step(axes["walk"], triad.random_walk, dt, z[:, i, :, 3:5])
            np.testing.assert_allclose(after["instability"], end, rtol=1e-12, atol=1e-18)
            np.testing.assert_allclose(after["walk"], walk_end, rtol=1e-12, atol=1e-18)
            white = triad.density * np.sqrt(dt) * z[:, i, :, 0]
            expected.append(true * (1 + axes["scale"]) + axes["turn_on"] * dt + white + wander + walk)
        expected[0][:, 2] += state.sensors["moving_bias"] * dt
        np.testing.assert_allclose(sample.delta_theta_rad, expected[0], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(sample.delta_v_mps, expected[1], rtol=1e-12, atol=1e-15)


def test_same_seed_same_bits_and_a_copy_goes_on_alike() -> None:
    config, truth, none = ImuConfig(), _truth(2), FaultEffects.none(2, 0)
    streams = Streams(4, 2)
    state = initial_imu(config, streams)
    twin, twin_streams = state.copy(), streams.snapshot()
    for _ in range(3):
        one = sample_imu(config, state, truth, none, streams)
        two = sample_imu(config, twin, truth, none, twin_streams)
        np.testing.assert_array_equal(one.delta_theta_rad, two.delta_theta_rad)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="density"):
        AxisNoise(density=-1.0)
    streams = Streams(1, 2)
    with pytest.raises(InputError, match="batch"):
        sample_imu(QUIET, initial_imu(QUIET, streams), _truth(3), FaultEffects.none(3, 0), streams)
