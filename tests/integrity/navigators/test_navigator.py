"""The navigator: fixes, outages, modes, faults, reproducible bits, refusals."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from fault_rows import satellite_modes
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import wrap_angle
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.monitoring.dead_reckoning_pl import initial_growth, missed_detection_factors
from lanebound.integrity.monitoring.dead_reckoning_pl import protection_levels as protection_levels_dead
from lanebound.integrity.monitoring.dead_reckoning_pl_kernel import shortened
from lanebound.integrity.monitoring.protection import protection_levels
from lanebound.integrity.monitoring.risk import RiskConfig, Variant
from lanebound.integrity.monitoring.separation import separate
from lanebound.integrity.motion.drive import CityDrive, DriveConfig
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import LATEST
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode, RtkStatus
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.city import CityConfig, build_city
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.road import Road
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

Array = NDArray[np.float64]
DT = 0.1
NOMINAL = NavigatorConfig()
# Without slips, atmosphere and ageing the declared errors bound the real ones: faults then come only from a schedule.
# The correlation time of Doppler errors is known, so that levels are tight and jumps of half a metre contradict them.
CALM = NOMINAL.replace(
    gnss=NOMINAL.gnss.replace(slips_per_h=0.0, baseline_km=0.0, age_rate_mps=0.0),
    positioning={"doppler": {"tau_range_s": (0.54, 0.54)}},
)
TRACK = SkyTrack.from_config(SkyConfig(), 300.0)
QUADRANTS = np.array([0.4, 2.0, 3.9, 5.2])


def _navigator(
    config: NavigatorConfig = CALM,
    seeds: int | list[int] | None = None,
    batch: int | None = None,
    mask: SkyMask | None = None,
    faults: tuple[Fault, ...] = (),
) -> Navigator:
    return Navigator(config, TRACK, mask or SkyMask.open(), seeds or [1, 2, 3, 4], batch, FaultSchedule(faults))


@dataclass
class _Drive:
    """What came out of a drive, epoch by epoch: (T,), (T, B) or (T, B, 2)."""

    solutions: list[Solution]
    truth_en_m: Array

    def __getattr__(self, name: str) -> Array:
        return np.array([getattr(s, name) for s in self.solutions])

    @property
    def error_m(self) -> Array:
        return np.asarray(np.hypot(*np.moveaxis(self.position_en_m - self.truth_en_m, -1, 0)))


class _Cars:
    """Vehicles on straight lines from the origin, one azimuth each; arc and distance are the same."""

    def __init__(self, navigator: Navigator, azimuth_rad: Array = QUADRANTS) -> None:
        self.navigator, self.azimuth_rad = navigator, azimuth_rad[: navigator.batch]
        self.time_s, self.arc_m = 0.0, 0.0
        self.speed_mps: float | None = None

    @property
    def along(self) -> Array:
        return np.column_stack([np.sin(self.azimuth_rad), np.cos(self.azimuth_rad)])

    def truth(self, speed_mps: float) -> Truth:
        """The next epoch, at whose end the speed is reached, and at whose beginning it was the last one."""
        last_mps = speed_mps if self.speed_mps is None else self.speed_mps
        before, after = self.arc_m, self.arc_m + 0.5 * (last_mps + speed_mps) * DT
        self.time_s, self.arc_m, self.speed_mps = self.time_s + DT, after, speed_mps
        position = (self.along * before, self.along * after)
        velocity = (self.along * last_mps, self.along * speed_mps)
        return truth_between(self.time_s, DT, position, velocity, (self.azimuth_rad, self.azimuth_rad), arc_m=after)

    def drive(self, seconds: float, speed_mps: float = 10.0) -> _Drive:
        solutions, places = [], []
        for _ in range(round(seconds / DT)):
            solutions.append(self.navigator.step(self.truth(speed_mps)))
            places.append(self.along * self.arc_m)
        return _Drive(solutions, np.array(places))


def _assert_same(a: Solution, b: Solution, row: int | None = None) -> None:
    """Every field has the same bits; with ``row`` vehicle ``row`` of a against the only vehicle of b."""
    for field in fields(Solution):
        one, two = getattr(a, field.name), getattr(b, field.name)
        if one is None:  # no context monitor
            assert two is None
            continue
        np.testing.assert_array_equal(one if row is None or field.name == "time_s" else one[[row]], two)


def test_open_sky_gives_rtk_in_seconds_within_its_protection_levels() -> None:
    run = _Cars(_navigator(NOMINAL)).drive(60.0)
    first = np.argmax(run.mode == Mode.RTK, axis=0)
    assert ((first > 0) & (first < 50)).all()
    located = run.mode != Mode.NONE
    bound = np.hypot(run.pl_at_m, run.pl_ct_m)
    assert (run.error_m[located] < bound[located]).all()
    assert run.error_m[run.mode == Mode.RTK].max() < 0.05
    assert (bound[run.mode == Mode.RTK] < 0.2).all()
    assert np.isfinite(run.pl_cases_m[100:]).all()
    assert run.alert[0].all()
    assert not run.alert[60:].any()
    for field in fields(Solution):
        if field.name != "context":  # no context monitor
            assert not np.isnan(getattr(run, field.name)).any(), field.name


def test_heading_and_velocity_follow_the_motion_in_every_quadrant() -> None:
    run = _Cars(_navigator()).drive(20.0)
    turn = np.angle(np.exp(1j * (run.heading_rad[50:] - QUADRANTS)))
    assert np.abs(turn).max() < np.deg2rad(1.0)
    along = np.column_stack([np.sin(QUADRANTS), np.cos(QUADRANTS)])
    np.testing.assert_allclose(run.velocity_en_mps[50:].mean(0), 10.0 * along, atol=0.05)


def test_nothing_is_believed_before_the_first_fix() -> None:
    solution = _Cars(_navigator()).drive(DT).solutions[0]
    assert (solution.mode == Mode.NONE).all()
    assert np.isinf(solution.pl_cases_m).all()
    assert solution.alert.all()
    assert not solution.available.any()
    assert np.isinf(solution.since_rtk_s).all()


LOSS = Fault(kind="corrections_loss", start_s=10.0, duration_s=50.0)


def _tunnel(start_m: float, end_m: float) -> SkyMask:
    """A straight road of 2 km with no sky between two places."""
    path = np.zeros((201, 1, 1), dtype=np.uint8)
    path[round(start_m / 10.0) : round(end_m / 10.0)] = SignalPath.BLOCKED
    return SkyMask(path, np.zeros(path.shape, dtype=np.float32), 1, 1, 10.0, 2000.0, False)


def test_an_outage_runs_through_the_modes_and_the_levels_saw() -> None:
    """Corrections end at 10 s and are too old at 40 s; a tunnel from 45 s to 50 s; corrections return at 60 s."""
    run = _Cars(_navigator(mask=_tunnel(450.0, 500.0), faults=(LOSS,))).drive(70.0)
    changes = [run.mode[:, v][np.flatnonzero(np.diff(run.mode[:, v], prepend=-1))] for v in range(4)]
    for order in changes:
        np.testing.assert_array_equal(
            order, [Mode.NONE, Mode.RTK, Mode.DOPPLER, Mode.IMU_ODOMETER, Mode.DOPPLER, Mode.RTK]
        )
    outage = slice(415, 595)
    assert (run.rtk[outage] == RtkStatus.NO_CORRECTIONS.code).all()
    level = np.stack([run.pl_at_m, run.pl_ct_m], -1)
    growth = np.diff(level[outage], axis=0)
    assert growth.min() > -0.01  # the track axes turn a little with the estimated heading
    assert (growth > 0.0).mean() > 0.95  # the separations are measured, so they may shrink
    assert (level[outage][-1] > 5.0 * level[385]).all()
    assert (level[-1] < 0.1).all()
    np.testing.assert_array_less(run.error_m[30:], np.hypot(*np.moveaxis(level[30:], -1, 0)))


def test_doppler_positioning_ends_a_minute_after_the_last_fix() -> None:
    loss = LOSS.replace(start_s=5.0, duration_s=200.0)
    rtk = CALM.positioning.rtk.replace(max_age_s=3.0)
    config = CALM.replace(positioning=CALM.positioning.replace(rtk=rtk))
    run = _Cars(_navigator(config, faults=(loss,))).drive(75.0)
    outage = run.since_rtk_s > 0.05
    doppler = (run.mode == Mode.DOPPLER) & outage
    assert doppler.any(axis=0).all()
    assert run.since_rtk_s[doppler].max() == pytest.approx(60.0, abs=0.11)
    assert (run.mode[-1] == Mode.IMU_ODOMETER).all()


def test_at_rest_in_an_outage_only_the_creep_that_the_odometer_may_hide_grows() -> None:
    cars = _Cars(_navigator(faults=(LOSS,)))
    cars.drive(45.0)
    rest = cars.drive(10.0, speed_mps=0.0)
    settled = slice(20, None)
    assert (rest.mode[settled] != Mode.RTK).all()
    assert np.ptp(rest.position_en_m[settled], axis=0).max() == 0.0
    creep_m = CALM.positioning.dead_reckoning.standstill_speed_mps * 0.1 * (len(rest.mode) - 21)
    np.testing.assert_allclose(np.ptp(rest.pl_at_m[settled], axis=0), creep_m, rtol=0.01)
    assert np.ptp(rest.pl_ct_m[settled], axis=0).max() < 0.02
    assert np.ptp(rest.heading_rad[settled], axis=0).max() < 0.01


def test_an_odometer_that_doppler_contradicts_has_no_level() -> None:
    lost = Fault(kind="corrections_loss", start_s=3.0, duration_s=100.0)
    frozen = Fault(kind="odometer_frozen", start_s=40.0, duration_s=60.0)
    cars = _Cars(_navigator(faults=(lost, frozen)))
    cars.drive(40.0, speed_mps=10.0)
    run = cars.drive(10.0, speed_mps=5.0)
    late = slice(20, None)
    assert (run.mode[late] == Mode.IMU_ODOMETER).all()
    assert np.isinf(run.pl_at_m[late]).all()
    assert run.alert[late].all()
    assert (run.reason[late] == AlertReason.INTEGRITY_TEST_FAILED.code).all()


def test_a_heading_knocked_off_by_the_gyro_is_found_again() -> None:
    knock = Fault(kind="gyro_bias", start_s=20.0, duration_s=3.0, magnitude_degps=5.0)
    cars = _Cars(_navigator(faults=(knock,)))
    run = cars.drive(60.0)
    error = np.abs(wrap_angle(run.heading_rad[-1] - QUADRANTS))
    assert np.rad2deg(error).max() < 2.0


def test_levels_that_do_not_fit_the_tests_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"fde\.alpha"):
        NOMINAL.replace(fde={"alpha": 1e-4})


def test_jamming_everything_leaves_the_odometer() -> None:
    jam = Fault(kind="jamming", start_s=10.0, duration_s=10.0, magnitude_db=60.0)
    run = _Cars(_navigator(faults=(jam,))).drive(30.0)
    assert (run.mode[110:195] == Mode.IMU_ODOMETER).all()
    assert (run.satellites_doppler[110:195] == 0).all()
    assert (run.mode[-1] == Mode.RTK).all()


AXLE_M = 2.5


def _bend(
    navigator: Navigator, yaw_rate_radps: Callable[[float], float], seconds: float
) -> tuple[Array, Array, _Drive]:
    """Drive at 10 m/s with a reference point ``AXLE_M`` ahead of a rear axle that goes where the car points.

    Errors along and across the heading (T, B, 2), those of the heading (T, B), and the drive.
    """
    heading, rear, rate = QUADRANTS.copy(), np.zeros((4, 2)), 0.0
    solutions, places, errors, off = [], [], [], []
    for k in range(round(seconds / DT)):
        before = _pose(heading, rear, rate)
        rate = yaw_rate_radps(k * DT)
        middle, old = heading + 0.5 * rate * DT, heading
        chord = 10.0 * DT * np.sinc(0.5 * rate * DT / np.pi)
        rear = rear + chord * np.column_stack([np.sin(middle), np.cos(middle)])
        heading = heading + rate * DT
        after = _pose(heading, rear, rate)
        pairs = [(a, b) for a, b in zip(before, after, strict=True)]
        truth = truth_between((k + 1) * DT, DT, pairs[0], pairs[1], (wrap_angle(old), wrap_angle(heading)))
        solutions.append(navigator.step(truth))
        places.append(after[0])
        gap = solutions[-1].position_en_m - after[0]
        s, c = np.sin(heading), np.cos(heading)
        errors.append(np.column_stack([s * gap[:, 0] + c * gap[:, 1], c * gap[:, 0] - s * gap[:, 1]]))
        off.append(wrap_angle(solutions[-1].heading_rad - heading))
    return np.array(errors), np.array(off), _Drive(solutions, np.array(places))


def _pose(heading: Array, rear: Array, rate: float) -> tuple[Array, Array]:
    """Position and velocity of the reference point."""
    along, right = (
        np.column_stack([np.sin(heading), np.cos(heading)]),
        np.column_stack([np.cos(heading), -np.sin(heading)]),
    )
    return rear + AXLE_M * along, 10.0 * along + AXLE_M * rate * right


def test_in_a_bend_the_reference_point_moves_sideways() -> None:
    jam = Fault(kind="jamming", start_s=25.0, duration_s=10.0, magnitude_db=60.0)
    quarter = 0.5 * np.pi / 6.0
    ends = {}
    for axle_m in (AXLE_M, 0.0):
        navigator = _navigator(CALM.replace(positioning={"axle_m": axle_m}), faults=(jam,))
        errors, _, run = _bend(navigator, lambda t: quarter if 26.0 <= t < 32.0 else 0.0, 33.0)
        levels = np.stack([run.pl_at_m, run.pl_ct_m], -1)
        assert (run.mode[255:] == Mode.IMU_ODOMETER).all()
        ends[axle_m] = np.hypot(*np.moveaxis(errors[-1], -1, 0))
        assert (np.abs(errors[100:]) < levels[100:]).all() == (axle_m > 0.0)
    assert ends[AXLE_M].max() < 0.8  # of eight seconds by wheels and gyro
    np.testing.assert_allclose(ends[0.0], AXLE_M * np.sqrt(2.0), atol=0.6)


def test_bends_do_not_turn_the_heading_that_doppler_calibrates() -> None:
    offs = {}
    for axle_m in (AXLE_M, 0.0):
        navigator = _navigator(CALM.replace(positioning={"axle_m": axle_m}))
        _, off, _ = _bend(navigator, lambda t: 0.2 if t > 10.0 else 0.0, 40.0)
        offs[axle_m] = np.abs(off[-50:]).max()
    assert offs[AXLE_M] < np.deg2rad(0.5)
    assert offs[0.0] > np.deg2rad(1.0)


def test_a_restored_snapshot_goes_on_with_the_same_bits() -> None:
    cars = _Cars(_navigator(NOMINAL))
    cars.drive(5.0)
    kept, time_s, arc_m = cars.navigator.snapshot(), cars.time_s, cars.arc_m
    one = cars.drive(5.0)
    cars.navigator.restore(kept)
    cars.time_s, cars.arc_m = time_s, arc_m
    two = cars.drive(5.0)
    for a, b in zip(one.solutions, two.solutions, strict=True):
        _assert_same(a, b)


def test_a_vehicle_is_the_same_alone_and_in_company() -> None:
    together = _Cars(_navigator(NOMINAL)).drive(8.0)
    alone = _Cars(_navigator(NOMINAL, [3]), QUADRANTS[2:]).drive(8.0)
    for a, b in zip(together.solutions, alone.solutions, strict=True):
        _assert_same(a, b, row=2)


def test_one_seed_serves_a_batch_and_repeats() -> None:
    one, two, other = (_Cars(_navigator(NOMINAL, seed, 4)).drive(6.0) for seed in (5, 5, 6))
    _assert_same(one.solutions[-1], two.solutions[-1])
    assert (one.mode[-1] == Mode.RTK).any()
    assert len(np.unique(one.speed_mps[-1])) > 1
    assert not np.array_equal(one.position_en_m[-1], other.position_en_m[-1])


def _owned(truth: Truth) -> Truth:
    """The same truth in records of its own, to be spoilt later."""
    return Truth.of(truth.time_s, truth.dt_s, truth.records.copy())


def test_the_truth_does_not_reach_what_is_believed() -> None:
    cars, twins = _Cars(_navigator(NOMINAL)), _Cars(_navigator(NOMINAL))
    for _ in range(60):
        truth = _owned(cars.truth(10.0))
        measured = cars.navigator.measure(truth)
        for field in fields(Truth):
            value = getattr(truth, field.name)
            if isinstance(value, np.ndarray) and field.init:  # a view of the records
                value[:] = -1 if value.dtype == np.int64 else np.nan
        _assert_same(cars.navigator.locate(measured), twins.navigator.step(twins.truth(10.0)))


def test_reference_coordinates_wrong_from_the_first_fix_on_move_it_unseen() -> None:
    wrong = Fault(kind="reference_coordinates", start_s=0.0, duration_s=99.0, magnitude_m=1.0, azimuth_deg=90.0)
    moved, true = _Cars(_navigator(faults=(wrong,))).drive(8.0), _Cars(_navigator()).drive(8.0)
    fixed = (moved.mode == Mode.RTK) & (true.mode == Mode.RTK)
    assert fixed[-1].all()
    shift = (moved.position_en_m - true.position_en_m)[fixed]
    np.testing.assert_allclose(shift, np.broadcast_to([1.0, 0.0], shift.shape), atol=1e-6)
    np.testing.assert_allclose(moved.pl_at_m[fixed], true.pl_at_m[fixed], rtol=1e-6)
    assert moved.pl_at_m[fixed].max() < 0.1


def _over(run: _Drive) -> Array:
    """Where the error exceeds its level on either axis, (T, B)."""
    sine, cosine = np.sin(run.heading_rad), np.cos(run.heading_rad)
    east, north = np.moveaxis(run.position_en_m - run.truth_en_m, -1, 0)
    along, across = np.abs(sine * east + cosine * north), np.abs(cosine * east - sine * north)
    return np.asarray((along > run.pl_at_m) | (across > run.pl_ct_m))


@pytest.mark.parametrize("kind", ["spoofing", "reference_coordinates"])
@pytest.mark.parametrize("size_m", [0.5, 3.0, 20.0])
def test_a_shift_of_all_satellites_does_not_move_the_position(kind: str, size_m: float) -> None:
    """Residuals are perfect under it. It is held against what was expected, and not believed for a while."""
    shift = Fault(kind=kind, start_s=10.0, duration_s=10.0, magnitude_m=size_m, azimuth_deg=60.0)
    cars = _Cars(_navigator(faults=(shift,)))
    before, during, after = cars.drive(10.0), cars.drive(10.0), cars.drive(62.0)
    assert (before.doubt_en_m == 0.0).all()
    assert (during.rtk[0] == RtkStatus.FAULT.code).all()
    assert during.error_m.max() < 1.5  # of ten seconds by wheels and gyro
    assert during.alert[10:].all()
    assert not any(_over(run).any() for run in (before, during, after))
    shift_en_m = size_m * np.array([np.sin(np.deg2rad(60.0)), np.cos(np.deg2rad(60.0))])
    np.testing.assert_allclose(during.doubt_en_m[-1], np.broadcast_to(shift_en_m, (4, 2)), atol=1.5)
    assert (after.doubt_en_m[-1] == 0.0).all()
    assert (after.mode[-1] == Mode.RTK).all()
    assert after.pl_at_m[-1].max() < 0.1


def _creeping(rate_mps: float, config: NavigatorConfig = CALM) -> _Drive:
    """A reference station whose coordinates drift for twenty seconds and stay there for twenty more."""
    creep = Fault(kind="reference_coordinates", start_s=10.0, duration_s=40.0, magnitude_m=20.0 * rate_mps,
                  profile="ramp", ramp_s=20.0, azimuth_deg=30.0)  # fmt: skip
    cars = _Cars(_navigator(config, faults=(creep,)))
    cars.drive(10.0)
    return cars.drive(30.0)


CARRIED = CALM.replace(positioning={"doppler": {"carriers": True}})


@pytest.mark.parametrize(
    ("config", "rate_mps", "after_s"),
    [(CALM, 0.2, 6.0), (CALM, 0.5, 3.0), (CALM, 1.0, 1.5), (CALM, 2.0, 0.5), (CARRIED, 0.5, 3.0), (CARRIED, 2.0, 0.5)],
)
def test_the_backup_solution_detects_a_position_that_drifts(
    config: NavigatorConfig, rate_mps: float, after_s: float
) -> None:
    """No single epoch shows the drift: each moves by less than its levels. The backup solution had drifted a metre.

    Carriers against a reference that drifts drift with it: they move the position, and not the backup solution.
    """
    run = _creeping(rate_mps, config)
    late = DT * np.arange(len(run.solutions)) > after_s
    assert run.alert[late].all()
    assert (run.mode[late] != Mode.RTK).all()
    assert run.error_m[~run.alert].max() < (1.4 if config is CALM else 1.5)
    assert run.error_m.max() < 6.0  # of half a minute by wheels and gyro
    shift_en_m = 20.0 * rate_mps * np.array([np.sin(np.deg2rad(30.0)), np.cos(np.deg2rad(30.0))])
    refused_en_m = run.position_en_m[-1] + run.doubt_en_m[-1]
    np.testing.assert_allclose(refused_en_m - run.truth_en_m[-1], np.broadcast_to(shift_en_m, (4, 2)), atol=0.2)


def test_carriers_do_not_blame_the_odometer_for_a_reference_that_drifts() -> None:
    """Along the track, within the declared scale: carriers agree with RTK because both drift, and RTK is not believed
    again after the short quarantine."""
    creep = Fault(kind="reference_coordinates", start_s=50.0, duration_s=60.0, magnitude_m=3.0, profile="ramp",
                  ramp_s=20.0, azimuth_deg=float(np.rad2deg(QUADRANTS[0])))  # fmt: skip
    watched = {"doppler": {"carriers": True}, "rtk": {"drift": {"window_s": 16.0}}}
    cars = _Cars(_navigator(CALM.replace(positioning=watched), faults=(creep,)))
    cars.drive(50.0)
    run = cars.drive(50.0)
    found = np.logical_or.accumulate(run.alert)
    assert found[100].all()
    assert run.alert[found].all()


def test_without_a_backup_solution_a_position_that_drifts_is_followed() -> None:
    rtk = CALM.positioning.rtk.replace(backup_s=0.0)
    run = _creeping(0.5, CALM.replace(positioning=CALM.positioning.replace(rtk=rtk)))
    assert (run.mode == Mode.RTK).all()
    assert run.error_m[-1].min() > 9.9
    assert not run.alert.any()


@pytest.mark.parametrize("rate_mps", [3.0, 25.0])
def test_signals_that_run_away_from_the_wheels_are_not_followed(rate_mps: float) -> None:
    """A spoofer who moves Doppler and phases together, along the track; the others go across it."""
    away = Fault(kind="spoofing", start_s=10.0, duration_s=20.0, magnitude_m=20.0 * rate_mps, profile="ramp",
                 ramp_s=20.0, azimuth_deg=float(np.rad2deg(QUADRANTS[0])))  # fmt: skip
    cars = _Cars(_navigator(faults=(away,)))
    cars.drive(10.0)
    run = cars.drive(22.0)
    assert run.alert[10:, 0].all()
    assert run.error_m[:, 0].max() < 7.0
    assert not (_over(run)[:, 0] & ~run.alert[:, 0])[1:].any()


def test_after_wheels_that_lied_in_a_tunnel_rtk_is_believed_again_within_seconds() -> None:
    slip = Fault(kind="wheel_slip", start_s=11.0, duration_s=14.0, magnitude_ratio=-0.045)
    run = _Cars(_navigator(mask=_tunnel(100.0, 250.0), faults=(slip,))).drive(45.0)
    doubted = np.abs(run.doubt_en_m).max(-1) > 0.0
    assert doubted.any(0).any()
    assert run.alert[doubted].all()
    assert doubted.sum(0).max() < 90
    assert (run.mode[-1] == Mode.RTK).all()
    assert run.error_m[-1].max() < 0.1


def test_without_a_fault_no_jump_is_doubted() -> None:
    """Through a tunnel, whose far end is the largest jump there is."""
    run = _Cars(_navigator(mask=_tunnel(100.0, 250.0))).drive(45.0)
    assert set(np.unique(run.mode)) >= {Mode.RTK, Mode.IMU_ODOMETER}
    assert (run.mode[-1] == Mode.RTK).all()
    assert (run.doubt_en_m == 0.0).all()
    assert not (run.rtk == RtkStatus.FAULT.code).any()


def test_a_declared_reference_error_adds_to_the_level() -> None:
    rtk = CALM.positioning.rtk.replace(reference_bias_m=0.25)
    declared = _Cars(_navigator(CALM.replace(positioning=CALM.positioning.replace(rtk=rtk)))).drive(6.0)
    plain = _Cars(_navigator()).drive(6.0)
    assert (plain.mode[-1] == Mode.RTK).all()
    np.testing.assert_allclose(declared.pl_at_m[-1], plain.pl_at_m[-1] + 0.25, rtol=1e-9)
    np.testing.assert_allclose(declared.pl_ct_m[-1], plain.pl_ct_m[-1] + 0.25, rtol=1e-9)


def _with_false_range(**fault: Any) -> tuple[int, _Drive]:
    """A satellite that all hold, and a drive of 5 s on which its range goes wrong after 1 s."""
    cars = _Cars(_navigator())
    before = cars.drive(9.0).solutions[-1]
    row = int(np.flatnonzero(before.held.all(0) & (TRACK.system == System.GPS))[0])
    cars.navigator.faults = FaultSchedule(
        (
            Fault(
                kind="satellite_range", start_s=10.0, duration_s=5.0,
                system=System.GPS, prn=int(TRACK.prn[row]), **fault,
            ),
        )
    )  # fmt: skip
    return row, cars.drive(5.0)


def test_a_range_that_jumps_is_let_go_at_once() -> None:
    row, run = _with_false_range(magnitude_m=5.0)
    assert run.held[9, :, row].all()
    assert not run.held[10, :, row].any()
    assert (run.mode == Mode.RTK).all()
    assert run.error_m.max() < 0.05


def test_a_range_that_creeps_away_unseen_from_epoch_to_epoch_is_excluded() -> None:
    row, run = _with_false_range(magnitude_m=1.0, profile="ramp", ramp_s=4.0)
    assert (run.excluded >= 1).any(axis=0).all()
    assert not run.held[10:, :, row].all(axis=0).any()
    assert (run.mode == Mode.RTK).all()
    assert run.error_m.max() < 0.1


def test_the_reference_point_comes_back_from_a_forward_antenna() -> None:
    config = CALM.replace(positioning=CALM.positioning.replace(antenna_forward_m=1.0))
    run = _Cars(_navigator(config)).drive(8.0)
    assert (run.mode[-1] == Mode.RTK).all()
    assert run.error_m[run.mode == Mode.RTK].max() < 0.06


@pytest.mark.parametrize(("forward_m", "right_m"), [(1.5, 0.0), (0.0, -1.0), (1.0, 0.5)])
def test_levels_hold_what_an_unknown_heading_does_to_a_lever(forward_m: float, right_m: float) -> None:
    """Before the car first moves its heading is anybody's guess, and so is where it stands around its antenna."""
    lever = {"antenna_forward_m": forward_m, "antenna_right_m": right_m}
    cars = _Cars(_navigator(CALM.replace(positioning=CALM.positioning.replace(**lever))))
    standing, moving = cars.drive(10.0, speed_mps=0.0), cars.drive(20.0)
    for run in (standing, moving):
        off = run.position_en_m - run.truth_en_m
        sine, cosine = np.sin(run.heading_rad), np.cos(run.heading_rad)
        at, ct = off[..., 0] * sine + off[..., 1] * cosine, off[..., 0] * cosine - off[..., 1] * sine
        fixed = run.mode == Mode.RTK
        assert fixed.any(axis=0).all()
        assert (np.abs(at) <= run.pl_at_m)[fixed].all()
        assert (np.abs(ct) <= run.pl_ct_m)[fixed].all()
    arm = np.hypot(forward_m, right_m)
    assert (standing.error_m[standing.mode == Mode.RTK] > 0.5 * arm).any()
    assert (standing.pl_at_m >= 2.0 * arm).all()
    assert (moving.pl_ct_m[-1] < 0.3 * arm + 0.1).all()


def test_without_a_sky_there_is_no_position_and_no_exception() -> None:
    blocked = SkyMask(
        np.full((1, 1, 1), SignalPath.BLOCKED, dtype=np.uint8), np.zeros((1, 1, 1), np.float32), 1, 1, 1.0, 1.0, True
    )
    run = _Cars(_navigator(mask=blocked)).drive(5.0)
    assert (run.mode == Mode.NONE).all()
    assert np.isinf(run.pl_cases_m).all()
    assert run.alert.all()
    assert (run.satellites == 0).all()
    for field in fields(Solution):
        if field.name != "context":  # no context monitor
            assert not np.isnan(getattr(run, field.name)).any(), field.name


def _rtk_rows(m: Measurements, s: Solution, v: int) -> tuple[NDArray[np.int64], Array]:
    """Satellites in the fixed solution and their variance factors, told from the measurements anew."""
    rtk = CALM.positioning.rtk
    sine = m.sky.los_enu[0, :, 2]
    usable = s.held[v] & (sine > np.sin(np.deg2rad(rtk.elevation_mask_deg))) & (m.gnss.cn0_dbhz[v] >= rtk.cn0_min_dbhz)
    system = m.sky.system
    enough = np.array([np.count_nonzero(usable & (system == c)) >= rtk.min_further for c in system])
    rows = np.flatnonzero(usable & enough)
    weak = 1.0 + 10.0 ** (0.1 * (rtk.cn0_knee_dbhz - m.gnss.cn0_dbhz[v, rows]))
    return rows, 0.5 * (1.0 + 1.0 / sine[rows] ** 2) * weak


@pytest.mark.parametrize("v", [0, 1, 2, 3])
def test_the_level_of_a_fix_is_that_of_the_plain_form(v: int) -> None:
    """Separation and root of the NumPy reference, with the rows told anew from the measurements."""
    cars = _Cars(_navigator())
    cars.drive(8.0)
    m = cars.navigator.measure(cars.truth(10.0))
    s = cars.navigator.locate(m)
    assert s.mode[v] == Mode.RTK
    assert s.excluded[v] == 0
    rows, factor = _rtk_rows(m, s, v)
    assert len(rows) == s.satellites[v]
    rtk, risk, system = CALM.positioning.rtk, CALM.risk, m.sky.system[rows]
    aged = (rtk.age_sigma_mps * s.corrections_age_s[v]) ** 2
    design = np.column_stack([-m.sky.los_enu[0, rows], (system[:, None] == np.unique(system)).astype(float)])
    separation = separate(
        design,
        np.diag(factor * rtk.sigma_phase_integrity_m**2 + aged),
        satellite_modes(np.arange(len(rows))),
        s.heading_rad[v],
        accuracy=np.diag(factor * rtk.sigma_phase_m**2 / len(CALM.gnss.bands) + aged),
        bias=rtk.phase_bias_m,
    )
    priors = np.array(risk.satellite_prior)[system]
    expected = protection_levels(separation, priors, risk, spent=s.wrong_fix_risk[v])[0]
    np.testing.assert_allclose([s.pl_at_m[v], s.pl_ct_m[v]], expected, rtol=1e-9)
    np.testing.assert_allclose([s.sigma_at_m[v], s.sigma_ct_m[v]], separation.sigma_m[0], rtol=1e-9)


SPARSE = [0, 3, 4, 6, 7, 8]  # rows of six GPS and Galileo satellites, HDOP 1.34 together


def _sparse_outage(rate_mps: float, seconds: float) -> tuple[Array, Array, Array]:
    """RTK ends after 8 s; then six satellites, of which the first drifts. Errors, levels and sigmas AT, CT, (B, 2)."""
    batch = 48
    rtk = CALM.positioning.rtk.replace(max_age_s=3.0)
    drift = Fault(
        kind="satellite_range", start_s=8.0, duration_s=60.0, profile="ramp", ramp_s=60.0,
        magnitude_m=60.0 * rate_mps, system=System(int(TRACK.system[SPARSE[0]])), prn=int(TRACK.prn[SPARSE[0]]),
    )  # fmt: skip
    config = CALM.replace(positioning=CALM.positioning.replace(rtk=rtk, mode={"doppler_when": "usable"}))
    navigator = _navigator(config, 5, batch, faults=(LOSS.replace(start_s=5.0), drift))
    cars = _Cars(navigator, np.linspace(0.0, 2.0 * np.pi, batch, endpoint=False))
    hidden = np.setdiff1d(np.arange(len(TRACK.system)), SPARSE)
    for epoch in range(round((8.5 + seconds) / DT)):
        m = navigator.measure(cars.truth(10.0))
        if epoch >= 85:
            m.gnss.tracked[:, hidden] = False
        s = navigator.locate(m)
    d, along = s.position_en_m - cars.along * cars.arc_m, cars.along
    error = np.column_stack([(d * along).sum(-1), d[:, 0] * along[:, 1] - d[:, 1] * along[:, 0]])
    return np.abs(error), s.pl_cases_m[:, 0], np.column_stack([s.sigma_at_m, s.sigma_ct_m])


def test_a_drift_that_passes_the_tests_stays_within_the_level() -> None:
    """A fault-free level alone would be exceeded; given the fault, that may happen with p <= 2 * FAULT_SHARE B / sum P.

    B = 5e-6 for an axis, six priors of 1e-5: p = 0.042. Of 48 drives 9 or more would by chance once in 5000 runs.
    """
    error, level, sigma = _sparse_outage(0.3, 30.0)
    fault_free = norm.isf(0.25 * CALM.risk.integrity_risk) * sigma
    assert (error > fault_free + 0.15).any(-1).sum() > 9
    assert (error > level).any(-1).sum() < 9
    assert np.isfinite(level).all()


def test_without_a_drift_the_level_of_a_sparse_sky_stays_near_the_fault_free_one() -> None:
    error, level, sigma = _sparse_outage(1e-9, 15.0)
    assert (error < level).all()
    assert np.median(level / (norm.isf(0.25 * CALM.risk.integrity_risk) * sigma)) < 1.5


RISK = CALM.risk.integrity_risk


def test_each_level_grows_from_its_own_start() -> None:
    """Exact beside published and published beside exact are the same pair, in RTK, by Doppler and in a tunnel."""
    exact = CALM.replace(more_levels=[{"integrity_risk": RISK, "variant": "published", "form": "closed"}])
    published = CALM.replace(
        risk={"variant": "published"}, more_levels=[{"integrity_risk": RISK, "variant": "exact", "form": "root"}]
    )
    runs = [_Cars(_navigator(c, mask=_tunnel(450.0, 500.0), faults=(LOSS,))).drive(58.0) for c in (exact, published)]
    np.testing.assert_array_equal(runs[0].mode, runs[1].mode)
    assert {Mode.RTK, Mode.DOPPLER, Mode.IMU_ODOMETER} <= set(np.unique(runs[0].mode))
    np.testing.assert_array_equal(runs[0].pl_cases_m, runs[1].pl_cases_m[:, :, ::-1])


def test_levels_in_a_tunnel_are_those_of_the_plain_form() -> None:
    """Covariance and biases of the vehicle, in the reference functions, with the bias that each level began with.

    Exact levels also have what wrong headings have shortened the path by; its bound has a test of its own.
    """
    more = [{"integrity_risk": r, "variant": v} for r in (1e-3, RISK) for v in ("published", "exact")]
    sound = {"satellite_prior": (0.0,) * 5, "doppler_constellation_prior": (0.0,) * 5}
    navigator = _navigator(CALM.replace(more_levels=more, risk=sound), mask=_tunnel(150.0, 400.0))
    run = _Cars(navigator).drive(20.0)
    belief = navigator.state.belief
    g, start = belief.vehicles["growth"][:, LATEST], belief.starts[:, LATEST]
    wrong = CALM.positioning.rtk.ambiguity_risk_share * RISK
    for r, case in enumerate(navigator.config.cases):
        growth = initial_growth(run.covariance_en_m2[-1], np.zeros((4, 2)), 0.0)
        growth = replace(
            growth,
            by_heading_m=np.stack([g["cth_e"], g["cth_n"]], -1),
            by_speed_m=np.stack([g["cv_e"], g["cv_n"]], -1),
            by_axle_m=np.stack([g["axle_e"], g["axle_n"]], -1),
            box_m=np.stack([g["box_e"] + start["bias_first"][:, r], g["box_n"] + start["bias_second"][:, r]], -1),
        )
        config = RiskConfig(variant=case.variant, unmonitored_risk=wrong)
        expected = protection_levels_dead(growth, run.heading_rad[-1], config, [case.integrity_risk])[:, 0]
        if case.variant is Variant.EXACT:
            k = missed_detection_factors(config, [case.integrity_risk])[0]
            for v, heading in enumerate(run.heading_rad[-1]):
                sine, cosine = np.sin(heading), np.cos(heading)
                short = [shortened(*axis, k[q], g[v]) for q, axis in enumerate([(sine, cosine), (cosine, -sine)])]
                assert 0.0 < max(short) < 0.1
                expected[v] += short
        np.testing.assert_allclose(run.pl_cases_m[-1, :, r], expected, rtol=1e-9)
        level = run.pl_cases_m[149, :, r]
        assert (expected > level).all()


@pytest.mark.parametrize("braking_mps2", [2.0, 3.0])
def test_an_odometer_frozen_in_a_tunnel_is_told_within_two_seconds(braking_mps2: float) -> None:
    frozen = Fault(kind="odometer_frozen", start_s=20.0, duration_s=60.0)
    cars = _Cars(_navigator(mask=_tunnel(150.0, 400.0), faults=(frozen,)))
    before = cars.drive(20.0)
    assert np.isfinite(before.pl_at_m[-1]).all()
    assert (before.mode[-1] == Mode.IMU_ODOMETER).all()
    speeds = 10.0 - braking_mps2 * DT * np.arange(1, 21)
    braking = [cars.drive(DT, v).solutions[0] for v in speeds]
    assert np.isinf(braking[-1].pl_cases_m).all()
    assert (braking[-1].reason == AlertReason.INTEGRITY_TEST_FAILED.code).all()
    late = cars.drive(5.0, speeds[-1])
    assert np.isinf(late.pl_at_m).all()


def test_fault_free_traffic_raises_no_doubt() -> None:
    """16,000 epochs of stops, starts and curves in the open: the odometer is never doubted."""
    road = Road.through(np.array([[0.0, 0.0], [300.0, 0.0], [300.0, 300.0], [0.0, 300.0]]), closed=True)
    navigator, streams = _navigator(CALM, 3, 64), Streams(4, 64)
    car = CityDrive(road, DriveConfig(), DT)
    state = car.start(streams, 500.0)
    for _ in range(250):
        navigator.step(car.step(state, streams))
        assert not navigator.state.belief.vehicles["unbounded"].any()


def test_unfit_truth_is_refused() -> None:
    navigator = _navigator()
    with pytest.raises(InputError, match="truth must have 4 vehicles"):
        navigator.measure(_Cars(_navigator(seeds=[1])).truth(10.0))
    fine = _Cars(navigator).truth(10.0)
    with pytest.raises(InputError, match=r"truth\.dt_s must be 0\.1"):
        navigator.measure(replace(fine, dt_s=0.2))
    with pytest.raises(InputError, match="gps_time_s must lie in"):
        navigator.measure(replace(fine, time_s=1e6))
    with pytest.raises(InputError, match="non-negative"):
        _navigator(seeds=[-1])


def _slip(row: int, cycles: float, start_s: float) -> Fault:
    return Fault(
        kind="cycle_slip", start_s=start_s, duration_s=DT, magnitude_cycles=cycles,
        system=System(int(TRACK.system[row])), prn=int(TRACK.prn[row]),
    )  # fmt: skip


def test_an_unseen_slip_is_caught_at_its_epoch_before_the_fault_test_meets_it() -> None:
    cars = _Cars(_navigator())
    before = cars.drive(9.0).solutions[-1]
    row = int(np.flatnonzero(before.held.all(0) & (TRACK.system == System.GPS))[0])
    kept = cars.navigator.state.belief.ambiguities["integers"][:, row].copy()
    cars.navigator.faults = FaultSchedule((_slip(row, 1, 9.5),))
    run = cars.drive(1.0)
    assert not run.excluded.any()
    assert (run.mode == Mode.RTK).all()
    assert run.error_m.max() < 0.05
    moved = cars.navigator.state.belief.ambiguities["integers"][:, row] - kept
    regained = run.held[-1, :, row]
    assert regained.any()
    np.testing.assert_array_equal(moved[regained], 1.0)
    assert (cars.navigator.state.belief.ambiguities["fix_id"][:, row] > 1).all()


def test_half_cycles_stop_rtk_no_longer_than_the_receiver_needs_to_correct_them() -> None:
    """Every second carrier comes back half a cycle off, which no set of integers explains."""
    cars = _Cars(_navigator())
    cars.drive(6.0)
    cars.navigator.state.gnss.signals["ambiguity"][:, ::2] += 1.0
    cars.navigator.state.belief.ambiguities["held"] = False
    run = cars.drive(CALM.gnss.half_cycle_resolve_s + 2.0)
    assert (run.mode[:30] != Mode.RTK).any(axis=0).all()
    assert (run.mode[-1] == Mode.RTK).all()
    assert run.error_m[-1].max() < 0.05


def test_one_carrier_half_a_cycle_off_stops_nothing() -> None:
    config = CALM.replace(gnss=CALM.gnss.replace(half_cycle_resolve_s=600.0))
    cars = _Cars(_navigator(config))
    before = cars.drive(6.0).solutions[-1]
    row = int(np.flatnonzero(before.held.all(0) & (TRACK.system == System.GPS))[0])
    cars.navigator.state.gnss.signals["ambiguity"][:, row] += 1.0
    cars.navigator.state.belief.ambiguities["held"] = False
    run = cars.drive(1.5)
    assert (run.rtk[5:] == RtkStatus.FIXED.code).all()
    assert not run.held[:, :, row].any()
    assert run.error_m[run.mode == Mode.RTK].max() < 0.05


def test_a_placed_vehicle_starts_from_its_prior_and_leaves_the_others_alone() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2, 3])
    before = navigator.state.belief.vehicles.copy()
    navigator.place(np.array([[4.0, -2.0]]), np.array([0.3]), 0.05, 0.01, np.array([1]))
    vehicles = navigator.state.belief.vehicles
    growth = vehicles["growth"][1]
    assert vehicles["position"][1].tolist() == [4.0, -2.0, 0.0]
    assert vehicles["heading"]["angle"][1] == 0.3
    np.testing.assert_array_equal(vehicles[[0, 2]], before[[0, 2]])
    assert (growth["p_ee"] == 0.05**2).all()
    assert (growth["p_nn"] == 0.05**2).all()
    assert vehicles["heading"]["p_hh"][1] == 0.01**2
    assert not any(growth[name].any() for name in growth.dtype.names if name not in ("p_ee", "p_nn"))


def test_a_prior_without_spread_is_refused() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1])
    with pytest.raises(InputError, match="sigma_m"):
        navigator.place(np.zeros((1, 2)), np.zeros(1), 0.0, 0.01)


def test_a_drive_through_a_city_without_its_place_on_the_road_is_refused() -> None:
    """The sky would be that of the start of the road all the time."""
    road = Road.straight(400.0, lane_count=2)
    mask = SkyMask.build(road, build_city(road, CityConfig(), np.random.default_rng(1)))
    config = NavigatorConfig()
    for forgets in (False, True):
        navigator = Navigator(config, SkyTrack.from_config(config.sky, 60.0), mask, [1])
        position, velocity, heading = np.array([[0.0, 10.0]]), np.array([[0.0, 20.0]]), np.zeros(1)
        with pytest.raises(InputError, match="arc_m") if forgets else nullcontext():
            for k in range(40):
                before, position = position, position + 0.1 * velocity
                arc = 0.0 if forgets else road.project(position)[0]
                poses = (before, position), (velocity, velocity), (heading, heading)
                navigator.step(truth_between(0.1 * (k + 1), 0.1, *poses, arc_m=arc))
