"""Whether an RTK position is taken: beside what was expected, beside levels that are not there, before any position."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.jump_kernel import ACCEPTED, JUMPED, QUARANTINED, REFUSED, WAITING
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import judge_position
from lanebound.integrity.navigators.rtk_reckoning.parameters import epoch_parameters
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import VEHICLE, WORK

NOWHERE = np.inf
CONFIG = NavigatorConfig().replace(positioning={"antenna_forward_m": 1.5, "antenna_right_m": 0.4})


def _judged(away_m: float, expected_m: float, found_m: float, stage: int | None = None, **state: float) -> int:
    """The verdict on a position to the East of the one expected, of a vehicle that drives North and has had RTK."""
    vehicle, w, par = np.zeros(1, VEHICLE)[0], np.zeros(1, WORK)[0], epoch_parameters(CONFIG)[0]
    vehicle["initialised"], vehicle["since_rtk"] = True, 0.1
    for name, value in state.items():
        vehicle[name] = value
    if stage is not None:
        vehicle["jump"]["stage"] = stage
    w["sin_h"], w["cos_h"] = 0.0, 1.0
    w["fixed"]["lasting"] = vehicle["since_rtk"] < 0.15
    # the antenna is ahead and to the right of the reference point
    w["fixed"]["position"][:2] = away_m + 0.4, 1.5
    return int(judge_position(vehicle, par, w, np.full((2, 2), expected_m), np.full((2, 2), found_m)))


@pytest.mark.parametrize(
    ("case", "verdict"),
    [
        ((0.49, 0.3, 0.2), ACCEPTED),
        ((0.51, 0.3, 0.2), REFUSED),
        ((5.0, NOWHERE, 0.2), ACCEPTED),
        ((0.0, 0.3, NOWHERE), QUARANTINED),
        ((0.0, NOWHERE, NOWHERE), ACCEPTED),
    ],
)
def test_by_the_levels_of_both(case: tuple[float, float, float], verdict: int) -> None:
    assert _judged(*case) == verdict


def test_the_first_position_is_taken_wherever_it_is() -> None:
    assert _judged(500.0, NOWHERE, 0.2, initialised=False) == ACCEPTED
    assert _judged(500.0, 0.1, 0.2, initialised=False) == ACCEPTED


def test_a_second_contradiction_waits() -> None:
    assert _judged(0.51, 0.3, 0.2, stage=JUMPED) == QUARANTINED
    assert _judged(0.0, 0.3, 0.2, stage=WAITING) == QUARANTINED


def test_doppler_against_the_odometer_while_rtk_lasts() -> None:
    assert _judged(0.0, 0.3, 0.2, conflict_s=0.6) == QUARANTINED
    assert _judged(0.0, 0.3, 0.2, conflict_s=0.6, since_rtk=3.0) == ACCEPTED
