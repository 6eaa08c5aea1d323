"""Means with intervals: closed forms, invariances, and how often an interval holds the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, binomtest, norm, sem, t, trim_mean, ttest_rel

from lanebound.agents.benchmark.statistics import (
    RESAMPLES,
    VERDICT_SEEDS,
    difference,
    estimate,
    holm,
    interquartile_mean,
    is_clear,
    seeds_to_exclude,
)
from lanebound.integrity.core.streams import named_generator


def normal(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(3.0, 2.0, n)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 50])
def test_interquartile_mean_is_that_of_scipy(n):
    values = normal(n)
    assert interquartile_mean(values) == pytest.approx(trim_mean(values, 0.25))
    assert interquartile_mean(np.stack([values, values + 1.0])) == pytest.approx(
        trim_mean(values, 0.25) + np.arange(2.0)
    )


def test_the_interval_is_the_wider_of_student_and_a_plain_loop_of_studentised_resamples():
    values = np.random.default_rng(1).exponential(3.0, 20)
    choices = named_generator(20, "bootstrap").integers(20, size=(RESAMPLES, 20))
    mean, found = values.mean(), estimate(values)
    studentised = [(values[row].mean() - mean) / sem(values[row]) for row in choices]
    student = t.interval(0.95, 19, mean, sem(values))
    low, high = (mean - sem(values) * q for q in np.quantile(studentised, [0.975, 0.025]))
    assert found.mean == mean
    assert found.low == pytest.approx(min(low, student[0]), rel=0.01)
    assert found.high == pytest.approx(max(high, student[1]), rel=0.01)
    middles = [interquartile_mean(values[row]) for row in choices]
    tail = norm.cdf(np.sqrt(20 / 19) * t.ppf(0.025, 19))
    assert (found.iqm_low, found.iqm_high) == pytest.approx(np.quantile(middles, [tail, 1.0 - tail]))


def test_for_many_seeds_the_interval_is_that_of_the_normal_distribution():
    values = normal(400)
    found = estimate(values)
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20.0, rel=0.1)


TRIALS, FALSE_ALARM = 400, 1e-4
LAWS = {
    "normal": lambda rng, n: rng.normal(size=n),
    "exponential": lambda rng, n: rng.exponential(size=n) - 1.0,
    "mostly zero": lambda rng, n: rng.exponential(size=n) * (rng.random(n) < 0.2) - 0.2,
}


def left_out(interval, law: str, n: int) -> int:
    """How often an interval leaves out the mean, which is 0; what gives none says nothing wrong."""
    rng = np.random.default_rng(n)
    found = (interval(LAWS[law](rng, n)) for _ in range(TRIALS))
    return sum(low is not None and not low <= 0.0 <= high for low, high in found)


def of_ours(values: np.ndarray) -> tuple[float | None, float | None]:
    found = difference(values, np.zeros(values.size), "higher")
    return found.low, found.high


def by_percentiles(values: np.ndarray) -> tuple[float, float]:
    """The plain percentile bootstrap, too short for few seeds."""
    choices = named_generator(values.size, "bootstrap").integers(values.size, size=(RESAMPLES, values.size))
    return tuple(np.quantile(values[choices].mean(axis=-1), [0.025, 0.975]))


def allowed(rate: float) -> float:
    """More are left out of TRIALS by an interval of that rate with the probability FALSE_ALARM."""
    return binom.isf(FALSE_ALARM, TRIALS, rate)


@pytest.mark.parametrize("n", [4, 10, 50])
@pytest.mark.parametrize("law", LAWS)
def test_intervals_leave_out_the_truth_no_more_often_than_they_say(law, n):
    """Measured over 2000 trials: 5.4 % at most.  Each case fails by chance with a probability of 1e-4."""
    assert left_out(of_ours, law, n) <= allowed(0.055)


@pytest.mark.parametrize(("law", "n"), [(law, 4) for law in LAWS] + [("exponential", 10), ("mostly zero", 10)])
def test_the_limit_tells_a_percentile_interval_from_an_honest_one(law, n):
    assert left_out(by_percentiles, law, n) > allowed(0.055)


@pytest.mark.parametrize("n", [8, 10, 50])
@pytest.mark.parametrize("law", ["normal", "mostly zero"])
def test_intervals_of_interquartile_means_hold_the_truth(law, n):
    """Measured: 2 to 4.5 % of normal ones, whose interquartile mean is 0 as their mean is; of rare ones it is 0."""
    shift = 0.2 if law == "mostly zero" else 0.0

    def middle(values):
        found = estimate(values + shift)
        return found.iqm_low, found.iqm_high

    assert left_out(middle, law, n) <= allowed(0.055)


@pytest.mark.parametrize(("n", "share"), [(10, 0.4), (10, 0.1), (50, 0.2), (50, 0.04)])
def test_differences_of_rates_leave_out_nothing_too_often(n, share):
    """Both sides win as often.  Measured over 2000 trials: 5.1 % at most; a case fails by chance with 1e-4."""
    rng, missed = np.random.default_rng(n), 0
    for _ in range(TRIALS):
        draw = rng.random(n)
        found = difference((draw < share) * 1.0, (draw > 1.0 - share) * 1.0, "higher", rate=True)
        missed += not found.low <= 0.0 <= found.high
    assert missed <= allowed(0.055)


def test_there_is_no_verdict_with_few_seeds():
    assert [is_clear(0.1, 0.2, n) for n in (VERDICT_SEEDS - 1, VERDICT_SEEDS)] == [False, True]
    assert not is_clear(None, None, 50)
    assert not is_clear(-0.1, 0.2, 50)


def test_intervals_move_and_scale_with_the_values():
    values = normal(30)
    one, other = estimate(values), estimate(2.0 * values + 1.0)
    assert (other.low, other.high) == pytest.approx((2.0 * one.low + 1.0, 2.0 * one.high + 1.0))


def test_rates_have_the_exact_interval():
    never, always = estimate(np.zeros(50), rate=True), estimate(np.ones(50), rate=True)
    assert (never.mean, never.low) == (0.0, 0.0)
    assert binom.cdf(0, 50, never.high) == pytest.approx(0.025)
    assert (always.low, always.high) == (pytest.approx(1.0 - never.high), 1.0)
    some = estimate(np.repeat([1.0, 0.0], [3, 47]), rate=True)
    exact = binomtest(3, 50).proportion_ci(method="exact")
    assert (some.low, some.high) == pytest.approx((exact.low, exact.high))
    assert some.iqm_low is None


def test_rates_that_agree_on_all_seeds_may_differ_on_others():
    found = difference(np.zeros(50), np.zeros(50), "lower", rate=True)
    assert found.high == -found.low == pytest.approx(t.ppf(0.975, 51) / 52)  # one differing pair is added, net 0
    apart = difference(np.ones(50), np.zeros(50), "higher", rate=True)
    assert 0.85 < apart.low < apart.difference == apart.high == 1.0


def test_seeds_that_are_alike_have_no_interval():
    for values in (np.zeros(50), np.full(50, 0.1), np.repeat([1.0, 0.0], [3, 47])):
        assert estimate(values).low is None
        assert difference(values, np.zeros(50), "lower").low is None
    nearly = np.append(np.linspace(4.0, 4.1, 7), 140.0)  # most resamples without the last know no spread to speak of
    assert estimate(nearly).low is None
    assert estimate(np.zeros(50)).iqm_low is None
    assert estimate(np.repeat([1.0, 0.0], [10, 40])).low is not None


def test_intervals_end_where_values_do():
    values = np.repeat([0.9, 0.0], [6, 44])
    free, kept = estimate(values), estimate(values, bounds=(0.0, 0.2))
    assert free.low < 0.2 < free.high
    assert (kept.low, kept.high) == (max(free.low, 0.0), 0.2)


def test_too_few_values_have_no_interval():
    assert estimate(np.array([])).mean is None
    one = estimate(np.array([4.0]))
    assert (one.mean, one.low, one.iqm, one.n) == (4.0, None, 4.0, 1)
    assert difference(np.array([]), np.array([]), None).difference is None
    assert difference(np.array([2.0]), np.array([1.0]), "higher").low is None


def test_differences_are_paired():
    theirs = normal(30)
    ours = theirs + 0.1 + 0.01 * normal(30, 2)
    found = difference(ours, theirs, "higher")
    assert found.difference == pytest.approx((ours - theirs).mean())
    assert found.high - found.low < 0.05  # the spread of the seeds is gone
    assert found.better == 1.0
    assert difference(ours, theirs, "lower").better == 0.0
    assert difference(ours, theirs, None).better is None


def test_p_values_are_those_of_scipy():
    ours, theirs = normal(30, 1), normal(30, 2)
    assert difference(ours, theirs, "lower").p == pytest.approx(ttest_rel(ours, theirs).pvalue)
    up, down = np.array([1.0] * 9 + [0.0] * 21), np.array([0.0] * 9 + [1.0, 1.0] + [0.0] * 19)
    assert difference(up, down, "lower", rate=True).p == pytest.approx(binomtest(2, 11).pvalue)
    assert difference(down, up, "lower", rate=True).p == difference(up, down, "lower", rate=True).p
    assert difference(up, up, "lower", rate=True).p == 1.0
    assert difference(up[:1], down[:1], "lower", rate=True).p is None


def test_no_p_value_is_less_than_the_signs_of_what_differs_can_give():
    few = np.zeros(2000)
    few[:4] = 50.0
    assert difference(few, 0.0 * few, "lower").p >= 2.0**-3
    assert difference(few + 1.0, 0.0 * few + 1.0, "lower").p == difference(few, 0.0 * few, "lower").p
    alike = np.full(6, 3.0)
    assert difference(alike, 0.0 * alike, "lower").p == 2.0**-5
    assert difference(alike, alike, "lower").p == 1.0


def test_holm_is_worked_out_by_hand_and_keeps_the_order():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


def test_so_many_seeds_exclude_a_rise_and_one_less_does_not():
    least = seeds_to_exclude(0.05)
    none = np.zeros(least)
    assert difference(none, none, "lower", rate=True).high <= 0.05
    assert difference(none[1:], none[1:], "lower", rate=True).high > 0.05
