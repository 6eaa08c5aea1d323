"""Vehicles that start with an unknown heading and lose the satellites at once: levels along cover the course."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.sensors.faults import Fault, FaultSchedule
from tests.helpers.tunnel_drives import DT_S, Drive, allowed, drive, with_risk

REST_S, DRIVE_S, VEHICLES = 12.0, 12.0, 100
HEADINGS_RAD = (1.57, 2.8)


def _cold(heading_rad: float, jam_s: float) -> Drive:
    """At rest with this heading, then 1.5 m/s^2; the signals are jammed ``jam_s`` after the first motion."""
    speed = np.clip(1.5 * (np.arange(round((REST_S + DRIVE_S) / DT_S)) * DT_S - REST_S), 0.0, 10.0)
    faults = FaultSchedule((Fault(kind="jamming", start_s=REST_S + jam_s, duration_s=100.0, magnitude_db=40.0),))
    return drive(
        with_risk(NavigatorConfig(), 1e-3), np.zeros(speed.size), REST_S + DRIVE_S, VEHICLES, from_s=REST_S + jam_s,
        faults=faults, speed_mps=speed, heading_rad=heading_rad,
    )  # fmt: skip


@pytest.mark.parametrize("heading_rad", HEADINGS_RAD)
def test_levels_hold_after_a_start_with_an_unknown_heading(heading_rad: float) -> None:
    """Before the path's shortening was in the level, a quarter of the epochs were beyond it along."""
    run = _cold(heading_rad, 0.5)
    for after_s in (2.0, 6.0, 11.0):
        assert run.exceeding(1, REST_S + after_s) <= allowed(VEHICLES, 1e-3, times=3)


@pytest.mark.parametrize("heading_rad", HEADINGS_RAD)
def test_the_course_is_far_off_there(heading_rad: float) -> None:
    """Ten degrees and more for some: the test above can fail."""
    off = np.abs(_cold(heading_rad, 0.5).heading_error_rad[-1])
    assert np.quantile(off, 0.9) > np.deg2rad(10.0)
