"""Errors of a window: the bound of errors whose correlation time is not known."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.replay.window import ErrorCourse

AGE_S = np.arange(40.0)


@pytest.mark.parametrize("tau_s", [1.0, 3.0, 10.0, 30.0, 60.0])
def test_every_linear_estimate_has_at_most_the_variance_of_the_bound(tau_s: float) -> None:
    bound = ErrorCourse.between(1.0, 60.0, 1.0).correlation(AGE_S)
    own = ErrorCourse(tau_s).correlation(AGE_S)
    assert np.linalg.eigvalsh(bound - own).min() > -1e-9


def test_a_single_correlation_time_needs_no_white_part() -> None:
    course = ErrorCourse.between(60.0, 60.0, 1.0)
    assert course.white == pytest.approx(0.0, abs=1e-6)
    assert ErrorCourse.between(100.0, 60.0, 1.0) == course
    assert ErrorCourse.between(1.0, 0.0, 1.0) == ErrorCourse(0.0)
    np.testing.assert_array_equal(ErrorCourse(0.0).correlation(AGE_S), np.eye(40))


def test_jumps_between_two_paths_are_bounded_and_a_long_correlation_alone_fails() -> None:
    """A code that jumps every 5 s in the mean, by -1 to 1: the slope over 40 s, which turns the heading of a window."""
    rng, runs = np.random.default_rng(2), 20_000
    jumps = rng.random((runs, 40)) < 0.5 * (1.0 - np.exp(-2.0 / 5.0))  # odd numbers of jumps in a second
    error = rng.choice([-1.0, 1.0], (runs, 1)) * np.cumprod(np.where(jumps, -1.0, 1.0), axis=1)
    design = np.stack([np.ones(40), AGE_S], -1)
    for course, holds in ((ErrorCourse.between(1.0, 60.0, 1.0), True), (ErrorCourse(60.0), False)):
        inverse = np.linalg.inv(course.correlation(AGE_S))
        cofactor = np.linalg.inv(design.T @ inverse @ design)
        slope = error @ (cofactor @ design.T @ inverse)[1]
        assert (slope.var() < cofactor[1, 1]) == holds
