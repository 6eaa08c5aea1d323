"""A slow fault of a system or of a satellite turns the heading that Doppler calibrates; the levels in a tunnel hold."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from lanebound.integrity.sky.systems import System
from tests.helpers.tunnel_drives import allowed, drive, yaw_rates

OPEN_S, TUNNEL_S, VEHICLES = 60.0, 30.0, 300
SHARP = NavigatorConfig().replace(positioning={"doppler": {"tau_range_s": [0.54, 0.54]}})  # a bound without slack
MISSED = 2e-3  # of a fault that is there: a quarter of the risk of an axis, over the priors of all single faults


def _drift(system: System, mps: float, prn: int | None = None) -> FaultSchedule:
    """Range rates off by ``mps``, across the track where a whole system fails, for the last 40 s of the open sky."""
    kind = "constellation" if prn is None else "satellite_range"
    fault = Fault(
        kind=kind, system=system, prn=prn, start_s=OPEN_S - 40.0, duration_s=100.0, profile="ramp", ramp_s=100.0,
        magnitude_m=100.0 * mps, azimuth_deg=90.0,
    )  # fmt: skip
    return FaultSchedule((fault,))


DRIFTS = [(System.GALILEO, 0.4)]
DRIFTS += [
    pytest.param(system, mps, marks=pytest.mark.slow)
    for system in (System.GALILEO, System.GPS, System.BEIDOU)
    for mps in (0.4, 0.15)
    if (system, mps) not in DRIFTS
]


@pytest.mark.parametrize(("system", "mps"), DRIFTS)
def test_levels_bound_a_drift_of_a_constellation_before_a_tunnel(system: System, mps: float) -> None:
    rates = yaw_rates((0.0, OPEN_S + TUNNEL_S))
    run = drive(SHARP, rates, OPEN_S, VEHICLES, from_s=OPEN_S, faults=_drift(system, mps))
    times = (OPEN_S + 5.0, OPEN_S + TUNNEL_S)
    beyond = [run.exceeding(0, time_s) for time_s in times]
    assert max(beyond) <= allowed(VEHICLES, MISSED, times=len(times)), beyond


def test_that_drift_turns_the_heading() -> None:
    """Far beyond its own standard deviation: the test above can fail."""
    rates, off = yaw_rates((0.0, OPEN_S + 1.0)), []
    for faults in (_drift(System.GALILEO, 0.4), None):
        run = drive(SHARP, rates, OPEN_S, VEHICLES, from_s=OPEN_S, faults=faults)
        off.append(run.heading_error_rad[-1])
    assert abs(np.median(off[0]) - np.median(off[1])) > 2.0 * np.std(off[1])


@pytest.mark.parametrize("prn", [3, *(pytest.param(prn, marks=pytest.mark.slow) for prn in (11, 19))])
def test_levels_bound_a_drift_of_a_satellite_before_a_tunnel(prn: int) -> None:
    rates = yaw_rates((0.0, OPEN_S + TUNNEL_S))
    run = drive(SHARP, rates, OPEN_S, VEHICLES, from_s=OPEN_S, faults=_drift(System.GALILEO, 0.4, prn))
    assert run.exceeding(0, OPEN_S + TUNNEL_S) <= allowed(VEHICLES, MISSED)
