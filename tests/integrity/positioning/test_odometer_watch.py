"""A faulty odometer is found by the accelerometer, the gyro or itself; a healthy one raises no doubt."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.positioning import odometer_watch_kernel as wk
from lanebound.integrity.positioning.motion_config import DeadReckoningConfig
from lanebound.integrity.positioning.parameters import watch_parameters
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.imu import ImuConfig, initial_imu, sample_imu
from lanebound.integrity.sensors.odometer import OdometerConfig, initial_odometer, sample_odometer
from lanebound.integrity.sky.road import Road

Array = NDArray[np.float64]
DT = 0.1
CONFIG = DeadReckoningConfig()
LIMITS = watch_parameters(CONFIG)[0]


def _watch(
    speed: Array, forward: Array, lateral: Array | None = None, rate: Array | None = None, agrees: bool = False
) -> Array:
    """Doubt after each epoch, (T,)."""
    w, zero = np.zeros(1, wk.ODOMETER_WATCH)[0], np.zeros_like(speed)
    lateral, rate, doubt = zero if lateral is None else lateral, zero if rate is None else rate, []
    for v, f, side, turn in zip(speed, forward, lateral, rate, strict=True):
        wk.turning_at_rest(DT, v, turn, LIMITS, w)
        doubt.append(wk.watch_odometer(DT, v, f, side, turn, False, agrees, LIMITS, w))
    return np.array(doubt)


def _profile(acceleration_mps2: float, seconds: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Two seconds at 10 m/s, then a steady change: true mean speed, odometer's and forward increments."""
    a = np.concatenate([np.zeros(20), np.full(round(seconds / DT), acceleration_mps2)])
    end = 10.0 + np.cumsum(a) * DT
    mean = end - 0.5 * a * DT
    return mean, mean + rng.normal(0.0, 0.05, a.size), a * DT + rng.normal(0.0, 0.05, 1) * DT


@pytest.mark.parametrize(("acceleration_mps2", "within_s"), [(-3.0, 0.8), (-2.0, 1.5), (1.6, 2.0)])
def test_a_frozen_odometer_is_caught_while_the_speed_changes(acceleration_mps2: float, within_s: float) -> None:
    for seed in range(20):
        _, odometer, forward = _profile(acceleration_mps2, 4.0, np.random.default_rng(seed))
        odometer[20:] = odometer[19] + 1e-6 * np.arange(40)  # never the same value: only the accelerometer can tell
        doubt = _watch(odometer, forward)
        assert not doubt[:20].any()
        assert doubt[20 + round(within_s / DT)]


def test_smooth_braking_is_legitimate() -> None:
    for seed in range(20):
        _, odometer, forward = _profile(-3.0, 3.3, np.random.default_rng(seed))
        assert not _watch(odometer, forward).any()


def test_a_moving_odometer_that_repeats_itself_is_caught_and_one_at_rest_is_not() -> None:
    assert np.argmax(_watch(np.full(40, 7.3), np.zeros(40))) * DT == pytest.approx(CONFIG.watch.stuck_s, abs=0.11)
    assert not _watch(np.zeros(40), np.zeros(40)).any()


def test_a_turn_while_the_odometer_says_rest_is_no_rest() -> None:
    rate = np.concatenate([np.zeros(10), np.full(10, 0.15)])
    doubt = _watch(np.zeros(20), np.zeros(20), rate=rate)
    assert not doubt[:12].any()
    assert doubt[14]


def test_doubt_ends_when_doppler_has_agreed() -> None:
    speed = 5.0 + 0.1 * np.sin(np.arange(60.0))
    speed[10:] += 4.0
    assert _watch(speed, np.zeros(60))[10:].all()
    doubt = _watch(speed, np.zeros(60), agrees=True)
    assert doubt[10]
    assert not doubt[35:].any()


def test_every_allowance_used_up_gives_few_false_alarms() -> None:
    """Bias, steepest road and noise at their bounds for 20,000 epochs: about 2 Q(5.5) each, so 1e-3 expected in all."""
    rng, n = np.random.default_rng(8), 20_000
    forward = np.full(n, DT * LIMITS["allowed"])
    assert not _watch(8.0 + rng.normal(0.0, CONFIG.odometer_sigma_mps, n), forward).any()


def test_no_false_alarm_in_city_traffic() -> None:
    """16,000 epochs with curves, lights, wheel slip, dropout below 0.15 m/s and MEMS biases."""
    streams = Streams(11, 16)
    car = CityDrive(Road.through(np.array([[0.0, 0.0], [300.0, 0.0], [300.0, 300.0]]), closed=True), DriveConfig(), DT)
    state, imu = car.start(streams, 200.0), initial_imu(ImuConfig(), streams)
    odometer = initial_odometer(OdometerConfig(), streams)
    memory, fine = np.zeros(16, wk.ODOMETER_WATCH), FaultEffects.none(16, 1)
    for _ in range(1000):
        truth = car.step(state, streams)
        sample = sample_imu(ImuConfig(), imu, truth, fine, streams)
        speed = sample_odometer(OdometerConfig(), odometer, truth, fine, streams).speed_mps
        for b in range(16):
            rate = sample.delta_theta_rad[b, 2] / DT
            forward, lateral = sample.delta_v_mps[b, 0], sample.delta_v_mps[b, 1]
            wk.turning_at_rest(DT, speed[b], rate, LIMITS, memory[b])
            assert not wk.watch_odometer(DT, speed[b], forward, lateral, rate, False, False, LIMITS, memory[b])
