"""Means with intervals: closed forms, invariances, and how often an interval holds the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, trim_mean

from lanebound.agents.benchmark.statistics import RESAMPLES, difference, estimate, interquartile_mean


def normal(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(3.0, 2.0, n)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 50])
def test_interquartile_mean_is_that_of_scipy(n):
    values = normal(n)
    assert interquartile_mean(values) == pytest.approx(trim_mean(values, 0.25))
    assert interquartile_mean(np.stack([values, values + 1.0])) == pytest.approx(
        trim_mean(values, 0.25) + np.arange(2.0)
    )


def test_the_bootstrap_is_that_of_a_plain_loop():
    from lanebound.integrity.streams import named_generator

    values = normal(20)
    rng = named_generator(20, "bootstrap")
    means = [values[row].mean() for row in rng.integers(20, size=(RESAMPLES, 20))]
    found = estimate(values)
    assert (found.low, found.high) == pytest.approx(np.quantile(means, [0.025, 0.975]))
    assert found.mean == pytest.approx(values.mean())
    assert found.iqm_low < found.iqm < found.iqm_high


def test_for_many_seeds_the_interval_is_that_of_the_normal_distribution():
    values = normal(400)
    found = estimate(values)
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20.0, rel=0.1)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    held = sum(found.low < 3.0 < found.high for found in (estimate(normal(40, seed)) for seed in range(200)))
    assert (
        binom.cdf(held, 200, 0.93) > 1e-4
    )  # percentile intervals of 40 are a little short of 95 %; fails by chance 1e-4


def test_intervals_move_and_scale_with_the_values():
    values = normal(30)
    one, other = estimate(values), estimate(2.0 * values + 1.0)
    assert (other.low, other.high) == pytest.approx((2.0 * one.low + 1.0, 2.0 * one.high + 1.0))


def test_a_rate_without_exceptions_is_not_certain():
    never, always = estimate(np.zeros(50), rate=True), estimate(np.ones(50), rate=True)
    assert (never.mean, never.low) == (0.0, 0.0)
    assert binom.cdf(0, 50, never.high) == pytest.approx(0.025)
    assert (always.low, always.high) == (pytest.approx(1.0 - never.high), 1.0)
    assert estimate(np.zeros(50)).high == 0.0


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
