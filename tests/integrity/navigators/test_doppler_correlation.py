"""Levels bridged by Doppler, and in a tunnel after it, for Doppler errors of any correlation time in the declared
range.

By chance a test fails once in 1000 runs if a level is exceeded exactly as often as its risk allows.
"""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from tests.helpers.tunnel_drives import Drive, allowed, drive, with_risk, yaw_rates

VEHICLES, RISK = 600, 1e-3
FIXED_S, DOPPLER_S, TUNNEL_S = 20.0, 30.0, 20.0
CALIBRATED_S = FIXED_S + DOPPLER_S
ENDS = ((False, 0.1), (True, 2.0), (False, 10.0))  # both ends and the middle of the range; the others are slow tests
NO_LINK = FaultSchedule((Fault(kind="corrections_loss", start_s=FIXED_S, duration_s=200.0),))
TIMES_S = tuple(FIXED_S + after for after in (12.0, 20.0, 29.5, 40.0, 50.0))


def _run(true_tau_s: float, declared_s: tuple[float, float], turning: bool = False) -> Drive:
    config = with_risk(NavigatorConfig(), RISK).replace(
        gnss={"range_rate_tau_s": true_tau_s, "range_rate_sigma_mps": 0.10},
        positioning={"doppler": {"tau_range_s": declared_s}, "rtk": {"max_age_s": 3.0}},
    )
    rate = 2.0 * np.pi / 20.0 if turning else 0.0
    rates = yaw_rates((0.0, FIXED_S), (rate, DOPPLER_S), (0.0, TUNNEL_S))
    return drive(config, rates, CALIBRATED_S, VEHICLES, from_s=FIXED_S, faults=NO_LINK)


CASES = [
    pytest.param(turning, tau_s, marks=() if (turning, tau_s) in ENDS else pytest.mark.slow)
    for turning in (False, True)
    for tau_s in (0.1, 0.5, 2.0, 5.0, 10.0)
]


@pytest.mark.parametrize(("turning", "tau_s"), CASES)
def test_levels_hold_for_every_correlation_time_declared(turning: bool, tau_s: float) -> None:
    run = _run(tau_s, (0.1, 10.0), turning)
    assert (run.mode[run.time_s > CALIBRATED_S + 1.0] == Mode.IMU_ODOMETER).all()
    assert (run.mode[(run.time_s > FIXED_S + 12.0) & (run.time_s < CALIBRATED_S - 1.0)] == Mode.DOPPLER).mean() > 0.9
    beyond = [run.exceeding(1, time_s) for time_s in TIMES_S]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=len(TIMES_S)), beyond


DEFAULT_S = NavigatorConfig().positioning.doppler.tau_range_s
DEFAULT_CASES = [
    pytest.param(turning, tau_s, marks=() if (turning, tau_s) == (False, 2.0) else pytest.mark.slow)
    for turning in (False, True)
    for tau_s in (0.1, 0.5, 2.0)
]


@pytest.mark.parametrize(("turning", "tau_s"), DEFAULT_CASES)
def test_default_levels_hold_for_every_correlation_time_of_their_range(turning: bool, tau_s: float) -> None:
    assert DEFAULT_S[0] <= tau_s <= DEFAULT_S[1]
    run = _run(tau_s, DEFAULT_S, turning)
    beyond = [run.exceeding(1, time_s) for time_s in TIMES_S]
    assert max(beyond) <= allowed(VEHICLES, RISK, times=len(TIMES_S)), beyond


def test_a_time_beyond_the_declared_range_breaks_the_levels() -> None:
    run = _run(10.0, (0.54, 0.54))
    assert max(run.exceeding(1, time_s) for time_s in TIMES_S) > allowed(VEHICLES, RISK)
