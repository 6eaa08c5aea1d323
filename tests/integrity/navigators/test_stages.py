"""Each stage of an epoch from hand-made records, by a closed form or an invariant; and the table against `locate`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom
from signal_records import rows_of

from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring import doppler_separation_kernel as dk
from lanebound.integrity.monitoring import heading_doubt_kernel as hd
from lanebound.integrity.monitoring import jump_kernel as jk
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.motion.truth import truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.epoch import MODES, NOT_PLAIN, STAGES, EpochCall, Listed
from lanebound.integrity.navigators.rtk_reckoning.epoch_kernel import locate
from lanebound.integrity.navigators.rtk_reckoning.modes_kernel import advance_doppler, advance_imu_odometer
from lanebound.integrity.navigators.rtk_reckoning.navigator import arrays_of, blank_epoch, blank_state
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters, epoch_tables
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, LATEST, Epoch
from lanebound.integrity.navigators.rtk_reckoning.stages import Point
from lanebound.integrity.positioning import codes_kernel as codes
from lanebound.integrity.positioning.float_filter_kernel import filter_of, filtered_ambiguities
from lanebound.integrity.positioning.rtk_kernel import UNUSED, Carriers
from lanebound.integrity.positioning.wrong_fix_kernel import next_best_integers
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
STAGE = {part.name: part.stage for part in STAGES if isinstance(part, Listed)}
N, DT = 12, 0.1
SYSTEM = np.tile([int(System.GPS), int(System.GALILEO)], N // 2)
AZIMUTH, ELEVATION = np.linspace(0.0, 2.0 * np.pi, N, endpoint=False), np.radians(np.tile([25.0, 70.0, 40.0], N // 3))
E = np.stack([np.cos(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION) * np.cos(AZIMUTH), np.sin(ELEVATION)], -1)
ANTENNA = np.array([12.0, -7.0, 1.5])
INTEGERS = np.random.default_rng(1).integers(-1000, 1000, (N, 2)).astype(float)


def blank(batch: int = 1, **changes: Any) -> Epoch:
    """Zeros, and satellites of two systems that are tracked and used; the vehicles head North."""
    config = NavigatorConfig.load(changes)
    assert isinstance(config, RtkReckoningConfig)
    assert config.dt_s == DT
    tables = epoch_tables(config, SYSTEM)
    state = blank_state(batch, N, tables.prior.size, len(config.cases), config.positioning.rtk)
    epoch = blank_epoch(epoch_parameters(config), tables, state)
    epoch.signals["e"], epoch.signals["tracked"], epoch.signals["cn0"], epoch.observed["age"] = E, True, 48.0, 0.5
    for name in ("quality", "factor", "used", "phase_ok"):
        epoch.marks[name] = 1
    epoch.work["cos_h"], epoch.work["mode"] = 1.0, codes.UNDECIDED
    return epoch


def run(name: str, epoch: Epoch) -> None:
    """Run a stage of the table for all vehicles."""
    STAGE[name](0, epoch.vehicles.size, epoch)


def measure(epoch: Epoch) -> None:
    """Codes and phases without errors, of an antenna at ANTENNA and carriers with INTEGERS."""
    clock = (10.0 * SYSTEM - (E @ ANTENNA))[:, None]
    epoch.signals["code"] = clock + 30.0
    epoch.signals["phase"] = clock - 12.0 + epoch.tables.satellites["wavelength"] * INTEGERS


def hold(epoch: Epoch) -> None:
    """Hold the right integers."""
    epoch.ambiguities["held"], epoch.ambiguities["integers"] = True, INTEGERS
    epoch.work["fixed"]["status"] = codes.FIXED


def covariance(variance: Array, clock: NDArray[np.int64], of: NDArray[np.bool_] | None = None) -> Array:
    """Of East, North, Up by least squares with a clock for each group."""
    design = np.column_stack([-E, *(clock == c for c in np.unique(clock))]).astype(float)
    weight = 1.0 / variance if of is None else of / variance
    return np.linalg.inv(design.T @ (weight[:, None] * design))[:3, :3]


# One test for each stage


def test_begin_advances_the_clocks_and_empties_the_work() -> None:
    epoch = blank()
    vehicle, w = epoch.vehicles, epoch.work
    vehicle["since_rtk"], vehicle["since_calibration"], vehicle["backup"]["age"] = 1.0, 2.0, 3.0
    vehicle["jump"]["stage"], vehicle["jump"]["left_s"] = jk.WAITING, 5.0
    w["mode"], w["integrates"], w["run"], w["excluded"], w["cause"], epoch.levels[:] = codes.RTK, True, 3.0, 2, 4, 7.0
    run("begin", epoch)
    assert vehicle["since_rtk"][0] == pytest.approx(1.0 + DT)
    assert vehicle["since_calibration"][0] == pytest.approx(2.0 + DT)
    assert vehicle["backup"]["age"][0] == pytest.approx(3.0 + DT)
    assert vehicle["jump"]["left_s"][0] == pytest.approx(5.0 - DT)
    assert [w[name][0] for name in ("mode", "integrates", "run", "excluded", "cause")] == [codes.UNDECIDED, 0, 0, 0, 0]
    assert np.isinf(epoch.levels).all()


def test_velocity_is_least_squares_without_the_faulty_satellite_and_knows_what_each_mode_does() -> None:
    epoch, velocity = blank(2), np.array([3.0, 4.0, 0.5])
    epoch.signals["range_rate"] = 0.7 - E @ velocity
    epoch.signals["range_rate"][1, 3] += 5.0
    run("velocity", epoch)
    w, sigma, knee = epoch.work, epoch.parameters["doppler"]["sigma"][0], epoch.parameters["rtk"]["cn0_knee"][0]
    quality = 0.5 * (1.0 + 1.0 / E[:, 2] ** 2) * (1.0 + 10.0 ** (0.1 * (knee - 48.0)))
    np.testing.assert_allclose(epoch.marks["quality"][0], quality)
    assert w["solved"].all()
    assert w["checked"].all()
    assert w["satellites_doppler"].tolist() == [N, N - 1]
    assert w["excluded_doppler"].tolist() == [0, 1]
    np.testing.assert_allclose(w["velocity"], [velocity, velocity], atol=1e-9)
    one, every = np.zeros(N, np.int64), np.ones(N, np.bool_)
    variance = quality * sigma**2
    for v, used in enumerate((every, np.arange(N) != 3)):
        q = covariance(variance, one, used)
        np.testing.assert_allclose(w["q"][v], q, rtol=1e-9, atol=1e-12)
        unit = covariance(np.ones(N), one, used)
        assert w["hdop_doppler"][v] == pytest.approx(math.sqrt(unit[0, 0] + unit[1, 1]))
        now = epoch.faults["now"][v]
        modes = [np.arange(N) == s for s in range(N)] + [g == SYSTEM for g in range(len(now) - N)]
        for mode, members in zip(now, modes, strict=True):
            assert mode["state"] == (dk.MONITORED if (members & used).any() else dk.IDLE)
            np.testing.assert_allclose([mode["d_e"], mode["d_n"]], 0.0, atol=1e-9)
            factor = np.array([[mode["l_ee"], 0.0], [mode["l_ne"], mode["l_nn"]]])
            without = covariance(variance, one, used & ~members)
            np.testing.assert_allclose((q[:2, :2] + factor @ factor.T), without[:2, :2], rtol=1e-7, atol=1e-12)


def locked(batch: int = 1) -> Epoch:
    """Carriers give the velocity where they have been locked for a window."""
    return blank(batch, positioning={"doppler": {"carriers": True}})


def follow(epoch: Epoch, epochs: range, off_m: Array, noise_m: float = 0.0) -> Array:
    """Drive at (3, 4, 0.5) m/s with carriers that are ``off_m`` (T, S) late.  Errors (T, B, 3) of the mean velocity.

    ``noise_m`` is 1 sigma at the zenith.
    """
    velocity, errors, rng = np.array([3.0, 4.0, 0.5]), [], np.random.default_rng(epochs.start)
    knee = epoch.parameters["rtk"]["cn0_knee"][0]
    sigma = noise_m * np.sqrt(0.5 * (1.0 + 1.0 / E[:, 2] ** 2) * (1.0 + 10.0 ** (0.1 * (knee - 48.0))))
    for k in epochs:
        late = off_m[k] + sigma * rng.standard_normal((epoch.vehicles.size, N))
        epoch.signals["phase"] = (100.0 + 7.0 * k - E @ (velocity * DT * k) + late)[..., None]
        epoch.signals["range_rate"] = 70.0 - E @ velocity
        run("velocity", epoch)
        errors.append(epoch.work["velocity"] - velocity)
        run("carriers", epoch)
    return np.array(errors)


def first_test(epoch: Epoch) -> int:
    """The epoch of the first test: a window has ended and the next one too."""
    return 2 * round(float(epoch.parameters["doppler"]["window"][0]) / DT)


def test_carriers_mirrored_by_one_facade_give_no_velocity() -> None:
    epoch, drifts = locked(), np.isin(np.arange(N), (2, 3, 5))
    begin = first_test(epoch)
    off_m = 0.05 * np.arange(begin + 2)[:, None] * drifts  # in an epoch less than five sigma of its change
    errors = follow(epoch, range(begin + 2), off_m)
    assert epoch.work["by_carriers"].all()
    used = epoch.faults["now"]["state"][0, :N] == dk.MONITORED
    assert not (used & drifts).any()  # good carriers between them may go too
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)  # range rates before


def test_carrier_that_begins_to_drift_is_excluded_within_a_second() -> None:
    epoch = locked()
    begin = first_test(epoch) + 5
    off_m = np.zeros((begin + 11, N))
    off_m[begin:, 3] = 0.02 * np.arange(1, 12)  # less than one sigma of a change
    follow(epoch, range(begin), off_m)
    assert epoch.work["satellites_doppler"].tolist() == [N]
    follow(epoch, range(begin, begin + 11), off_m)
    assert epoch.work["by_carriers"].all()
    assert epoch.faults["now"]["state"][0, 3] == dk.IDLE


def test_carriers_without_a_fault_are_excluded_at_the_stated_rate() -> None:
    vehicles, alpha = 4000, RtkReckoningConfig().tests.alpha
    epoch = locked(vehicles)
    begin = first_test(epoch)
    follow(epoch, range(begin + 2), np.zeros((begin + 2, N)), float(epoch.parameters["rtk"]["sigma_phase"][0]))
    alarms = int((epoch.ambiguities["bases"][:, :, 1] == 0.0).any(1).sum())
    # Global and local tests have alpha each, and share most of their alarms; the global one may name no carrier.
    assert binom.ppf(1e-3, vehicles, 0.5 * alpha) < alarms < binom.ppf(1.0 - 1e-3, vehicles, 2.0 * alpha)


@pytest.mark.parametrize(("off_deg", "taken"), [(0.0, True), (2.0, False)])
def test_carriers_that_go_aside_of_gyro_and_odometer_give_no_velocity(off_deg: float, taken: bool) -> None:
    epoch = locked()
    begin = first_test(epoch)
    epoch.vehicles["heading"]["angle"] = math.atan2(3.0, 4.0) + math.radians(off_deg)
    epoch.vehicles["heading"]["p_hh"], epoch.observed["speed"] = math.radians(0.2) ** 2, 5.0
    errors = follow(epoch, range(begin + 12), np.zeros((begin + 12, N)))
    assert epoch.work["by_carriers"][0] == taken
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)


def test_carriers_that_contradict_each_other_leave_the_velocity_to_range_rates() -> None:
    epoch = locked()
    begin = first_test(epoch)
    off_m = 0.5 * np.arange(begin + 2)[:, None] * np.random.default_rng(3).standard_normal(N)
    errors = follow(epoch, range(begin + 2), off_m)
    assert not epoch.work["by_carriers"].any()
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)


def test_heading_follows_the_gyro_the_course_of_doppler_and_is_held_at_rest() -> None:
    epoch = blank(3)
    heading, w = epoch.vehicles["heading"], epoch.work
    epoch.parameters["lever"]["forward"], epoch.parameters["lever"]["axle"] = 2.0, 1.2
    heading["angle"], heading["p_hh"] = [1.0, 0.02, 0.7], 0.05**2
    heading["gyro_bias"][0], heading["gyro_scale"][0] = 0.01, 0.02
    epoch.vehicles["since_calibration"], epoch.vehicles["rest_s"][2] = 2.0, 5.0
    epoch.vehicles["position"][:, :2] = [5.0, 6.0]
    epoch.observed["turn"][0, 2], epoch.observed["speed"] = 0.03, [10.0, 10.0, 0.0]
    w["velocity"][:2], w["q"][1], w["hdop_doppler"][1] = [[3.0, 4.0, 0.0], [0.0, 10.0, 0.0]], 0.01 * np.eye(3), 1.0
    w["solved"][1] = w["checked"][1] = True
    run("heading", epoch)
    rate, turned = 0.03 * 0.98 / DT - 0.01, 0.03 * 0.98 - 0.01 * DT
    slip = math.asin(1.2 * rate / 10.0)
    assert w["turning"][0] == pytest.approx(rate)
    assert heading["angle"][0] == w["reckoned"][0] == pytest.approx(1.0 + turned)
    assert w["middle"][0] == pytest.approx(1.0 + 0.5 * turned + slip)
    assert (w["v_e"][0], w["v_n"][0]) == pytest.approx((3.0 - 2.0 * rate * np.cos(1.0), 4.0 + 2.0 * rate * np.sin(1.0)))
    assert heading["p_hh"][0] > 0.05**2
    gain = 0.05**2 / (0.05**2 + 0.01 / 10.0**2 * epoch.parameters["doppler"]["course"][0])
    assert heading["angle"][1] == pytest.approx(0.02 * (1.0 - gain), rel=1e-3)  # the course is 0
    assert heading["p_hh"][1] < 0.05**2
    assert (heading["angle"][2], w["turned"][2]) == (pytest.approx(0.7), 0.0)
    assert w["resting"].tolist() == [False, False, True]
    assert epoch.vehicles["since_calibration"].tolist() == [2.0, 0.0, 2.0]
    np.testing.assert_allclose(np.hypot(w["sin_h"], w["cos_h"]), 1.0)
    np.testing.assert_allclose(np.arctan2(w["sin_h"], w["cos_h"]), heading["angle"])
    np.testing.assert_array_equal(np.stack([w["before_e"], w["before_n"]], -1), epoch.vehicles["position"][:, :2])


def test_admission_is_for_a_tested_velocity_of_good_geometry_that_agrees_with_the_wheels() -> None:
    epoch = blank(5)
    w = epoch.work
    w["solved"] = w["checked"] = [False, True, True, True, True]
    w["v_e"], w["v_n"], w["v_gnss"], w["hdop_doppler"] = 6.0, 8.0, 10.0, 1.0
    w["sin_h"], w["cos_h"], w["q"] = 0.6, 0.8, 1e-4 * np.eye(3)
    w["hdop_doppler"][2] = 100.0  # of poor geometry
    epoch.observed["speed"] = [10.0, 10.0, 10.0, 20.0, 10.0]  # the wheels contradict in 3
    epoch.vehicles["doubt"]["refuses"][4] = True
    run("admission", epoch)
    assert w["doppler_moves"].tolist() == [False, True, False, False, False]
    assert np.isinf(w["sdop"][0])
    assert w["sdop"][1] == pytest.approx(0.01 / epoch.parameters["doppler"]["sigma"][0])


def test_carriers_that_lost_their_lock_or_slipped_are_released() -> None:
    epoch = blank()
    measure(epoch)
    hold(epoch)
    epoch.vehicles["position"][0] = 3.0, 4.0, 5.0
    epoch.marks["quality"] = quality = np.linspace(1.0, 2.0, N)
    signals, held = epoch.signals[0], epoch.ambiguities["held"][0]
    signals["lock_lost"][2], signals["phase"][4, 1], signals["cn0"][6] = True, 0.0, 10.0
    run("carriers", epoch)
    s = np.arange(N)
    np.testing.assert_array_equal(held, (s != 2) & (s != 4))
    np.testing.assert_array_equal(epoch.marks["phase_ok"][0], s != 4)
    np.testing.assert_array_equal(epoch.marks["used"][0], s != 6)
    np.testing.assert_array_equal(epoch.marks["factor"][0], np.where(s != 6, quality, UNUSED))
    along = signals["phase"] + (E @ [3.0, 4.0, 5.0])[:, None]
    np.testing.assert_allclose(epoch.ambiguities["last_phase"][0], np.where((s != 4)[:, None], along, 0.0))
    signals["phase"][8, 0] += epoch.tables.satellites["wavelength"][8, 0]
    run("carriers", epoch)
    np.testing.assert_array_equal(held, (s != 2) & (s != 4) & (s != 8))
    assert epoch.vehicles["rtk"]["fixes"][0] == 1


def test_floats_of_one_epoch_are_the_ambiguities_and_wait_for_the_next_interval() -> None:
    epoch = blank(positioning={"rtk": {"float_solution": {"kind": "sequential"}}})
    measure(epoch)
    run("floats", epoch)
    row = epoch.vehicles["filter"][0]
    assert (row["added"], row["since_s"], row["age_s"]) == (True, 0.0, 0.5)
    assert epoch.filters is not None
    own = filter_of(epoch.filters, 0)
    assert own is not None
    assert sorted(own.slots["satellite"][own.slots["followed"]].tolist()) == list(range(N))
    carriers = Carriers(epoch.tables.satellites, epoch.signals[0], np.ones(N))
    a, q, owner = np.empty(2 * N), np.empty((2 * N, 2 * N)), np.empty(2 * N, np.int64)
    order, rules = np.arange(N), epoch.parameters[0]["rtk"]
    n = filtered_ambiguities(carriers, order, N, epoch.ambiguities[0], own, rules, a, q, owner)
    reference = INTEGERS[[0, 1]][(SYSTEM[owner[:n]] == System.GALILEO).astype(int)]
    expected = [INTEGERS[s, i % 2] - reference[i, i % 2] for i, s in enumerate(owner[:n])]
    np.testing.assert_allclose(a[:n], expected, atol=1e-4)
    run("floats", epoch)
    assert (row["added"], row["since_s"]) == (False, pytest.approx(DT))


def test_integers_without_noise_are_held_and_none_without_corrections() -> None:
    epoch = blank(2)
    measure(epoch)
    epoch.parameters["rtk"]["sigma_code"], epoch.observed["age"][1] = 0.03, np.inf
    run("integers", epoch)
    fixed = epoch.work["fixed"]
    assert fixed["status"].tolist() == [codes.FIXED, codes.NO_CORRECTIONS]
    assert fixed["searched"].tolist() == [N, 0]
    assert fixed["coded"][0]
    assert abs(fixed["failure"][0]) < 1e-6
    np.testing.assert_allclose(fixed["position"][0], ANTENNA, atol=1e-6)
    assert epoch.ambiguities["held"].tolist() == [N * [True], N * [False]]
    off = epoch.ambiguities["integers"][0] - INTEGERS
    for system in np.unique(SYSTEM):
        assert (np.ptp(off[system == SYSTEM], axis=0) == 0.0).all()


def test_wrong_integers_are_those_of_the_rank_that_the_fault_names() -> None:
    epoch = blank(2)
    measure(epoch)
    hold(epoch)
    epoch.observed["next_best"][0] = 2.0, 0.3
    run("wrong integers", epoch)
    carriers, expected = Carriers(epoch.tables.satellites, epoch.signals[0], np.ones(N)), np.zeros((N, 2), np.int64)
    assert next_best_integers(carriers, rows_of(E, SYSTEM, True), 2, 0.3, epoch.parameters[0]["rtk"], expected)
    assert expected.any()
    np.testing.assert_array_equal(epoch.signals["integer_error"][0], expected)
    assert not epoch.signals["integer_error"][1].any()


def test_fix_is_the_position_of_the_held_phases_without_the_faulty_one() -> None:
    epoch = blank(3)
    measure(epoch)
    hold(epoch)
    epoch.vehicles["since_rtk"] = DT, DT, np.inf
    epoch.signals["phase"][1, 3] += 1.0
    run("fix", epoch)
    fixed, s = epoch.work["fixed"], np.arange(N)
    assert (fixed["status"] == codes.FIXED).all()
    np.testing.assert_allclose(fixed["position"], [ANTENNA] * 3, atol=1e-6)
    assert fixed["satellites"].tolist() == [N, N - 1, N]
    assert fixed["excluded"].tolist() == [0, 1, 0]
    np.testing.assert_array_equal(epoch.ambiguities["held"][1], s != 3)
    for v in range(2):
        unit = covariance(np.ones(N), SYSTEM, s != (3 if v else -1))
        assert fixed["hdop"][v] == pytest.approx(math.sqrt(unit[0, 0] + unit[1, 1]))
    np.testing.assert_allclose(fixed["sigma"] ** 2, np.stack([fixed["p_nn"], fixed["p_ee"]], -1))  # to the North
    assert fixed["usable"].tolist() == [True, True, False]  # the last one is not confirmed yet
    assert epoch.vehicles["fixed_s"].tolist() == [DT] * 3
    assert (epoch.fixed_levels[:2] > 3.0 * fixed["sigma"][:2, None]).all()
    assert (epoch.fixed_levels[:2] < 1.0).all()
    assert not epoch.fixed_levels[2].any()


def test_stay_leaves_vehicles_that_no_mode_moves_where_they_are_without_a_bound() -> None:
    epoch = blank(3)
    epoch.work["mode"][1], epoch.vehicles["initialised"] = codes.DOPPLER, [True, True, False]
    epoch.vehicles["position"] = 5.0
    run("stay", epoch)
    assert epoch.work["mode"].tolist() == [codes.NONE, codes.DOPPLER, codes.NONE]
    assert epoch.vehicles["unbounded"].tolist() == [True, False, False]
    assert (epoch.vehicles["position"] == 5.0).all()
    creep = DT * epoch.parameters["odometer"]["still_speed"][0]
    np.testing.assert_allclose(epoch.vehicles["growth"]["cv_n"], [[creep, creep], [0.0, 0.0], [creep, creep]])


def test_separation_grows_by_the_velocity_or_by_the_heading_that_moved_the_position() -> None:
    epoch = blank(2)
    faults, rules = epoch.faults, epoch.parameters["doppler"][0]
    faults["now"]["state"][:, 4], faults["now"]["d_e"][:, 4], faults["now"]["l_ee"][:, 4] = dk.MONITORED, 0.5, 0.1
    faults["course"]["h"][1, 4], faults["course"]["used"][1, 4] = 0.01, 0.5
    epoch.work["integrates"][0], epoch.work["doppler_moves"][0], epoch.work["run"][1] = True, True, 2.0
    run("separation", epoch)
    for name in ("latest", "backup"):
        mine = faults[name][:, 4]
        np.testing.assert_allclose(mine["d_e"], [DT * 0.5, 2.0 * 0.01])
        assert mine["s_ee"][0] == pytest.approx((1.0 + rules["white"]) * (DT * 0.1) ** 2)
        assert mine["s_ee"][1] == 0.0
        assert (mine["state"] == dk.MONITORED).all()
    np.testing.assert_allclose(faults["last"]["d_e"][:, 4], [0.5, 0.0])
    assert faults["last"]["state"][:, 4].tolist() == [dk.MONITORED, dk.IDLE]
    others = np.delete(faults, 4, axis=1)
    assert not any(others[name]["state"].any() for name in ("last", "latest", "backup"))
    np.testing.assert_allclose(epoch.vehicles["growth"]["apart_s"], [[DT, DT], [0.0, 0.0]])
    assert epoch.vehicles["separated"].all()


def test_odometer_that_doppler_contradicts_for_half_a_second_leaves_no_level() -> None:
    epoch = blank(2)
    epoch.work["solved"], epoch.work["hdop_doppler"], epoch.work["v_gnss"] = True, 1.0, [10.0, 20.0]
    unbounded = []
    for k in range(10):
        epoch.observed["speed"] = 10.0 + 0.01 * (k % 2)
        run("odometer", epoch)
        unbounded.append(epoch.vehicles["unbounded"].tolist())
    assert [both[1] for both in unbounded] == [k >= 5 for k in range(10)]
    assert not any(both[0] for both in unbounded)
    np.testing.assert_allclose(epoch.vehicles["conflict_s"], [0.0, 10 * DT])
    assert np.isinf(epoch.vehicles["backup"]["age"][1])


def test_histories_add_the_paths_by_both_headings_less_that_taken() -> None:
    epoch = blank(2)
    doubt, growth = epoch.vehicles["doubt"], epoch.vehicles["growth"]
    doubt["stage"], doubt["gyro"]["angle"], doubt["course"] = [hd.OPEN, hd.NONE], 0.5, -0.25
    epoch.vehicles["position"][:, 1], epoch.observed["speed"] = 1.0, 10.0
    run("histories", epoch)
    for k in (LATEST, BACKUP):
        found = [growth[name][0, k] for name in ("doppler_e", "doppler_n", "gyro_e", "gyro_n")]
        np.testing.assert_allclose(found, [np.sin(-0.25), np.cos(0.25) - 1.0, np.sin(0.5), np.cos(0.5) - 1.0])
    assert (doubt["step_e"][0], doubt["step_n"][0]) == pytest.approx((np.sin(-0.25), np.cos(0.25) - 1.0))
    assert not any(growth[name][1].any() for name in growth.dtype.names)


def test_reckoned_levels_of_a_known_covariance_are_its_deviations_times_the_factors() -> None:
    epoch = blank(3)
    epoch.vehicles["initialised"], epoch.vehicles["unbounded"][1] = [True, True, False], True
    epoch.vehicles["growth"]["p_ee"], epoch.vehicles["growth"]["p_nn"] = 0.2**2, 0.3**2
    epoch.levels[:] = np.inf
    run("reckoned levels", epoch)
    bias = epoch.parameters["risk"]["reference_bias"][0]
    for case, level in zip(epoch.tables.cases, epoch.levels[0], strict=True):
        assert not case["published"]
        np.testing.assert_allclose(level, case["k_dead"] * [0.3, 0.2] + bias, rtol=1e-12)
    assert np.isinf(epoch.levels[1:]).all()


def test_drift_of_rtk_against_gyro_and_odometer_is_found_and_a_sound_drive_is_not() -> None:
    epoch = blank(2, positioning={"rtk": {"drift": {"window_s": 16.0}}})
    fixed, jump = epoch.work["fixed"], epoch.vehicles["jump"]
    fixed["usable"] = fixed["lasting"] = True
    fixed["p_ee"] = fixed["p_nn"] = 1e-4
    epoch.observed["speed"], epoch.vehicles["heading"]["p_hh"] = 10.0, 1e-6
    noise, found = np.random.default_rng(3), np.zeros(2, np.bool_)
    for k in range(400):
        off = max(0.0, 0.3 * DT * (k - 200))
        fixed["position"][:, 0] = [0.0, off] + 0.01 * noise.standard_normal(2)
        fixed["position"][:, 1] = 10.0 * DT * k + 0.01 * noise.standard_normal(2)
        run("drift", epoch)
        found |= jump["drifts"]
        assert k > 200 or not found.any()
        if found[1]:
            break
    assert found.tolist() == [False, True]
    assert off < 3.0
    assert 0.0 < jump["drift_e"][1] <= off + 0.1
    assert abs(jump["drift_n"][1]) < 0.1


def test_jump_accepts_a_position_within_the_levels_and_releases_the_integers_of_one_beyond() -> None:
    epoch = blank(3)
    hold(epoch)
    epoch.levels[:], epoch.fixed_levels[:] = 1.0, 0.1
    epoch.vehicles["initialised"], epoch.vehicles["fixed_s"] = True, 5.0
    epoch.work["fixed"]["usable"] = [True, True, False]
    epoch.work["fixed"]["position"][:, 1] = [1.0, 1.2, 0.0]
    run("jump", epoch)
    assert epoch.work["accepted"].tolist() == [True, False, False]
    assert epoch.work["fixed"]["status"].tolist() == [codes.FIXED, codes.FAULT, codes.FIXED]
    assert epoch.ambiguities["held"].all(1).tolist() == [True, False, True]
    assert epoch.vehicles["fixed_s"].tolist() == [5.0, 0.0, 5.0]
    assert epoch.vehicles["jump"]["stage"].tolist() == [jk.TRUSTED, jk.RETURNED, jk.TRUSTED]
    assert epoch.vehicles["jump"]["d_n"][1] == pytest.approx(1.2)


def test_heading_doubt_ends_by_the_history_whose_path_rtk_shows() -> None:
    """The other history is 2 m East of the path taken; RTK moves there with vehicle 0, and not with vehicle 1."""
    epoch = blank(3)
    doubt, heading = epoch.vehicles["doubt"], epoch.vehicles["heading"]
    doubt["stage"], doubt["gyro"]["angle"], doubt["step_e"], heading["angle"] = hd.FOLLOWS, 0.5, 2.0, 0.1
    epoch.work["accepted"] = [True, True, False]
    run("heading doubt", epoch)
    assert doubt["seen"].tolist() == [True, True, False]
    assert (doubt["stage"] == hd.FOLLOWS).all()
    epoch.work["fixed"]["position"][0, 0] = 2.0
    run("heading doubt", epoch)
    assert doubt["stage"].tolist() == [hd.NONE, hd.NONE, hd.FOLLOWS]
    assert heading["angle"].tolist() == [0.5, 0.1, 0.1]


def test_take_replaces_the_position_and_restarts_dead_reckoning_with_what_its_level_promised() -> None:
    epoch = blank(2)
    epoch.parameters["lever"]["forward"], epoch.parameters["lever"]["right"] = 2.0, 0.5
    vehicle, fixed, w = epoch.vehicles, epoch.work["fixed"], epoch.work
    w["accepted"], w["mode"] = [True, False], codes.IMU_ODOMETER
    vehicle["unbounded"], vehicle["since_rtk"], vehicle["heading"]["angle"] = True, 9.0, 0.25
    vehicle["growth"]["p_ee"], epoch.observed["speed"] = 7.0, 8.0
    fixed["position"], fixed["p_ee"], fixed["p_nn"], fixed["sigma"] = ANTENNA, 0.02**2, 0.01**2, [0.01, 0.02]
    epoch.fixed_levels[:] = [0.5, 0.8]
    run("take", epoch)
    np.testing.assert_allclose(vehicle["position"], [[11.5, -9.0, 1.5], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(vehicle["backup"]["position"], vehicle["position"][:, :2])
    assert w["mode"].tolist() == [codes.RTK, codes.IMU_ODOMETER]
    assert vehicle["since_rtk"].tolist() == [0.0, 9.0]
    assert vehicle["initialised"].tolist() == [True, False]
    assert vehicle["unbounded"].tolist() == [False, True]
    np.testing.assert_array_equal(vehicle["growth"]["p_ee"], [[0.02**2] * 2, [7.0] * 2])
    np.testing.assert_array_equal(epoch.levels[0], epoch.fixed_levels[0])
    bias = epoch.parameters["risk"]["reference_bias"][0]
    for case, start in zip(epoch.tables.cases, epoch.starts[0, LATEST], strict=True):
        k = case["k_dead"]
        assert (start["whole_first"], start["whole_second"]) == pytest.approx((0.8 - bias, 0.5 - bias))  # East, North
        left = max(0.8 - bias - 0.02 * k[1], 0.0), max(0.5 - bias - 0.01 * k[0], 0.0)
        assert (start["bias_first"], start["bias_second"]) == pytest.approx(left)
    np.testing.assert_array_equal(epoch.starts[0, BACKUP], epoch.starts[0, LATEST])
    np.testing.assert_allclose(vehicle["velocity"][1], [8.0 * np.sin(0.25), 8.0 * np.cos(0.25)])


def test_widen_adds_what_rtk_contradicts_to_the_levels() -> None:
    epoch = blank(2)
    jump = epoch.vehicles["jump"]
    jump["stage"], jump["d_e"], jump["d_n"], jump["drift_n"] = [jk.JUMPED, jk.TRUSTED], 3.0, -4.0, 0.5
    epoch.levels[:], epoch.fixed_levels[:] = 1.0, 0.25
    run("widen", epoch)
    np.testing.assert_allclose(
        epoch.levels[0], np.tile([1.0 + 4.0 + 0.5 + 0.25, 1.0 + 3.0 + 0.25], (len(epoch.levels[0]), 1))
    )
    assert (epoch.levels[1] == 1.0).all()


def test_report_tells_position_covariance_and_alert_and_never_a_position_that_is_not_finite() -> None:
    epoch = blank(3)
    vehicle, out, fixed = epoch.vehicles, epoch.out, epoch.work["fixed"]
    vehicle["initialised"], vehicle["alert"]["onset_s"] = [True, False, True], -1.0
    vehicle["position"][:, :2], vehicle["velocity"], vehicle["heading"]["angle"] = [3.0, 4.0], [1.0, 2.0], 0.1
    vehicle["position"][2, 0] = np.nan
    vehicle["growth"]["p_ee"], vehicle["growth"]["p_nn"], vehicle["heading"]["p_hh"] = 0.04, 0.09, 0.01**2
    epoch.parameters["lever"]["forward"] = 2.0
    epoch.work["mode"], fixed["sigma"], fixed["hdop"], epoch.levels[:] = codes.RTK, [0.01, 0.02], 1.5, 0.3
    run("report", epoch)
    assert out["position"].tolist() == [[3.0, 4.0], [3.0, 4.0], [0.0, 4.0]]
    assert out["velocity"].tolist() == [[1.0, 2.0]] * 3
    np.testing.assert_allclose(out["covariance"][0], np.diag([0.04 + (2.0 * 0.01) ** 2, 0.09]))
    assert (out["sigma_at"][0], out["sigma_ct"][0]) == pytest.approx((0.01, np.hypot(0.02, 2.0 * 0.01)))
    assert (out["mode"] == codes.RTK).all()
    assert (out["hdop"] == 1.5).all()
    assert out["available"].tolist() == [True, False, False]
    reasons = AlertReason.NONE, AlertReason.INITIALISING, AlertReason.NO_SOLUTION
    assert out["reason"].tolist() == [reason.code for reason in reasons]
    assert np.isinf(epoch.levels[2]).all()
    assert vehicle["unbounded"].tolist() == [False, False, True]


# The modes, and the table


def test_doppler_moves_by_the_mean_of_two_velocities_and_leaves_others_alone() -> None:
    epoch = blank(3)
    epoch.parameters["modes"]["doppler_if_tighter"] = False
    vehicle, w = epoch.vehicles, epoch.work
    vehicle["initialised"], vehicle["velocity"], vehicle["has_velocity"] = True, [1.0, 2.0], [True, False, False]
    w["doppler_moves"], w["v_e"], w["v_n"], w["q"] = [True, True, False], 3.0, 4.0, 0.01 * np.eye(3)
    w["step"]["dt_s"] = DT
    advance_doppler(0, 3, epoch)
    moved = [[0.5 * DT * 4.0, 0.5 * DT * 6.0], [DT * 3.0, DT * 4.0], [0.0, 0.0]]
    np.testing.assert_allclose(vehicle["position"][:, :2], moved)
    np.testing.assert_allclose(vehicle["backup"]["position"], moved)
    assert w["mode"].tolist() == [codes.DOPPLER, codes.DOPPLER, codes.UNDECIDED]
    assert w["integrates"].tolist() == [True, True, False]
    np.testing.assert_allclose(vehicle["growth"]["p_ee"][1:], [[(DT * 0.1) ** 2] * 2, [0.0] * 2])  # white noise


def test_carriers_move_the_position_and_gyro_and_odometer_the_backup_solution() -> None:
    """Carriers drift with RTK: a backup solution that they move would never contradict it."""
    epoch = blank(1)
    vehicle, w = epoch.vehicles, epoch.work
    vehicle["initialised"], w["doppler_moves"], w["by_carriers"] = True, True, True
    w["mean_e"], w["mean_n"], w["middle"], epoch.observed["speed"] = 3.0, 4.0, 0.3, 10.0
    w["q"], w["step"]["dt_s"] = 0.01 * np.eye(3), DT
    advance_doppler(0, 1, epoch)
    np.testing.assert_allclose(vehicle["position"][:, :2], [[3.0 * DT, 4.0 * DT]])
    np.testing.assert_allclose(vehicle["backup"]["position"], 10.0 * DT * np.array([[np.sin(0.3), np.cos(0.3)]]))
    assert (w["run"], w["backup_run"]) == ([0.0], [10.0 * DT])
    latest, backup = vehicle["growth"][0]
    assert latest["p_ee"] == pytest.approx((DT * 0.1) ** 2)
    assert (latest["run_n"], backup["run_n"]) == (0.0, pytest.approx(10.0 * DT * np.cos(0.3)))


def test_imu_and_odometer_move_along_the_middle_course() -> None:
    epoch = blank(2)
    vehicle, w = epoch.vehicles, epoch.work
    vehicle["initialised"], w["middle"], epoch.observed["speed"] = [True, False], 0.3, 10.0
    advance_imu_odometer(0, 2, epoch)
    np.testing.assert_allclose(vehicle["position"][:, :2], [[np.sin(0.3), np.cos(0.3)], [0.0, 0.0]])
    assert w["run"].tolist() == [10.0 * DT, 0.0]
    assert w["mode"].tolist() == [codes.IMU_ODOMETER, codes.UNDECIDED]


def test_every_stage_of_the_table_has_a_test_of_its_own() -> None:
    names = [part.name for part in STAGES if isinstance(part, Listed)]
    assert len(set(names)) == len(names)
    assert set(names) >= NOT_PLAIN
    tests = [name for name in globals() if name.startswith("test_")]
    assert all(any(test.startswith(f"test_{name.replace(' ', '_')}_") for test in tests) for name in names)


def test_the_points_stand_in_the_table_in_their_order_once_each() -> None:
    assert [part for part in STAGES if isinstance(part, Point)] == list(Point)
    assert [part for part in STAGES if isinstance(part, str)] == [MODES]


class Staged:
    """The stages of the table without what is not plain, one after another."""

    def __init__(self) -> None:
        self.stages: list[Any] = []
        for part in STAGES:
            if part == MODES:
                self.stages += [advance_doppler, advance_imu_odometer]
            elif isinstance(part, Listed) and part.name not in NOT_PLAIN:
                self.stages.append(part.stage)

    def for_epoch(self, observed: Records) -> EpochCall:
        return EpochCall(self.stages)


def test_locate_runs_the_stages_of_the_table_in_its_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every solution and all that lasts, bit by bit: RTK, its loss with the corrections, a frozen odometer, a turn."""
    config, batch = NavigatorConfig.load({"positioning": {"rtk": {"max_age_s": 2.0}}}), 3
    faults = FaultSchedule((
        Fault.load({"kind": "corrections_loss", "start_s": 5.0, "duration_s": 4.0}),
        Fault.load({"kind": "odometer_frozen", "start_s": 8.0, "duration_s": 3.0, "vehicle": 1}),
    ))  # fmt: skip
    one, other = (
        Navigator(config, SkyTrack.from_config(config.sky, 30.0), SkyMask.open(), 3, batch, faults) for _ in range(2)
    )
    assert one._stages.for_epoch(blank().observed).stages == [locate]
    monkeypatch.setattr(other, "_stages", Staged())
    place, modes = np.zeros((batch, 2)), set()
    for k in range(120):
        heading = np.full(batch, 0.02 * max(k - 60, 0))
        velocity = 10.0 * np.stack([np.sin(heading), np.cos(heading)], -1)
        before, place = place, place + DT * velocity
        truth = truth_between(DT * (k + 1), DT, (before, place), (velocity, velocity), (heading, heading))
        m = one.measure(truth)
        found, expected = one.locate(m), other.locate(m)
        modes |= set(found.mode.tolist())
        for name, value in vars(found).items():
            mine, theirs = np.asarray(value), np.asarray(getattr(expected, name))
            assert mine.dtype == theirs.dtype
            assert mine.tobytes() == theirs.tobytes() or mine.dtype == object, (k, name)
    for mine, theirs in zip(arrays_of(one.state.belief), arrays_of(other.state.belief), strict=True):
        assert same(mine, theirs)
    assert modes >= {codes.RTK, codes.DOPPLER}


def same(one: Records, other: Records) -> bool:
    """Whether two arrays are equal bit by bit, field by field."""
    if one.dtype.names is None:
        return one.tobytes() == other.tobytes()
    return all(same(one[name], other[name]) for name in one.dtype.names)
