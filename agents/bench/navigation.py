"""Cost of the sky, of the instruments, of the whole navigator, and of the context monitor."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from lanebound.agents.bench.runner import Row, alternate, median_ratio, plain_form
from lanebound.integrity.core.streams import Streams, named_generator
from lanebound.integrity.monitoring.context.code_fix import CodeErrorsConfig, CodeFix, code_position
from lanebound.integrity.monitoring.context.monitor import ContextConfig, ContextMonitor
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.positioning.code_solution import solve_ranges
from lanebound.integrity.positioning.map_matching.generators import DriveEnvironment, generate_map
from lanebound.integrity.positioning.map_matching.matching import MatcherKind
from lanebound.integrity.sensors import imu, odometer
from lanebound.integrity.sensors.area import initial_area
from lanebound.integrity.sensors.corrections import CorrectionsConfig
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.gnss import GnssConfig, initial_state, observe
from lanebound.integrity.sky.city import CityConfig, SectionKind, build_city
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.raytrace import first_hits
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import Reception, SkyMask

STREET_M = 1000.0
ANTENNAS = 200
LOOKED = 256


def measure_sky(rounds: int = 5) -> list[Row]:
    """Line of sight in a dense street against the plain form of a checkout (compared first), look-up and sky track."""
    rng = np.random.default_rng(0)
    road = Road.straight(STREET_M, 0.4, lane_count=3)
    city = build_city(road, CityConfig.uniform(SectionKind.DENSE_CANYON), rng)
    config = SkyConfig()
    track = SkyTrack.from_config(config, 600.0)
    sky = track.at(config.start_gps_s, np.zeros(LOOKED, dtype=np.int64))
    los = sky.los_enu[0][sky.above[0]]
    arc, lane = rng.uniform(0.0, STREET_M, ANTENNAS), rng.integers(0, 3, ANTENNAS)
    antenna = np.column_stack([road.pose_at(arc, road.lane_lateral_m(lane))[0], np.full(ANTENNAS, 1.5)])
    origin, direction = (
        np.ascontiguousarray(np.broadcast_to(x, (ANTENNAS, *los.shape)).reshape(-1, 3)) for x in (antenna[:, None], los)
    )
    few = slice(0, 40 * los.shape[0], 40)
    plain = plain_form("plain_rays")

    def numba_side() -> int:
        first_hits(city.grid, origin, direction)
        return int(origin.shape[0])

    def numpy_side() -> int:
        plain.first_hits_reference(origin[few], direction[few], city.triangles_enu_m, city.foliage)
        return int(los.shape[0])

    sides = {"numba": numba_side}
    if plain is not None:
        slow = plain.first_hits_reference(origin[few], direction[few], city.triangles_enu_m, city.foliage)
        if not np.array_equal(first_hits(city.grid, origin[few], direction[few]).clear, slow.clear):
            raise AssertionError("the grid and the plain form disagree on line of sight")
        sides["numpy"] = numpy_side
    rates = alternate(sides, rounds)
    mask = SkyMask.build(road, city)
    where, row = rng.uniform(0.0, STREET_M, LOOKED), rng.integers(0, 3, LOOKED)

    def look_side() -> int:
        mask.look(where, row, sky)
        return 1

    def track_side() -> int:
        track.at(config.start_gps_s + 33.0, sky.index)
        return 1

    calls = alternate({"look": look_side, "track": track_side}, rounds, seconds=0.2)
    look_us = 1e6 / statistics.median(calls["look"])
    ratio = [] if plain is None else [Row("line_of_sight_vs_numpy", median_ratio(rates, "numba", "numpy"), "x")]
    return [
        Row("line_of_sight_sat_epochs_per_s", statistics.median(rates["numba"]), "1/s"),
        *ratio,
        Row(f"sky_mask_look_us_b{LOOKED}", look_us, "us", gate=100.0, higher_is_better=False),
        Row("sky_track_us", 1e6 / statistics.median(calls["track"]), "us", gate=20.0, higher_is_better=False),
    ]


OBSERVED = 40
BATCH = 256
DT_S = 0.1
GNSS_GATE_US = 8.0


def _sky(batch: int) -> SkyView:
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(0, 2 * np.pi, (1, OBSERVED)), rng.uniform(0.2, 1.5, (1, OBSERVED))
    c, one = np.cos(elevation), np.ones((1, OBSERVED))
    los = np.stack([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)], -1)
    system, prn = np.arange(OBSERVED) % 4, np.arange(OBSERVED) + 1
    return SkyView(los, elevation, azimuth, 2e7 * one, 0.0 * one, one > 0, system, prn, np.zeros(batch, dtype=np.int64))


def _truth(batch: int) -> Truth:
    velocity, heading = np.tile([0.0, 10.0], (batch, 1)), np.zeros(batch)
    return truth_between(DT_S, DT_S, (0.0 * velocity, velocity * DT_S), (velocity, velocity), (heading, heading))


def _gnss(batch: int) -> Callable[[], int]:
    config, sky, truth, streams = GnssConfig(), _sky(batch), _truth(batch), Streams(1, batch)
    state, none, age = initial_state(config, sky, streams), FaultEffects.none(batch, OBSERVED), np.zeros(batch)
    area = initial_area(config, CorrectionsConfig(), OBSERVED, DT_S, Streams(2, batch)).signals
    reception = Reception(np.zeros((batch, OBSERVED), dtype=np.uint8), np.zeros((batch, OBSERVED)))

    def work() -> int:
        observe(config, state, sky, reception, truth, age, area.message, none, streams, area)
        return batch

    return work


def _inertial(batch: int) -> Callable[[], int]:
    config, wheels, truth, streams = imu.ImuConfig(), odometer.OdometerConfig(), _truth(batch), Streams(1, batch)
    state, turning = imu.initial_imu(config, streams), odometer.initial_odometer(wheels, streams)
    none = FaultEffects.none(batch, OBSERVED)

    def work() -> int:
        imu.sample_imu(config, state, truth, none, streams)
        odometer.sample_odometer(wheels, turning, truth, none, streams)
        return batch

    return work


def measure_sensors(rounds: int = 5) -> list[Row]:
    """Microseconds for each vehicle and epoch, draws included, medians over rounds."""
    rates = alternate({"gnss": _gnss(BATCH), "gnss_1": _gnss(1), "imu_odometer": _inertial(BATCH)}, rounds)
    us = {name: 1e6 / statistics.median(values) for name, values in rates.items()}
    unit = "us"
    return [
        Row("gnss_observe_us_per_vehicle_epoch", us["gnss"], unit, gate=GNSS_GATE_US, higher_is_better=False),
        Row("gnss_observe_b1_us", us["gnss_1"], unit, higher_is_better=False),
        Row("imu_odometer_us_per_vehicle_epoch", us["imu_odometer"], unit, higher_is_better=False),
    ]


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


def measure_navigator(rounds: int = 5) -> list[Row]:
    """Milliseconds for each simulated second of each vehicle: 10 GNSS epochs, IMU at 100 Hz statistics, everything."""
    unit = "ms"
    return [
        Row(
            "navigator_ms_per_vehicle_second_b256", _milliseconds(256, rounds), unit, 0.31, 0.12, higher_is_better=False
        ),
        Row("navigator_ms_per_vehicle_second_b1", _milliseconds(1, rounds), unit, higher_is_better=False),
    ]


VEHICLES, SATELLITES, CLOCKS = 10_000, 24, 3
CODE_M, RATE_MPS, SPEED_MPS, STRONG_DBHZ = 2.0, 0.1, 10.0, 45.0


def measure_context(rounds: int = 5) -> list[Row]:
    """Vehicles whose second passes within a second, for the topological and the hidden Markov matcher."""
    kinds = (MatcherKind.TOPOLOGICAL, MatcherKind.HIDDEN_MARKOV)
    return [
        Row(f"context_{kind}_vehicles_in_real_time", _vehicles_per_second(kind, rounds), "1/s", 10_000.0)
        for kind in kinds
    ]


def _vehicles_per_second(kind: MatcherKind, rounds: int) -> float:
    rng = named_generator(1, "traffic")
    found = generate_map(DriveEnvironment.URBAN, 6400.0, rng)
    road_map = found.road_map
    monitor = ContextMonitor(ContextConfig.load({"matching": {"kind": kind}}), road_map, VEHICLES, 1.0)
    link = rng.choice(found.route, VEHICLES)
    start, end = (road_map.node_en_m[ends[link]] for ends in (road_map.link_from, road_map.link_to))
    unit = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    los, rates = _rows(rng), []
    for k in range(rounds + 1):
        truth = start + SPEED_MPS * k * unit, SPEED_MPS * unit
        observed = [_observe(los, value, sigma, rng) for value, sigma in zip(truth, (CODE_M, RATE_MPS), strict=True)]
        begun = time.perf_counter()
        fix = _solve(los, *observed)
        monitor.step(fix, np.full(VEHICLES, SPEED_MPS))
        if k:  # the first call prepares the cells of the map
            rates.append(VEHICLES / (time.perf_counter() - begun))
    return statistics.median(rates)


def _rows(rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (V, S, 3) to a sky of its own for each vehicle."""
    azimuth, elevation = (
        rng.uniform(0.0, 2.0 * np.pi, (VEHICLES, SATELLITES)),
        rng.uniform(0.2, 1.5, (VEHICLES, SATELLITES)),
    )
    return np.stack([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], -1)


def _observe(los: np.ndarray, value: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    noise = sigma * rng.standard_normal(los.shape[:2])
    return np.asarray(noise - np.einsum("bmi,bi->bm", los[..., :2], value))


def _solve(los: np.ndarray, codes: np.ndarray, rates: np.ndarray) -> CodeFix:
    """Position with the full covariance of codes, and velocity."""
    used, system = np.ones(codes.shape, bool), np.arange(SATELLITES) % CLOCKS
    found, plain = code_position(los, codes, np.full(codes.shape, STRONG_DBHZ), used, system, CodeErrorsConfig())
    return CodeFix(found, solve_ranges(los, rates, RATE_MPS**2, used, np.zeros_like(system)), plain)
