"""Pulses lose no distance, noise has its size, slip and faults their signs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.odometer import OdometerConfig, OdometerSample, initial_odometer, sample_odometer

DT = 0.1
EXACT = OdometerConfig(scale_sigma=0.0, noise_mps=0.0, slip_s2_per_m=0.0)
PULSE_M = EXACT.circumference_m / EXACT.pulses_per_revolution


def _truth(speed_mps: np.ndarray) -> Truth:
    speed = np.atleast_1d(np.asarray(speed_mps, dtype=np.float64))
    velocity = np.column_stack([np.zeros_like(speed), speed])
    heading = np.zeros_like(speed)
    return truth_between(DT, DT, (0.0 * velocity, velocity * DT), (velocity, velocity), (heading, heading))


def _drive(
    config: OdometerConfig, speeds_mps: np.ndarray, seed: int = 2, effects: FaultEffects | None = None
) -> list[OdometerSample]:
    """Samples of a drive with the speeds (epochs, B)."""
    batch = speeds_mps.shape[1]
    streams = Streams(seed, batch)
    state = initial_odometer(config, streams)
    effects = effects or FaultEffects.none(batch, 0)
    return [sample_odometer(config, state, _truth(row), effects, streams) for row in speeds_mps]


def test_pulses_lose_no_distance() -> None:
    speeds = np.full((1000, 1), 3.3337)
    total = sum(s.distance_m[0] for s in _drive(EXACT.replace(pulses_per_revolution=96), speeds))
    assert total == pytest.approx(333.37, abs=1.95 / 96 + 1e-9)


def test_distance_is_whole_pulses_and_speed_its_mean() -> None:
    sample = _drive(EXACT, np.array([[7.7]]))[0]
    assert sample.distance_m[0] / PULSE_M == pytest.approx(round(sample.distance_m[0] / PULSE_M), abs=1e-6)
    assert sample.speed_mps[0] == pytest.approx(7.7, abs=PULSE_M / DT)


def test_reverse_is_negative() -> None:
    assert _drive(EXACT, np.array([[-2.0]]))[0].speed_mps[0] == pytest.approx(-2.0, abs=PULSE_M / DT)


def test_white_noise_has_its_size() -> None:
    n, epochs = 500, 40
    noisy = _drive(EXACT.replace(noise_mps=0.05, pulses_per_revolution=200_000), np.full((epochs, n), 10.0))
    statistic = sum(((s.speed_mps - 10.0) ** 2).sum() for s in noisy) / 0.05**2
    low, high = chi2.ppf([5e-4, 1 - 5e-4], n * epochs)  # fails by chance once in 1000 seeds
    assert low < statistic < high


def test_correlated_noise_remembers() -> None:
    config = EXACT.replace(noise_mps=0.05, noise_tau_s=1.0, pulses_per_revolution=200_000)
    errors = np.array([s.speed_mps - 10.0 for s in _drive(config, np.full((2, 20_000), 10.0))])
    measured = (errors[0] * errors[1]).mean() / 0.05**2
    assert measured == pytest.approx(np.exp(-0.1), abs=4.0 * np.sqrt(2.0 / 20_000))  # fails once in 15000 seeds


def test_scale_is_drawn_once_per_vehicle() -> None:
    samples = _drive(EXACT.replace(scale_sigma=0.01), np.full((50, 4), 20.0))
    total = np.sum([s.distance_m for s in samples], axis=0)
    assert np.unique(total).size == 4
    assert np.abs(total / 100.0 - 1.0).max() < 0.05


def test_slip_lengthens_the_distance_when_accelerating_and_shortens_it_when_braking() -> None:
    config = EXACT.replace(slip_s2_per_m=0.01, pulses_per_revolution=200_000)
    up = _drive(config, np.array([[10.0], [10.2]]))[1].speed_mps[0]
    down = _drive(config, np.array([[10.2], [10.0]]))[1].speed_mps[0]
    assert up == pytest.approx(10.2 * 1.02, abs=1e-3)
    assert down == pytest.approx(10.0 * 0.98, abs=1e-3)
    back = _drive(config, np.array([[-10.0], [-10.2]]))[1].speed_mps[0]
    assert back == pytest.approx(-10.2 * 1.02, abs=1e-3)


def test_no_pulses_below_the_dropout_speed() -> None:
    noisy = _drive(EXACT.replace(noise_mps=0.05), np.full((100, 3), 0.14))
    assert not np.any([s.distance_m for s in noisy])


def test_frozen_odometer_repeats_its_last_message() -> None:
    streams, none, frozen = Streams(1, 2), FaultEffects.none(2, 0), FaultEffects.blank(2, 0)
    frozen.odometer_frozen[0] = True
    state = initial_odometer(EXACT, streams)
    before = sample_odometer(EXACT, state, _truth(np.array([10.0, 10.0])), none, streams)
    during = sample_odometer(EXACT, state, _truth(np.array([5.0, 5.0])), frozen, streams)
    assert during.speed_mps[0] == before.speed_mps[0]
    assert during.speed_mps[1] == pytest.approx(5.0, abs=PULSE_M / DT)


def test_wheel_slip_fault_scales_the_distance() -> None:
    effects = FaultEffects.blank(1, 0)
    effects.odometer_scale[0] = 1.2
    assert _drive(EXACT, np.array([[10.0]]), effects=effects)[0].speed_mps[0] == pytest.approx(12.0, abs=0.02)


def test_a_draw_in_another_stream_moves_nothing() -> None:
    config, truth, none = OdometerConfig(), _truth(np.array([9.0, 9.0])), FaultEffects.none(2, 0)
    plain, busy = Streams(7, 2), Streams(7, 2)
    one = sample_odometer(config, initial_odometer(config, plain), truth, none, plain)
    busy.normal("imu", 5)
    busy.uniform("gnss", 3)
    two = sample_odometer(config, initial_odometer(config, busy), truth, none, busy)
    np.testing.assert_array_equal(one.distance_m, two.distance_m)


def test_a_copy_goes_on_alike() -> None:
    config, truth, none = OdometerConfig(), _truth(np.array([9.0])), FaultEffects.none(1, 0)
    streams = Streams(7, 1)
    state = initial_odometer(config, streams)
    twin, twin_streams = state.copy(), streams.snapshot()
    for _ in range(5):
        one = sample_odometer(config, state, truth, none, streams)
        two = sample_odometer(config, twin, truth, none, twin_streams)
        np.testing.assert_array_equal(one.distance_m, two.distance_m)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="pulses_per_revolution"):
        OdometerConfig(pulses_per_revolution=0)
    streams = Streams(1, 2)
    with pytest.raises(InputError, match="batch"):
        sample_odometer(EXACT, initial_odometer(EXACT, streams), _truth(np.ones(3)), FaultEffects.none(3, 0), streams)
