"""Recorded drives as epochs of the monitor family: a drive made up, and the recorded one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from city_drives import SIGMA_M, simulated
from recordings import real

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.recorded.smartloc import SmartLoc, read_smartloc
from lanebound.integrity.replay.code_epochs import recorded_epochs
from lanebound.integrity.sky.orbit import ranges_and_sights


def quiet(drive: SmartLoc) -> SmartLoc:
    """The drive without noise."""
    r, truth = drive.ranges, drive.truth
    assert truth is not None
    place, _ = truth.at(r.time_s)
    distance, _ = ranges_and_sights(r.satellite_ecef_m, place)
    return replace(drive, ranges=replace(r, range_m=distance + 77.0 + 25.0 * (r.system == "R")))


def test_codes_without_noise_give_the_true_positions_anywhere_on_the_drive() -> None:
    found = recorded_epochs(quiet(simulated(60.0)))
    fit = solve_codes(found.epochs)
    assert np.abs(fit.x_m - found.truth_enu_m).max() < 1e-4  # linearised at a position near the solution
    assert np.abs(fit.residual_m).max() < 1e-4
    assert found.known.all()
    assert np.ptp(found.truth_enu_m[:, 0]) > 100.0


def test_deviations_strengths_and_systems_are_those_of_the_recording() -> None:
    found = recorded_epochs(simulated())
    e = found.epochs
    assert e.y_m.shape == (120, 10)
    assert e.used.all()
    assert (e.sigma_m == SIGMA_M).all()
    assert (e.cn0_dbhz == 45.0).all()
    assert (np.bincount(e.system) == [6, 4]).all()


def test_steps_follow_wheels_gyro_and_the_heading_of_past_positions() -> None:
    found = recorded_epochs(simulated(40.0))
    e, moved = found.epochs, np.diff(found.truth_enu_m[:, :2], axis=0)
    assert e.step_enu_m is not None
    assert e.step_sigma_m is not None
    assert np.isinf(e.step_sigma_m[0])
    off = np.hypot(*(e.step_enu_m[1:, :2] - moved).T)
    late = slice(100, None)
    assert off[late].max() < 0.2
    assert (off[late] <= 4.0 * e.step_sigma_m[1:][late]).mean() > 0.95


def test_a_step_does_not_depend_on_later_positions() -> None:
    drive = simulated(20.0)
    r = drive.ranges
    cut = replace(drive, ranges=replace(r, **{k: v[r.time_s <= 10.0] for k, v in vars(r).items()}))
    whole, part = recorded_epochs(drive).epochs, recorded_epochs(cut).epochs
    assert whole.step_enu_m is not None
    assert part.step_enu_m is not None
    np.testing.assert_allclose(whole.step_enu_m[: part.count], part.step_enu_m, atol=1e-9)


def test_a_drive_without_a_fix_is_refused() -> None:
    drive = simulated(2.0)
    r = drive.ranges
    few = replace(drive, ranges=replace(r, **{k: v[r.satellite <= 3] for k, v in vars(r).items()}))
    with pytest.raises(InputError, match="more codes than unknowns"):
        recorded_epochs(few)


def test_the_recorded_drive_through_berlin() -> None:
    folder = real("smartloc_berlin_potsdamer")
    drive = read_smartloc(folder / "Berlin_Potsdamer_Platz_Input.txt.gz", folder / "Berlin_Potsdamer_Platz_GT.txt")
    found = recorded_epochs(drive)
    assert found.epochs.count > 700
    error = {}
    for name in ("residual", "ibpl", "kipl"):
        v = watch(found.epochs, monitor_named(name).config(), 1e-3)
        away = np.hypot(*(v.position_enu_m - found.truth_enu_m)[:, :2].T)
        error[name] = (away[v.usable & found.known] > v.hpl_m[v.usable & found.known, 0]).mean()
    assert error["ibpl"] <= 1e-3  # the methods without a fault model hold in the city
    assert error["kipl"] <= 1e-3
    assert error["residual"] > 0.01  # the classic one does not: several codes are reflected at once


@pytest.mark.parametrize("late_s", [18.0, -14.0])
def test_codes_whose_times_are_off_are_refused(late_s: float) -> None:
    drive = simulated(60.0)
    late = replace(drive, ranges=replace(drive.ranges, time_s=drive.ranges.time_s + late_s))
    with pytest.raises(InputError, match=rf"times of pseudorange3 .* must agree .* with times \{-late_s:+.1f} s later"):
        recorded_epochs(late)
