"""Levels in a tunnel after turns: the gyro's scale, the wander of its bias, and a wrong axle distance.

Every test drives vehicles with draws of their own and counts those beyond a level of 1e-3 at some times. By chance a
test fails once in 1000 runs if the level is exceeded exactly as often as its risk allows.
"""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from tests.helpers.tunnel_drives import Drive, allowed, drive, pieces, turning, with_risk, yaw_rates

OPEN_S, VEHICLES, RISK = 40.0, 600, 1e-3
U_TURN = pieces((0.0, 5.0), turning(0.5, np.pi))
ROUNDABOUT = pieces((0.0, 5.0), turning(0.4, -0.8), turning(0.5, np.pi + 1.6), turning(0.4, -0.8))
CIRCLES = pieces((0.0, 5.0), turning(0.5, 4.0 * np.pi))
THERE_AND_BACK = pieces((0.0, 5.0), turning(0.5, np.pi), turning(0.5, -np.pi))
MANOEUVRES = {"u_turn": U_TURN, "roundabout": ROUNDABOUT, "circles": CIRCLES, "there_and_back": THERE_AND_BACK}


@pytest.mark.parametrize(
    "name",
    ["u_turn", "circles", *(pytest.param(name, marks=pytest.mark.slow) for name in ("roundabout", "there_and_back"))],
)
def test_levels_hold_after_turns_without_satellites(name: str) -> None:
    rates = yaw_rates((0.0, OPEN_S), *MANOEUVRES[name], (0.0, 20.0))
    end = len(rates) * 0.1
    run = drive(with_risk(NavigatorConfig(), RISK), rates, OPEN_S, VEHICLES, from_s=OPEN_S)
    assert (run.mode[-1] == Mode.IMU_ODOMETER).all()
    times = (end - 20.0, end - 10.0, end)
    beyond = [run.exceeding(1, time_s) for time_s in times]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=len(times)), beyond


def test_without_a_declared_scale_the_same_levels_break() -> None:
    config = with_risk(NavigatorConfig(), RISK).replace(positioning={"heading": {"gyro_scale": 0.0}})
    rates = yaw_rates((0.0, OPEN_S), *CIRCLES, (0.0, 20.0))
    run = drive(config, rates, OPEN_S, VEHICLES, from_s=OPEN_S)
    assert run.exceeding(1, len(rates) * 0.1) > allowed(VEHICLES, RISK)


@pytest.mark.parametrize("tau_s", [pytest.param(100.0, marks=pytest.mark.slow), 1000.0])
def test_levels_hold_while_the_bias_wanders(tau_s: float) -> None:
    config = with_risk(NavigatorConfig(), RISK).replace(imu={"gyro": {"instability_s": tau_s}})
    rates = yaw_rates((0.0, OPEN_S), (0.0, 60.0))
    run = drive(config, rates, OPEN_S, VEHICLES, from_s=OPEN_S)
    beyond = [run.exceeding(1, OPEN_S + after) for after in (20.0, 60.0)]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=2), beyond


KNOWN = {"tau_range_s": (0.54, 0.54)}  # the true correlation time, for levels without slack
WEAVE = [(0.2, 5.0), (-0.2, 5.0)] * 3


@pytest.mark.parametrize("wrong_m", [0.5, pytest.param(-0.5, marks=pytest.mark.slow)])
def test_a_bound_of_the_axle_distance_bounds_a_wrong_one_in_turns(wrong_m: float) -> None:
    declared = {"axle_m": 2.5, "axle_bound_m": 0.5, "doppler": KNOWN}
    config = with_risk(NavigatorConfig(), RISK).replace(positioning=declared)
    rates = yaw_rates((0.0, 10.0), *WEAVE, (0.25, 6.0), (0.25, 6.0), *U_TURN, (0.0, 10.0))
    open_s, end = 46.0, len(rates) * 0.1
    run = drive(config, rates, open_s, VEHICLES, axle_m=2.5 + wrong_m, from_s=30.0)
    times = (45.0, 49.0, end - 10.0, end)
    beyond = [run.exceeding(1, time_s) for time_s in times]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=len(times)), beyond


def test_without_that_bound_the_level_across_breaks() -> None:
    config = with_risk(NavigatorConfig(), RISK).replace(
        positioning={"axle_m": 2.5, "axle_bound_m": 0.0, "doppler": KNOWN}
    )
    rates = yaw_rates((0.0, 10.0), *WEAVE, (0.25, 12.0), (0.0, 4.0))
    run = drive(config, rates, 52.0, VEHICLES, axle_m=3.0, from_s=50.0)
    assert run.exceeding(1, len(rates) * 0.1) > allowed(VEHICLES, RISK)


FULL_LOCK = 0.55  # sine of the side slip of a car of 5 m whose wheels are turned by 53 degrees
BRAKING_S = 4.0


def _creeping(mps: float, length_s: float, lock: float) -> Drive:
    """Brake in a tunnel and creep on, with the wheels turned."""
    config = with_risk(NavigatorConfig(), RISK).replace(positioning={"axle_m": 2.5})
    rates = yaw_rates((0.0, OPEN_S + BRAKING_S), (lock * abs(mps) / 2.5, length_s))
    braking = np.linspace(8.0, mps, round(10.0 * BRAKING_S))
    speeds = np.concatenate([np.full(round(10.0 * OPEN_S), 8.0), braking, np.full(round(10.0 * length_s), mps)])
    return drive(config, rates, OPEN_S, VEHICLES, axle_m=2.5, from_s=OPEN_S, speed_mps=speeds)


@pytest.mark.parametrize("mps", [-0.45, *(pytest.param(mps, marks=pytest.mark.slow) for mps in (0.45, 0.25))])
def test_levels_hold_for_one_that_creeps_at_full_lock(mps: float) -> None:
    """Its middle, 2.5 m ahead of the rear axle, moves sideways more than half as fast as forward."""
    run = _creeping(mps, 12.0, FULL_LOCK)
    times = tuple(OPEN_S + BRAKING_S + after for after in (3.0, 6.0, 12.0))
    assert np.isfinite(run.levels_m[-1]).mean() > 0.9
    beyond = [run.exceeding(1, time_s) for time_s in times]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=len(times)), beyond


@pytest.mark.slow
def test_levels_hold_for_one_that_creeps_straight() -> None:
    """An error of the yaw rate then moves the middle sideways as well."""
    run = _creeping(0.25, 30.0, 0.0)
    assert np.isfinite(run.levels_m[-1]).mean() > 0.9
    beyond = [run.exceeding(1, OPEN_S + BRAKING_S + after) for after in (10.0, 30.0)]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=2), beyond
