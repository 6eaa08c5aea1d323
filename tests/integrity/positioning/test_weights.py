"""Weights of satellites in closed form, and which satellites are used."""

from __future__ import annotations

import numpy as np
import pytest
from signal_records import records_of

from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.positioning.parameters import rtk_parameters
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, UNUSED, is_strong, leave_out_faded, weigh
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL

SINE = np.array([1.0, 0.5, 0.5, 0.1, 0.0, 0.5])  # of the elevation: zenith, 30 degrees, ... an empty place
KNEE = 35.0
CN0 = np.array([35.0, 35.0, 45.0, 50.0, 0.0, np.nan])
TRACKED = np.array([True, True, True, True, False, True])
E = np.column_stack([np.sqrt(1.0 - SINE**2), np.zeros(6), SINE])
E[4] = 0.0
SIGNALS = records_of(OBSERVED_SIGNAL, 6, e=E, tracked=TRACKED, cn0=CN0)


def qualities() -> Records:
    """The factors of the six satellites."""
    marks = np.zeros(6, MARK)
    weigh(SIGNALS, KNEE, marks)
    return marks["quality"]


def test_the_weight_falls_with_elevation_and_doubles_its_variance_at_the_knee() -> None:
    quality = qualities()
    np.testing.assert_allclose(quality[:4], [2.0, 5.0, 2.5 * 1.1, 50.5 * (1.0 + 10.0**-1.5)], rtol=1e-14)
    assert quality[4] == UNUSED


def test_a_satellite_that_is_low_weak_or_untracked_is_not_used() -> None:
    used = [is_strong(signal, 0.2, 40.0) for signal in SIGNALS]
    assert used == [False, False, True, False, False, False]


def test_a_carrier_that_has_just_faded_is_not_used_until_its_peak_has_fallen() -> None:
    """5 dB below the highest C/N0, which falls by 1 dB/s; a gap without signal does not forget it."""
    rules = rtk_parameters(RtkConfig(), 2, 1e-5)[0]
    ambiguities = np.zeros(2, AMBIGUITY)
    history = []
    for cn0 in [45.0] * 5 + [0.0] * 10 + [36.0] * 40:
        tracked = [cn0 > 0.0, True]
        marks = records_of(MARK, 2, used=tracked, factor=1.0)
        signals = records_of(OBSERVED_SIGNAL, 2, tracked=tracked, cn0=[cn0, 45.0])
        leave_out_faded(signals, rules, 0.1, marks, ambiguities)
        used, factor = marks["used"], marks["factor"]
        history.append(bool(used[0]))
        assert (factor[0] == UNUSED) == (cn0 > 0.0 and not used[0])
        assert used[1]
        assert factor[1] == 1.0
    assert all(history[:5])
    left_out = history[15:].index(True)  # 45 - 1.0 after the gap, down to 41: 3 s
    assert left_out == pytest.approx(29, abs=1)
    assert all(history[15 + left_out :])
