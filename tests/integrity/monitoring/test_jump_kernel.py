"""The jump monitor: RTK against the expected position."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.monitoring.jump_kernel import (
    ACCEPTED,
    JUMP,
    QUARANTINED,
    REFUSED,
    TRUSTED,
    begin_epoch,
    contradicts,
    grow_drift,
    is_suspicious,
    judge_jump,
    suspects_signals,
    widen,
)

HEADING, DT, WAITS_S = 0.7, 0.1, (60.0, 5.0)
SIN, COS = math.sin(HEADING), math.cos(HEADING)
EXPECTED, FOUND = np.array([0.3, 0.2]), np.array([0.1, 0.05])


def along(at_m: float, ct_m: float) -> tuple[float, float]:
    """The vector in E and N of lengths along and across (to the right of) the track."""
    return SIN * at_m + COS * ct_m, COS * at_m - SIN * ct_m


class Monitor:
    """A jump monitor, and its verdicts on RTK at a distance from the expected position."""

    def __init__(self, waits_s: tuple[float, float] = WAITS_S) -> None:
        self.jump, self.waits_s = np.zeros(1, JUMP)[0], waits_s

    def judge(
        self, at_m: float, ct_m: float = 0.0, lasting: bool = True, conflict: bool = False, expected: Any = EXPECTED
    ) -> int:
        begin_epoch(DT, self.jump)
        return int(
            judge_jump(*along(at_m, ct_m), SIN, COS, expected, FOUND, lasting, conflict, *self.waits_s, self.jump)
        )

    def quarantine(self, *places: float) -> float:
        """How long RTK is not used [s] while its position alternates between these places along the track."""
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
    monitor = Monitor()
    assert monitor.judge(2.0) == REFUSED
    assert is_suspicious(monitor.jump)
    assert monitor.judge(0.0, lasting=False) == ACCEPTED
    assert monitor.jump["stage"] == TRUSTED
    assert monitor.jump["d_e"] == monitor.jump["d_n"] == 0.0


@pytest.mark.parametrize(("lasting", "wait_s"), [(True, WAITS_S[0]), (False, WAITS_S[1])])
@pytest.mark.parametrize("places", [(2.0,), (2.0, 0.0), (2.0, 9.0)])
def test_after_a_second_contradiction_rtk_waits_wherever_it_goes(
    lasting: bool, wait_s: float, places: tuple[float, ...]
) -> None:
    monitor = Monitor()
    assert [monitor.judge(2.0, lasting=lasting), monitor.judge(2.0, lasting=False)] == [REFUSED, QUARANTINED]
    assert suspects_signals(monitor.jump)
    assert monitor.quarantine(*places) == pytest.approx(wait_s - DT)
    assert not is_suspicious(monitor.jump)
    assert monitor.judge(2.0) == REFUSED, "the next contradiction counts as the first"


def test_without_a_quarantine_the_second_contradiction_is_accepted() -> None:
    monitor = Monitor((0.0, 0.0))
    assert [monitor.judge(2.0), monitor.judge(2.0, lasting=False), monitor.judge(0.0)] == [REFUSED, ACCEPTED, ACCEPTED]


def test_doppler_against_the_odometer_quarantines_rtk_that_lasts_but_not_rtk_after_an_outage() -> None:
    monitor = Monitor()
    assert monitor.judge(0.0, lasting=False, conflict=True) == ACCEPTED
    assert monitor.judge(0.0, conflict=True) == QUARANTINED
    assert monitor.quarantine(0.0) == pytest.approx(WAITS_S[0] - DT)


@pytest.mark.parametrize("change", [{"conflict": True}, {"expected": np.full(2, np.inf)}])
def test_after_a_jump_rtk_must_be_proven(change: dict[str, Any]) -> None:
    monitor = Monitor()
    assert [monitor.judge(2.0), monitor.judge(0.0, lasting=False, **change)] == [REFUSED, QUARANTINED]


@pytest.mark.parametrize(("again_m", "verdict"), [(0.5, QUARANTINED), (0.3, QUARANTINED), (0.2, ACCEPTED)])
def test_a_jump_remains_one_when_growing_levels_have_overtaken_it(again_m: float, verdict: int) -> None:
    monitor, grown = Monitor(), np.array([1.0, 1.0])
    assert [monitor.judge(0.5), monitor.judge(again_m, lasting=False, expected=grown)] == [REFUSED, verdict]


def test_after_the_quarantine_rtk_is_suspicious_until_its_next_position() -> None:
    monitor = Monitor()
    monitor.judge(2.0)
    monitor.judge(2.0, lasting=False)
    for _ in range(700):
        begin_epoch(DT, monitor.jump)
    assert is_suspicious(monitor.jump)
    assert not suspects_signals(monitor.jump)
    assert monitor.judge(2.0, lasting=False) == ACCEPTED


@given(
    shift=st.floats(0.5, 50.0), direction=st.floats(-math.pi, math.pi), heading=st.floats(-math.pi, math.pi)
)  # fmt: skip
def test_the_levels_hold_whichever_history_is_right(shift: float, direction: float, heading: float) -> None:
    """The position is that of dead reckoning; the truth is near it, or near that of RTK."""
    sin_h, cos_h, jump = math.sin(heading), math.cos(heading), np.zeros(1, JUMP)[0]
    jump["d_e"], jump["d_n"] = shift * math.sin(direction), shift * math.cos(direction)
    levels = np.array([[0.3, 0.2], [3.0, 2.0]])
    widen(sin_h, cos_h, 0.1 * levels, jump, levels)
    at, ct = abs(shift * math.cos(direction - heading)), abs(shift * math.sin(direction - heading))
    assert (levels[0] >= [max(at + 0.03, 0.3) - 1e-9, max(ct + 0.02, 0.2) - 1e-9]).all()
    assert (levels[1] >= [max(at + 0.3, 3.0) - 1e-9, max(ct + 0.2, 2.0) - 1e-9]).all()


@pytest.mark.parametrize(("by_odometer", "wait_s"), [(False, WAITS_S[0]), (True, WAITS_S[1])])
def test_a_drift_that_the_odometer_explains_makes_rtk_wait_for_the_short_quarantine(
    by_odometer: bool, wait_s: float
) -> None:
    monitor = Monitor()
    monitor.jump["drifts"], monitor.jump["by_odometer"] = True, by_odometer
    assert monitor.judge(0.0, conflict=True) == QUARANTINED
    assert monitor.quarantine(0.0) == pytest.approx(wait_s - DT)
    assert not monitor.jump["by_odometer"]


@pytest.mark.parametrize(("speed", "grown_m"), [(10.0, 0.5 * 20.0), (20.0, 20.0)])
def test_after_a_drift_levels_grow_with_what_the_odometer_would_add_until_rtk_is_accepted(
    speed: float, grown_m: float
) -> None:
    """0.5 m/s along at 10 m/s, 20 s later, RTK lost meanwhile: the odometer's error of 5 % is in the level."""
    monitor = Monitor()
    monitor.jump["drifts"], monitor.jump["rate_at"], monitor.jump["drift_speed"] = True, 0.5, 10.0
    assert monitor.judge(0.0, conflict=True) == QUARANTINED
    for _ in range(200):
        grow_drift(DT, speed, SIN, COS, monitor.jump)
    levels = np.array([[0.3, 0.2]])
    widen(SIN, COS, np.zeros((1, 2)), monitor.jump, levels)
    assert levels[0] == pytest.approx([0.3 + grown_m, 0.2])
    monitor.quarantine(0.0)
    assert monitor.jump["off_e"] == monitor.jump["rate_at"] == 0.0


def test_the_rate_of_a_drift_follows_rtk_in_the_quarantine() -> None:
    """Windows showed 0.2 m/s; RTK then leaves the position by 1 m/s for 2 s and is lost: 1 m/s counts from there on."""
    monitor = Monitor()
    monitor.jump["drifts"], monitor.jump["rate_at"], monitor.jump["drift_speed"] = True, 0.2, 10.0
    assert monitor.judge(0.3, conflict=True) == QUARANTINED
    for k in range(1, 51):
        grow_drift(DT, 10.0, SIN, COS, monitor.jump)
        if k <= 20:
            assert monitor.judge(0.3 + k * DT) == QUARANTINED
    levels = np.array([[0.3, 0.2]])
    widen(SIN, COS, np.zeros((1, 2)), monitor.jump, levels)
    assert monitor.jump["rate_at"] == pytest.approx(1.0)
    assert levels[0, 0] >= 0.3 + 0.3 + 5.0  # what the odometer is off by then, if it is the odometer
    assert levels[0, 1] == pytest.approx(0.2)
