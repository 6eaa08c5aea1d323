"""Whether an RTK position is taken: beside what was expected, beside levels that are not there, before any position."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.monitoring.geometry_kernel import X_E, X_N
from lanebound.integrity.monitoring.jump_kernel import ACCEPTED, JUMPED, QUARANTINED, REFUSED, STAGE, WAITING
from lanebound.integrity.navigators import navigator_columns_kernel as col
from lanebound.integrity.navigators import navigator_kernel as nk

NOWHERE = np.inf


def _judged(away_m: float, expected_m: float, found_m: float, **state: float) -> int:
    """The verdict on a position to the East of the one expected, of a vehicle that drives North and has had RTK."""
    x, par, head = np.zeros(col.NX), np.zeros(col.NP), np.zeros(32)
    par[[col.DT, col.LEVER_FORWARD, col.LEVER_RIGHT]] = 0.1, 1.5, 0.4
    par[[col.AFTER_JUMP, col.AFTER_OUTAGE]] = 60.0, 5.0
    x[[col.INITIALISED, col.SINCE_RTK]] = 1.0, 0.1
    for name, value in state.items():
        x[getattr(col, name) if hasattr(col, name) else col.DOUBT + {"stage": STAGE}[name]] = value
    head[X_E], head[X_N] = away_m + 0.4, 1.5  # the antenna is ahead and to the right of the reference point
    expected, found = np.full((2, 2), expected_m), np.full((2, 2), found_m)
    east, north = nk.reference_point(head, par, 0.0, 1.0)
    lasting = bool(x[col.SINCE_RTK] < 0.15)
    return int(nk.judge_rtk(x, par, east, north, 0.0, 1.0, expected, found, lasting))


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
    assert _judged(500.0, NOWHERE, 0.2, INITIALISED=0.0) == ACCEPTED
    assert _judged(500.0, 0.1, 0.2, INITIALISED=0.0) == ACCEPTED


def test_who_contradicts_again_waits() -> None:
    assert _judged(0.51, 0.3, 0.2, stage=JUMPED) == QUARANTINED
    assert _judged(0.0, 0.3, 0.2, stage=WAITING) == QUARANTINED


def test_doppler_and_wheels_apart_while_rtk_lasts() -> None:
    assert _judged(0.0, 0.3, 0.2, CONFLICT_S=0.6) == QUARANTINED
    assert _judged(0.0, 0.3, 0.2, CONFLICT_S=0.6, SINCE_RTK=3.0) == ACCEPTED
