"""FAR, MDR and OCDR: the published counts, enumeration, and what never warning reaches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.integrity.assessment.warning_rates import PUBLISHED_COUNTS, WarningCounts, sweep_thresholds
from lanebound.integrity.core.errors import InputError


@pytest.mark.parametrize(
    ("name", "percent", "printed"),
    [("urban", 98.23, (0.0112, 0.0064, 98.24)), ("rural", 99.22, (0.0029, 0.0048, 99.23)),
     ("mixed", 97.29, (0.0099, 0.0172, 97.29))],
)  # fmt: skip
def test_published_counts_give_their_rates(name, percent, printed) -> None:
    """S5 Table 4 and Table 3; its OCDR are one less the printed, shortened rates."""
    false_alarms, missed, points = PUBLISHED_COUNTS[name]
    counts = WarningCounts(points, points, false_alarms, missed)
    assert round(100.0 * counts.ocdr, 2) == percent
    assert counts.far == pytest.approx(printed[0], abs=1e-4)
    assert counts.mdr == pytest.approx(printed[1], abs=1e-4)
    assert round(100.0 * (1.0 - printed[0] - printed[1]), 2) == printed[2]


def test_pooled_counts_give_98_6_percent() -> None:
    total = WarningCounts(0, 0, 0, 0)
    for false_alarms, missed, points in PUBLISHED_COUNTS.values():
        total += WarningCounts(points, points, false_alarms, missed)
    assert (total.points, total.false_alarms, total.missed) == (5685, 35, 43)
    assert round(100.0 * total.ocdr, 1) == 98.6


def test_counts_are_those_of_an_enumeration() -> None:
    warn, wrong = np.array([1, 1, 0, 0, 0, 1], bool), np.array([1, 0, 1, 0, 0, 0], bool)
    judged = np.array([1, 1, 1, 1, 1, 0], bool)
    counts = WarningCounts.of(warn, wrong, judged)
    assert counts == WarningCounts(points=5, wrong=2, false_alarms=1, missed=1)
    assert (counts.per_right, counts.per_wrong) == (1 / 3, 1 / 2)
    low, high = counts.interval(1)
    assert low < 0.2 < high


def test_never_warning_has_the_ocdr_of_the_rarity_of_faults() -> None:
    wrong = np.arange(1000) < 8
    never, always = WarningCounts.of(False, wrong), WarningCounts.of(True, wrong)
    assert never.ocdr == pytest.approx(0.992)
    assert never.per_wrong == 1.0
    assert always.ocdr == pytest.approx(0.008)
    assert WarningCounts.of(False, np.zeros(3, bool)).per_wrong is None


@given(st.lists(st.tuples(st.floats(0, 100), st.booleans()), min_size=1, max_size=60))
def test_a_sweep_counts_as_each_threshold_does(points) -> None:
    score, wrong = (np.array(values) for values in zip(*points, strict=True))
    at = np.linspace(0.0, 101.0, 12)
    sweep = sweep_thresholds(score, wrong, at)
    for k, threshold in enumerate(at):
        counts = WarningCounts.of(score < threshold, wrong)
        assert (counts.false_alarms, counts.missed) == (sweep.false_alarms[k], sweep.missed[k])
    assert (np.diff(sweep.false_alarms) >= 0).all()
    assert (np.diff(sweep.missed) <= 0).all()
    crossing = sweep.crossing()
    assert crossing is not None  # at 101 no fault is missed
    assert sweep.best()[1] == pytest.approx(max(WarningCounts.of(score < threshold, wrong).ocdr for threshold in at))


def test_a_sweep_without_crossing_has_none() -> None:
    assert sweep_thresholds([5.0], [True], [0.0, 1.0]).crossing() is None


def test_impossible_counts_are_refused() -> None:
    with pytest.raises(InputError, match="at most points = 3 together, got 2 and 2"):
        WarningCounts(3, 3, 2, 2)
