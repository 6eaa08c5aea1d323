"""RTK against the position that was expected of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.monitoring.jump_kernel import (
    ACCEPTED,
    D_E,
    D_N,
    DOUBT_SIZE,
    QUARANTINED,
    REFUSED,
    contradicts,
    in_doubt,
    judge_jump,
    pass_time,
    suspects_signals,
    widen,
)

HEADING, DT, WAITS_S = 0.7, 0.1, (60.0, 5.0)
SIN, COS = math.sin(HEADING), math.cos(HEADING)
EXPECTED, FOUND = np.array([0.3, 0.2]), np.array([0.1, 0.05])


def along(at_m: float, ct_m: float) -> tuple[float, float]:
    """The vector in E and N of lengths along and across (to the right of) the track."""
    return SIN * at_m + COS * ct_m, COS * at_m - SIN * ct_m


class Watch:
    """A doubt, and the verdicts on RTK so far from where it is expected."""

    def __init__(self, waits_s: tuple[float, float] = WAITS_S) -> None:
        self.doubt, self.waits_s = np.zeros(DOUBT_SIZE), waits_s

    def judge(
        self, at_m: float, ct_m: float = 0.0, lasting: bool = True, conflict: bool = False, expected: Any = EXPECTED
    ) -> int:
        pass_time(DT, self.doubt)
        return int(
            judge_jump(*along(at_m, ct_m), SIN, COS, expected, FOUND, lasting, conflict, self.waits_s, self.doubt)
        )

    def quarantine(self, *places: float) -> float:
        """How long RTK is not believed [s] while it is found at these places along, again and again."""
        epochs = 0
        while self.judge(places[epochs % len(places)]) == QUARANTINED:
            epochs += 1
        return epochs * DT


@pytest.mark.parametrize(
    ("at_m", "ct_m", "is_so"),
    [(0.0, 0.0, False), (0.399, 0.249, False), (-0.399, -0.249, False), (0.401, 0.0, True), (0.0, -0.251, True)],
)
def test_two_levels_exclude_each_other_beyond_their_sum(at_m: float, ct_m: float, is_so: bool) -> None:
    assert contradicts(*along(at_m, ct_m), SIN, COS, EXPECTED, FOUND) == is_so


def test_where_there_is_no_level_nothing_is_contradicted() -> None:
    assert not contradicts(1e3, 1e3, SIN, COS, np.full(2, np.inf), FOUND)
    assert not contradicts(1e3, 1e3, SIN, COS, EXPECTED, np.full(2, np.inf))


def test_a_wrong_fix_is_refused_and_forgotten_when_the_next_agrees() -> None:
    watch = Watch()
    assert watch.judge(2.0) == REFUSED
    assert in_doubt(watch.doubt)
    assert watch.judge(0.0, lasting=False) == ACCEPTED
    assert (watch.doubt == 0.0).all()


@pytest.mark.parametrize(("lasting", "wait_s"), [(True, WAITS_S[0]), (False, WAITS_S[1])])
@pytest.mark.parametrize("places", [(2.0,), (2.0, 0.0), (2.0, 9.0)])
def test_who_contradicts_again_is_not_believed_for_a_while_wherever_it_goes(
    lasting: bool, wait_s: float, places: tuple[float, ...]
) -> None:
    watch = Watch()
    assert [watch.judge(2.0, lasting=lasting), watch.judge(2.0, lasting=False)] == [REFUSED, QUARANTINED]
    assert suspects_signals(watch.doubt)
    assert watch.quarantine(*places) == pytest.approx(wait_s - DT)
    assert not in_doubt(watch.doubt)
    assert watch.judge(2.0) == REFUSED, "the next contradiction counts as the first"


def test_without_a_quarantine_who_contradicts_again_is_believed() -> None:
    watch = Watch((0.0, 0.0))
    assert [watch.judge(2.0), watch.judge(2.0, lasting=False), watch.judge(0.0)] == [REFUSED, ACCEPTED, ACCEPTED]


def test_doppler_against_the_odometer_quarantines_rtk_that_goes_on_but_not_what_ends_an_outage() -> None:
    watch = Watch()
    assert watch.judge(0.0, lasting=False, conflict=True) == ACCEPTED
    assert watch.judge(0.0, conflict=True) == QUARANTINED
    assert watch.quarantine(0.0) == pytest.approx(WAITS_S[0] - DT)


@pytest.mark.parametrize("change", [{"conflict": True}, {"expected": np.full(2, np.inf)}])
def test_after_a_jump_rtk_must_be_proven(change: dict[str, Any]) -> None:
    watch = Watch()
    assert [watch.judge(2.0), watch.judge(0.0, lasting=False, **change)] == [REFUSED, QUARANTINED]


@pytest.mark.parametrize(("again_m", "verdict"), [(0.5, QUARANTINED), (0.3, QUARANTINED), (0.2, ACCEPTED)])
def test_a_jump_that_growing_levels_have_overtaken_is_one_still(again_m: float, verdict: int) -> None:
    watch, grown = Watch(), np.array([1.0, 1.0])
    assert [watch.judge(0.5), watch.judge(again_m, lasting=False, expected=grown)] == [REFUSED, verdict]


def test_who_is_pardoned_stays_in_doubt_until_it_is_there() -> None:
    watch = Watch()
    watch.judge(2.0)
    watch.judge(2.0, lasting=False)
    for _ in range(700):
        pass_time(DT, watch.doubt)
    assert in_doubt(watch.doubt)
    assert not suspects_signals(watch.doubt)
    assert watch.judge(2.0, lasting=False) == ACCEPTED


@given(
    shift=st.floats(0.5, 50.0), direction=st.floats(-math.pi, math.pi), heading=st.floats(-math.pi, math.pi)
)  # fmt: skip
def test_the_levels_hold_whichever_history_is_right(shift: float, direction: float, heading: float) -> None:
    """The position is the one reckoned; the truth is near it, or near where RTK is."""
    sin_h, cos_h, doubt = math.sin(heading), math.cos(heading), np.zeros(DOUBT_SIZE)
    doubt[D_E], doubt[D_N] = shift * math.sin(direction), shift * math.cos(direction)
    levels = np.array([[0.3, 0.2], [3.0, 2.0]])
    widen(sin_h, cos_h, 0.1 * levels, doubt, levels)
    at, ct = abs(shift * math.cos(direction - heading)), abs(shift * math.sin(direction - heading))
    assert (levels[0] >= [max(at + 0.03, 0.3) - 1e-9, max(ct + 0.02, 0.2) - 1e-9]).all()
    assert (levels[1] >= [max(at + 0.3, 3.0) - 1e-9, max(ct + 0.2, 2.0) - 1e-9]).all()
