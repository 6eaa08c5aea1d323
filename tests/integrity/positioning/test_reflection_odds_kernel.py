"""Odds of carriers that may not be direct, and the sets of them that a fix is monitored without: by enumeration."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_records import records_of

from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.positioning.parameters import rtk_parameters
from lanebound.integrity.positioning.reflection_odds_kernel import (
    LARGEST_SET,
    REFLECTION_RULES,
    find_sets,
    keep_trusted,
    update_odds,
)
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, SATELLITE, UNUSED
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL

LIMIT, MOST = 1e-6, 40


def rules(sets: int = MOST, limit: float = LIMIT) -> Records:
    return one_record(
        REFLECTION_RULES,
        sets=sets,
        zenith=48.0,
        horizon=38.0,
        most=0.1,
        centre=3.0,
        scale=0.35,
        limit=limit,
        single=1e-4,
    )


def monitored(odds: list[float], sets: int = MOST, limit: float = LIMIT) -> tuple[int, float, set[tuple[int, ...]]]:
    """Number, probability of what is left, and the sets found."""
    found = np.full((sets, LARGEST_SET), -9, dtype=np.int64)
    count, left = find_sets(np.array(odds), len(odds), rules(sets, limit)[0], found)
    return count, left, {tuple(sorted(i for i in row if i >= 0)) for row in found[: max(count, 0)]}


odds_of_satellites = st.lists(st.sampled_from([1e-5, 1e-4, 1e-3, 0.02, 0.1]), min_size=1, max_size=9)


@settings(max_examples=200, deadline=None)
@given(odds_of_satellites)
def test_what_is_not_monitored_is_within_its_limit(odds: list[float]) -> None:
    """The odds of all sets of two and more but those monitored, summed one by one."""
    count, left, sets = monitored(odds)
    if count < 0:
        return
    assert len(sets) == count <= MOST
    assert all(2 <= len(members) <= LARGEST_SET for members in sets)
    rest = sum(
        math.prod(odds[i] for i in members)
        for size in range(2, len(odds) + 1)
        for members in combinations(range(len(odds)), size)
        if members not in sets
    )
    assert left == pytest.approx(rest, rel=1e-6, abs=1e-13)
    assert left <= LIMIT


@pytest.mark.parametrize("weak", [0, 1, 2, 3])
def test_only_sets_that_are_needed_are_monitored(weak: int) -> None:
    """Pairs of a weak carrier with each of ten strong ones, and sets of weak ones; refused where these are too many."""
    odds = weak * [0.05] + 10 * [2e-5]
    count, _, sets = monitored(odds, sets=100)
    expected = {members for members in combinations(range(weak + 10), 2) if members[0] < weak}
    expected |= {members for members in combinations(range(weak), 3)}
    assert expected <= sets
    assert count == len(sets)
    if weak:
        assert monitored(odds, sets=len(expected) - 1)[0] == -1


def test_strong_carriers_need_no_sets() -> None:
    count, left, _ = monitored(18 * [3e-5])
    assert count == 0
    assert left == pytest.approx(math.comb(18, 2) * 9e-10, rel=1e-3)


def test_a_weak_carrier_is_paired_with_each_other_one() -> None:
    _, _, sets = monitored([1e-4, 0.05, 1e-4, 1e-4])
    assert {(0, 1), (1, 2), (1, 3)} <= sets


def test_odds_grow_with_the_loss_and_stay_while_integers_are_held() -> None:
    los = np.array([[0.0, 0.0, 1.0], [0.0, math.cos(0.5), math.sin(0.5)], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    satellites, ambiguities = np.zeros(4, SATELLITE), np.zeros(4, AMBIGUITY)
    satellites["prior"], ambiguities["held"][2] = 1e-5, True
    par, losses = rules()[0], np.array([0.0, 3.0, 8.0, 8.0])
    sky = 38.0 + 10.0 * los[:, 2]
    signals = records_of(OBSERVED_SIGNAL, 4, e=los, cn0=sky - losses, tracked=[True, True, True, False])
    update_odds(signals, satellites, par, ambiguities)
    expected = 1e-5 + 0.1 / (1.0 + np.exp((3.0 - losses) / 0.35))
    np.testing.assert_allclose(ambiguities["odds"][:3], expected[:3], rtol=1e-12)
    assert ambiguities["odds"][3] == 0.0
    signals["cn0"] = sky
    update_odds(signals, satellites, par, ambiguities)
    assert ambiguities["odds"][2] == pytest.approx(expected[2])  # held
    assert ambiguities["odds"][1] < 1e-4  # not held: present odds


def test_the_most_doubtful_are_taken_out_of_use_until_few_sets_are_needed() -> None:
    ambiguities, marks = np.zeros(12, AMBIGUITY), records_of(MARK, 12, used=True, factor=1.0)
    ambiguities["odds"], ambiguities["held"] = np.r_[np.full(7, 2e-5), np.full(5, 0.08)], True
    keep_trusted(marks, UNUSED, rules()[0], ambiguities)
    used, factor = marks["used"], marks["factor"]
    assert used[:7].all()
    assert 0 < used[7:].sum() < 5
    np.testing.assert_array_equal(ambiguities["held"], used)
    np.testing.assert_array_equal(factor == UNUSED, ~used)
    assert find_sets(ambiguities["odds"][used], used.sum(), rules()[0], np.empty((MOST, 3), np.int64))[0] >= 0


def test_hypotheses_are_off_by_default() -> None:
    assert rtk_parameters(RtkConfig(), 2, 1e-5)["reflections"]["sets"][0] == 0
