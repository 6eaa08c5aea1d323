"""How long the instruments take: a GNSS receiver with 40 satellites, an IMU and an odometer, on one core."""

from __future__ import annotations

import statistics
from collections.abc import Callable

import numpy as np

from lanebound.agents.bench.rows import Row, alternate
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.sensors import imu, odometer
from lanebound.integrity.sensors.area import initial_area
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import GnssConfig, initial_state, observe
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import Reception

__all__ = ["measure"]

SATELLITES = 40
BATCH = 256
DT_S = 0.1
GNSS_GATE_US = 8.0


def _sky(batch: int) -> SkyView:
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(0, 2 * np.pi, (1, SATELLITES)), rng.uniform(0.2, 1.5, (1, SATELLITES))
    c, one = np.cos(elevation), np.ones((1, SATELLITES))
    los = np.stack([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)], -1)
    system, prn = np.arange(SATELLITES) % 4, np.arange(SATELLITES) + 1
    return SkyView(los, elevation, azimuth, 2e7 * one, 0.0 * one, one > 0, system, prn, np.zeros(batch, dtype=np.int64))


def _truth(batch: int) -> Truth:
    velocity, heading = np.tile([0.0, 10.0], (batch, 1)), np.zeros(batch)
    return truth_between(DT_S, DT_S, (0.0 * velocity, velocity * DT_S), (velocity, velocity), (heading, heading))


def _gnss(batch: int) -> Callable[[], int]:
    config, sky, truth, streams = GnssConfig(), _sky(batch), _truth(batch), Streams(1, batch)
    state, none, age = initial_state(config, sky, streams), FaultEffects.none(batch, SATELLITES), np.zeros(batch)
    area = initial_area(config, CorrectionsConfig(), SATELLITES, DT_S, Streams(2, batch)).signals
    reception = Reception(np.zeros((batch, SATELLITES), dtype=np.uint8), np.zeros((batch, SATELLITES)))

    def work() -> int:
        observe(config, state, sky, reception, truth, age, area.message, none, streams, area)
        return batch

    return work


def _inertial(batch: int) -> Callable[[], int]:
    config, wheels, truth, streams = imu.ImuConfig(), odometer.OdometerConfig(), _truth(batch), Streams(1, batch)
    state, turning = imu.initial_imu(config, streams), odometer.initial_odometer(wheels, streams)
    none = FaultEffects.none(batch, SATELLITES)

    def work() -> int:
        imu.sample_imu(config, state, truth, none, streams)
        odometer.sample_odometer(wheels, turning, truth, none, streams)
        return batch

    return work


def measure(rounds: int = 5) -> list[Row]:
    """Microseconds for each vehicle and epoch, draws included, medians over rounds."""
    rates = alternate({"gnss": _gnss(BATCH), "gnss_1": _gnss(1), "imu_odometer": _inertial(BATCH)}, rounds)
    us = {name: 1e6 / statistics.median(values) for name, values in rates.items()}
    unit = "us"
    return [
        Row("gnss_observe_us_per_vehicle_epoch", us["gnss"], unit, gate=GNSS_GATE_US, higher_is_better=False),
        Row("gnss_observe_b1_us", us["gnss_1"], unit, higher_is_better=False),
        Row("imu_odometer_us_per_vehicle_epoch", us["imu_odometer"], unit, higher_is_better=False),
    ]
