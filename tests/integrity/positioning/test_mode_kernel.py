import math

import numpy as np
import pytest

from lanebound.integrity.positioning.mode_kernel import DOPPLER, IMU_ODOMETER, NONE, RTK, bridge_mode, rtk_usable
from lanebound.integrity.positioning.modes import Mode

LIMITS = np.array([3.0, 0.5, 1.5, 60.0])  # S1 table 1; 60 s from S1 section 5
BRIDGED = {
    "doppler_solved": True,
    "v_gnss": 10.0,
    "v_ss": 10.0,
    "hdop_doppler": 1.0,
    "outage_s": 1.0,
    "initialised": True,
}


def _mode(**changes):
    return bridge_mode(*(BRIDGED | changes).values(), LIMITS)


def test_numbers_are_those_of_the_enumeration():
    assert (NONE, RTK, DOPPLER, IMU_ODOMETER) == (Mode.NONE, Mode.RTK, Mode.DOPPLER, Mode.IMU_ODOMETER)


def test_rtk_needs_its_geometry():
    assert rtk_usable(2.999, LIMITS)
    assert not rtk_usable(3.0, LIMITS)


def test_order_of_preference():
    assert _mode() == DOPPLER
    assert _mode(doppler_solved=False) == IMU_ODOMETER


@pytest.mark.parametrize(
    ("changes", "inside", "outside", "holds", "otherwise"),
    [
        ({}, ("v_gnss", 10.499), ("v_gnss", 10.5), DOPPLER, IMU_ODOMETER),
        ({}, ("v_gnss", 9.501), ("v_gnss", 9.5), DOPPLER, IMU_ODOMETER),
        ({"v_ss": -10.0}, ("v_gnss", 10.499), ("v_gnss", 10.5), DOPPLER, IMU_ODOMETER),
        ({}, ("hdop_doppler", 1.499), ("hdop_doppler", 1.5), DOPPLER, IMU_ODOMETER),
        ({}, ("outage_s", 60.0), ("outage_s", 60.001), DOPPLER, IMU_ODOMETER),
    ],
)
def test_each_limit_on_both_sides(changes, inside, outside, holds, otherwise):
    assert _mode(**changes, **dict([inside])) == holds
    assert _mode(**changes, **dict([outside])) == otherwise


@pytest.mark.parametrize("doppler_solved", [False, True])
def test_nothing_holds_before_the_first_rtk_position(doppler_solved):
    assert _mode(initialised=False, doppler_solved=doppler_solved) == NONE


def test_dead_reckoning_needs_no_satellites_and_no_time_limit():
    lost = {"doppler_solved": False, "hdop_doppler": math.inf, "v_gnss": math.nan}
    assert _mode(**lost, outage_s=1e6) == IMU_ODOMETER


def test_singular_geometry_never_gives_a_satellite_mode():
    assert _mode(hdop_doppler=math.inf) == IMU_ODOMETER
    assert not rtk_usable(math.inf, LIMITS)
    assert _mode(v_gnss=math.nan) == IMU_ODOMETER
