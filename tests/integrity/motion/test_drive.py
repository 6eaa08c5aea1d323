"""Scripted drives: limits, lights and ends of roads, and truth that hangs together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.drive import CityDrive, DriveConfig, DriveState
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sky.road import Road

Array = NDArray[np.float64]
DT = 0.1
FREE = DriveConfig(red_share=0.0)
BLOCK = Road.through(
    [(0.0, 0.0), (180.0, 0.0), (180.0, 121.0), (0.0, 121.0)], closed=True, lane_count=2, shift_m=3.5
)  # fmt: skip
RIGHT = Road.through([(0.0, 0.0), (0.0, 121.0), (180.0, 0.0)], closed=True, lane_count=2, shift_m=3.5)


@dataclass
class _Trip:
    truths: list[Truth]
    lights: Array
    red: NDArray[np.bool_]
    state: DriveState
    streams: Streams

    def __getattr__(self, name: str) -> Array:
        return np.array([getattr(t, name) for t in self.truths])

    @property
    def speed(self) -> Array:
        return np.asarray(np.hypot(self.velocity_enu_mps[..., 0], self.velocity_enu_mps[..., 1]))


def _trip(
    road: Road = BLOCK, config: DriveConfig = FREE, seconds: float = 120.0, seeds: int = 1, batch: int = 4,
    spread_m: float = 200.0,
) -> _Trip:  # fmt: skip
    drive, streams = CityDrive(road, config, DT), Streams(seeds, batch)
    state = drive.start(streams, spread_m)
    truths, lights, red = [], [], []
    for _ in range(round(seconds / DT)):
        lights.append(state.light * config.light_spacing_m)
        red.append(state.red.copy())
        truths.append(drive.step(state, streams))
    return _Trip(truths, np.array(lights), np.array(red), state, streams)


def test_vehicles_start_at_rest_within_the_spread() -> None:
    state = CityDrive(BLOCK, FREE).start(Streams(3, 500), spread_m=100.0)
    assert not state.speed_mps.any()
    assert (state.arc_m >= 0.0).all()
    assert (state.arc_m < 100.0).all()
    assert np.ptp(state.arc_m) > 90.0


@pytest.mark.parametrize("road", [BLOCK, RIGHT], ids=["left turns", "right turns"])
@pytest.mark.parametrize("lane", [0, 1])
def test_position_velocity_heading_and_arc_hang_together(lane: int, road: Road) -> None:
    """Each step is the mean of the velocities at its ends to 1 %, on the outer and the inner side of curves."""
    trip = _trip(road, FREE.replace(lane=lane, red_share=0.5, red_max_s=8.0))
    moved = np.diff(trip.position_enu_m, axis=0) / DT
    mean = 0.5 * (trip.velocity_enu_mps[1:] + trip.velocity_enu_mps[:-1])
    error = np.linalg.norm(moved - mean, axis=-1)
    assert (error <= 0.01 * np.linalg.norm(mean, axis=-1)).all()
    heading = trip.heading_rad
    along = np.stack([np.sin(heading), np.cos(heading)], -1)
    np.testing.assert_allclose(trip.velocity_enu_mps[..., :2], trip.speed[..., None] * along, atol=1e-9)
    road_position, road_heading = road.pose_at(trip.arc_m, road.lane_lateral_m(lane))
    np.testing.assert_allclose(trip.position_enu_m[..., :2], road_position, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * heading), np.exp(1j * road_heading), atol=1e-9)
    assert (trip.lane == lane).all()


def test_increments_add_up_to_the_motion() -> None:
    trip = _trip(seconds=60.0)
    turned = trip.heading_rad[0] + np.cumsum(trip.delta_theta_rad[1:, :, 2], axis=0)
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * trip.heading_rad[1:]), atol=1e-9)
    np.testing.assert_allclose(trip.distance_m, np.hypot(*np.moveaxis(_steps(trip), -1, 0)), atol=1e-9)
    np.testing.assert_allclose(trip.distance_m[1:], 0.5 * DT * (trip.speed[1:] + trip.speed[:-1]), rtol=0.01, atol=2e-3)
    np.testing.assert_allclose(trip.time_s, DT * np.arange(1, 601))


def _steps(trip: _Trip) -> Array:
    first = CityDrive(BLOCK, FREE).start(Streams(1, 4), 200.0).position_m
    return np.asarray(np.diff(trip.position_enu_m[..., :2], axis=0, prepend=first[None]))


def test_the_legal_limit_and_comfort_are_kept() -> None:
    trip = _trip(config=DriveConfig(speed_limit_mps=12.0, red_share=0.5, red_max_s=6.0), seconds=200.0)
    assert trip.speed.max() == pytest.approx(12.0, abs=1e-9)
    change = np.diff(trip.speed, axis=0) / DT
    assert change.max() <= 1.5 + 1e-9
    assert change.min() >= -4.5 - 1e-9  # twice the comfortable braking, and what is left below 5 cm/s
    assert (change < -2.5).mean() < 0.02


@pytest.mark.parametrize("road", [BLOCK, RIGHT], ids=["outer lane", "inner lane"])
def test_curves_are_taken_at_the_speed_their_lateral_acceleration_allows(road: Road) -> None:
    trip = _trip(road, FREE.replace(lateral_mps2=2.0))
    lateral = np.abs(trip.delta_theta_rad[..., 2]) / DT * trip.speed
    assert 1.8 < lateral.max() < 2.2


def test_red_lights_are_met_in_their_share_and_stopped_at() -> None:
    config = DriveConfig(red_share=1.0, red_min_s=3.0, red_max_s=5.0, light_spacing_m=100.0)
    trip = _trip(Road.straight(3000.0, 0.7), config, seconds=200.0)
    gap = trip.lights - trip.arc_m
    assert (gap[trip.red & (trip.speed == 0.0)] > 0.5).all()
    for v in range(4):
        standing = trip.speed[:, v] == 0.0
        starts, ends = (np.flatnonzero(np.diff(standing.astype(int)) == sign) for sign in (1, -1))
        pause = DT * (ends - starts[: len(ends)])
        assert len(pause) > 5
        assert (pause > 3.0 - 0.05).all()
        assert (pause < 5.0 + 0.5).all()
        np.testing.assert_allclose(gap[starts + 1, v], 1.0, atol=0.5)


def test_the_share_of_red_lights_is_the_configured_one() -> None:
    """3000 lights, each red with probability 0.4: within four standard deviations."""
    red = CityDrive(BLOCK, DriveConfig(red_share=0.4)).start(Streams(8, 3000), 500.0).red
    assert red.mean() == pytest.approx(0.4, abs=4.0 * np.sqrt(0.24 / 3000))


def test_without_red_lights_nobody_stops() -> None:
    trip = _trip(seconds=100.0)
    assert trip.speed[1:].min() > 0.0
    assert not trip.red.any()


def test_an_open_road_ends_in_a_stop() -> None:
    road = Road.through([(0.0, 0.0), (0.0, 150.0), (150.0, 150.0)])
    trip = _trip(road, seconds=60.0, spread_m=10.0)
    assert not trip.speed[-1].any()
    assert (trip.arc_m[-1] <= road.length_m).all()
    assert (trip.arc_m[-1] > road.length_m - 2.0).all()


def test_a_closed_road_is_driven_lap_after_lap() -> None:
    """The arc counts on, the place repeats, and so does the speed there: 1.5 % of the mean from lap to lap."""
    trip = _trip(seconds=400.0, batch=1, spread_m=0.0)
    arc, length = trip.arc_m[:, 0], BLOCK.length_m
    assert arc[-1] > 5.0 * length
    assert (np.diff(arc) > 0.0).all()
    places = np.linspace(0.0, length, 200)
    second, fifth = (np.interp(places + lap * length, arc, trip.speed[:, 0]) for lap in (1, 4))
    np.testing.assert_allclose(fifth, second, atol=0.15)


def test_the_same_seed_gives_the_same_drive_and_a_copied_state_goes_on_alike() -> None:
    config = DriveConfig()
    one, two, other = (_trip(config=config, seeds=seed, seconds=40.0) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.position_enu_m, two.position_enu_m)
    assert not np.array_equal(one.position_enu_m, other.position_enu_m)
    drive, state, streams = CityDrive(BLOCK, config, DT), one.state.copy(), one.streams.snapshot()
    first = [drive.step(one.state, one.streams).position_enu_m for _ in range(50)]
    again = [drive.step(state, streams).position_enu_m for _ in range(50)]
    np.testing.assert_array_equal(first, again)


def test_a_vehicle_is_the_same_alone_and_in_company() -> None:
    def end(seeds: list[int]) -> Array:
        drive, streams = CityDrive(BLOCK, DriveConfig(), DT), Streams(seeds)
        state = drive.start(streams, 100.0)
        for _ in range(300):
            truth = drive.step(state, streams)
        return truth.position_enu_m

    np.testing.assert_allclose(end([4, 9, 2])[1], end([9])[0], rtol=0.0, atol=1e-9)


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="dt_s must be positive"):
        CityDrive(BLOCK, FREE, 0.0)
    sharp = Road.through([(0.0, 0.0), (0.0, 50.0), (50.0, 50.0)], corner_radius_m=4.0, shift_m=5.0)
    with pytest.raises(InputError, match="got a radius below 5"):
        CityDrive(sharp, FREE)
    with pytest.raises(ConfigError, match="red_share"):
        DriveConfig(red_share=1.5)


def test_streams_of_another_batch_and_other_things_are_refused_before_anything_moves() -> None:
    car, streams = CityDrive(BLOCK, FREE, DT), Streams(1, 3)
    state = car.start(streams, 100.0)
    before = state.copy()
    with pytest.raises(
        InputError, match=r"streams must be for the 3 vehicles of state, got streams for 5: pass the streams"
    ):
        car.step(state, Streams(1, 5))
    for call in (lambda: car.step(state, 7), lambda: car.start([1, 2])):  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"streams must be of class Streams, got (int|list): pass "):
            call()
    np.testing.assert_array_equal(state.arc_m, before.arc_m)
    assert state.time_s == before.time_s


@pytest.mark.parametrize(("road", "spread_m"), [(BLOCK, -1.0), (BLOCK, "far"), (Road.straight(100.0, 0.0), 101.0)])
def test_a_spread_off_the_road_is_refused(road: Road, spread_m: float) -> None:
    with pytest.raises(InputError, match="spread_m must"):
        CityDrive(road, FREE, DT).start(Streams(1, 2), spread_m)


def test_an_epoch_given_as_text_is_refused() -> None:
    with pytest.raises(InputError, match="dt_s must be numeric, got str"):
        CityDrive(BLOCK, FREE, "0.1")  # type: ignore[arg-type]


def test_a_body_whose_rear_axle_follows_slips_in_bends_as_a_bicycle() -> None:
    """``sin(slip) = axle rate / speed`` throughout, that is no sideways motion of the rear axle; in a bend of 20 m the
    slip comes to asin(axle / 20 m)."""
    road = Road.through([(0.0, 0.0), (80.0, 0.0), (80.0, 80.0), (0.0, 80.0)], corner_radius_m=20.0)
    config, dt, axle = DriveConfig(speed_limit_mps=5.0, red_share=0.0), 0.02, 1.35
    car, streams = CityDrive(road, config, dt, axle), Streams(3, 2)
    state, slips = car.start(streams), []
    for _ in range(2000):
        truth = car.step(state, streams)
        velocity = truth.velocity_enu_mps
        slip = np.arctan2(velocity[:, 0], velocity[:, 1]) - truth.heading_rad
        slips.append((slip + np.pi) % (2.0 * np.pi) - np.pi)
        speed, rate = np.hypot(velocity[:, 0], velocity[:, 1]), truth.delta_theta_rad[:, 2] / dt
        middle = np.mean(slips[-2:], axis=0)  # the rate is that of the middle of the epoch
        assert np.abs(np.sin(middle) * speed - axle * rate).max() < 0.02
    assert np.abs(slips).max() == pytest.approx(np.arcsin(axle / 20.0), rel=0.01)
    straight = CityDrive(road, config, dt)
    state, plain = straight.start(streams), car.start(streams)
    assert np.array_equal(straight.step(state, streams).position_enu_m, car.step(plain, streams).position_enu_m)
    with pytest.raises(InputError, match="axle_m"):
        CityDrive(road, config, dt, -1.0)
