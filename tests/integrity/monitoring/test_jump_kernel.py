"""RTK against the position that was expected of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.monitoring.jump_kernel import D_E, D_N, DOUBT_SIZE, add_doubt, contradicts, judge_jump

HEADING = 0.7
SIN, COS = math.sin(HEADING), math.cos(HEADING)
EXPECTED, FOUND = np.array([0.3, 0.2]), np.array([0.1, 0.05])


def along(at_m: float, ct_m: float) -> tuple[float, float]:
    """The vector in E and N of lengths along and across (to the right of) the track."""
    return SIN * at_m + COS * ct_m, COS * at_m - SIN * ct_m


def judge(doubt: np.ndarray, at_m: float, ct_m: float) -> bool:
    return bool(judge_jump(*along(at_m, ct_m), SIN, COS, EXPECTED, FOUND, doubt))


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
    doubt = np.zeros(DOUBT_SIZE)
    assert not judge(doubt, 2.0, 0.0)
    assert judge(doubt, 0.0, 0.0)
    assert (doubt == 0.0).all()


def test_integers_resolved_anew_that_contradict_again_are_used_with_a_doubt_until_they_jump_back() -> None:
    doubt = np.zeros(DOUBT_SIZE)
    assert [judge(doubt, 2.0, -1.0), judge(doubt, 2.0, -1.0)] == [False, True]
    assert doubt[[D_E, D_N]] == pytest.approx(along(2.0, -1.0))
    levels = np.array([[0.1, 0.05]])
    add_doubt(SIN, COS, doubt, levels)
    assert levels[0, 0] >= 0.1 + 2.0 + EXPECTED[0]
    assert levels[0, 1] >= 0.05 + 1.0 + EXPECTED[1]
    assert judge(doubt, 0.1, 0.1)  # goes on as expected: still in doubt
    assert doubt[[D_E, D_N]] == pytest.approx(along(2.0, -1.0))
    assert [judge(doubt, -1.9, 1.1), judge(doubt, -1.9, 1.1)] == [False, True]
    assert (doubt == 0.0).all()


@given(
    shift=st.floats(0.5, 50.0), direction=st.floats(-math.pi, math.pi), heading=st.floats(-math.pi, math.pi)
)  # fmt: skip
def test_the_levels_hold_whichever_history_is_right(shift: float, direction: float, heading: float) -> None:
    """The position keeps to where it was expected; the truth is near there, or near where RTK is."""
    sin_h, cos_h, doubt = math.sin(heading), math.cos(heading), np.zeros(DOUBT_SIZE)
    jump = shift * math.sin(direction), shift * math.cos(direction)
    assert [judge_jump(*jump, sin_h, cos_h, EXPECTED, FOUND, doubt) for _ in range(2)] == [False, True]
    levels = FOUND[None].copy()
    add_doubt(sin_h, cos_h, doubt, levels)
    at, ct = abs(shift * math.cos(direction - heading)), abs(shift * math.sin(direction - heading))
    assert levels[0, 0] >= max(at + FOUND[0], EXPECTED[0]) - 1e-9
    assert levels[0, 1] >= max(ct + FOUND[1], EXPECTED[1]) - 1e-9
