"""Cost of the whole navigator: sky, city, instruments, positioning, fault tests and protection levels."""

from __future__ import annotations

import statistics
import time

import numpy as np

from lanebound.agents.bench.rows import Row
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["measure"]

WARM_UP, EPOCHS = 40, 60


def _drive(batch: int) -> tuple[Navigator, list[Truth]]:
    """A navigator in a semi-urban street, and truth for it, prepared beforehand."""
    config = NavigatorConfig()
    road = Road.straight(800.0, heading_rad=0.6)
    city = build_city(road, CityConfig.uniform(SectionKind.SEMI_URBAN), np.random.default_rng(1))
    navigator = Navigator(config, SkyTrack.from_config(config.sky, 600.0), SkyMask.build(road, city), 1, batch)
    car, traffic = CityDrive(road, DriveConfig(red_share=0.0), config.dt_s), Streams(1, batch)
    state = car.start(traffic, spread_m=400.0)
    return navigator, [car.step(state, traffic) for _ in range(WARM_UP + EPOCHS)]


def _milliseconds(batch: int, rounds: int) -> float:
    """Median over the rounds of the cost of one simulated second of one vehicle [ms]."""
    navigator, truth = _drive(batch)
    for epoch in truth[:WARM_UP]:
        navigator.step(epoch)
    start = navigator.snapshot()
    costs = []
    for _ in range(rounds):
        navigator.restore(start)
        begun = time.perf_counter()
        for epoch in truth[WARM_UP:]:
            navigator.step(epoch)
        seconds = EPOCHS * navigator.config.dt_s
        costs.append(1e3 * (time.perf_counter() - begun) / (seconds * batch))
    return statistics.median(costs)


def measure(rounds: int = 5) -> list[Row]:
    """Milliseconds for each simulated second of each vehicle: 10 GNSS epochs, IMU at 100 Hz statistics, everything."""
    unit = "ms"
    return [
        Row(
            "navigator_ms_per_vehicle_second_b256", _milliseconds(256, rounds), unit, 0.31, 0.12, higher_is_better=False
        ),
        Row("navigator_ms_per_vehicle_second_b1", _milliseconds(1, rounds), unit, higher_is_better=False),
    ]
