"""Velocity from changes of carriers: without RTK its levels are far smaller than those of range rates, and hold."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from tests.helpers.tunnel_drives import Drive, drive, pieces, turning, yaw_rates

LOSS = Fault(kind="corrections_loss", start_s=20.0, duration_s=60.0)
FROM_S, VEHICLES = 25.0, 12


@cache
def without_rtk(carriers: bool, axle_m: float = 0.0) -> Drive:
    """Corrections end after 20 s and RTK 3 s later; a stop, a start and a turn follow."""
    config = NavigatorConfig.load(
        {
            "positioning": {"doppler": {"carriers": carriers}, "rtk": {"max_age_s": 3.0}, "axle_m": axle_m},
        }
    )
    rates = yaw_rates(*pieces((0.0, 38.0), turning(0.3, 0.5 * np.pi), (0.0, 9.0)))
    time = np.arange(len(rates)) * 0.1
    speeds = np.interp(time, [0.0, 27.0, 31.0, 32.0, 36.0, 60.0], [12.0, 12.0, 4.0, 4.0, 12.0, 12.0])
    faults = FaultSchedule((LOSS,))
    return drive(config, rates, 1000.0, VEHICLES, axle_m, FROM_S, faults, speed_mps=speeds)


@pytest.mark.parametrize("axle_m", [0.0, 1.4])
def test_levels_are_far_smaller_and_hold(axle_m: float) -> None:
    found, before = without_rtk(True, axle_m), without_rtk(False, axle_m)
    assert (found.mode == Mode.DOPPLER).mean() > 0.99
    assert (found.error_m <= found.levels_m[:, :, 0]).all()
    assert (np.median(found.levels_m[-1, :, 0], 0) < 0.3 * np.median(before.levels_m[-1, :, 0], 0)).all()
    assert np.median(found.error_m[-1]) < 0.3 * np.median(before.error_m[-1])


def test_the_heading_at_the_end_of_a_turn_is_not_that_of_its_middle() -> None:
    found = without_rtk(True)
    turn = (found.time_s > 40.0) & (found.time_s < 43.0)
    assert np.abs(np.median(found.heading_error_rad[turn])) < 0.3 * 0.5 * 0.3 * 0.1  # of half an epoch's turn


def test_levels_without_satellites_are_as_wide_as_by_range_rates() -> None:
    """The heading is calibrated no better by carriers: no level has a hypothesis of a gyro that fails there."""
    rates, median = np.zeros(320), []
    for carriers in (False, True):
        config = NavigatorConfig.load({"positioning": {"doppler": {"carriers": carriers}}})
        found = drive(config, rates, 25.0, VEHICLES, from_s=31.0)
        assert (found.mode == Mode.IMU_ODOMETER).all()
        assert (found.error_m <= found.levels_m[:, :, 0]).all()
        median.append(np.median(found.levels_m[-1, :, 0], 0))
    assert median[1] == pytest.approx(median[0], rel=0.1)
