"""Gaussian bounds of one-sided errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.replay.training import CodeErrors, fit_overbound, gaussian_bound, lasting_s


def test_a_normal_sample_is_bounded_by_about_itself() -> None:
    error = 7.0 + 3.0 * ndtri((np.arange(2000) + 1) / 2001.0)  # its own quantiles, no luck of the draw
    centre, sigma = gaussian_bound(error)
    assert centre == pytest.approx(7.0, abs=0.01)
    assert sigma == pytest.approx(3.0, rel=1e-3)


def test_both_tails_of_a_one_sided_law_are_inside_and_the_bound_is_tight() -> None:
    error = np.random.default_rng(1).exponential(20.0, 3000) - 2.0
    centre, sigma = gaussian_bound(error)
    assert centre > np.median(error)  # late errors pull the centre
    ordered, n = np.sort(error), error.size
    rank = np.arange(1, n // 4)
    z = -ndtri(rank / (n + 1.0))
    assert (ordered[rank - 1] >= centre - sigma * z - 1e-9).all()
    assert (ordered[::-1][rank - 1] <= centre + sigma * z + 1e-9).all()
    touched = (ordered[::-1][rank - 1] >= centre + 0.999 * sigma * z - 1e-9).any()
    assert touched


def test_a_share_left_out_tightens() -> None:
    error = np.concatenate([np.random.default_rng(2).normal(0.0, 2.0, 980), np.full(20, 200.0)])
    assert gaussian_bound(error)[1] > 20.0
    assert gaussian_bound(error, 0.03)[1] < 3.0


def test_how_long_errors_last() -> None:
    rng, t = np.random.default_rng(5), np.arange(0.0, 2000.0, 1.0)
    value = np.zeros(t.size)
    for i in range(1, t.size):
        value[i] = np.exp(-1.0 / 12.0) * value[i - 1] + np.sqrt(1 - np.exp(-2.0 / 12.0)) * rng.normal()
    assert 8.0 <= lasting_s(t, np.zeros(t.size, np.int64), value) <= 18.0
    assert lasting_s(t, np.zeros(t.size, np.int64), np.ones(t.size)) == 60.0


def test_bounds_by_cn0_never_shrink_with_weaker_signals() -> None:
    rng = np.random.default_rng(6)
    cn0 = rng.uniform(25.0, 52.0, 4000)
    error = np.where(cn0 < 40.0, rng.exponential(30.0, 4000), rng.normal(0.0, 3.0, 4000))
    found = fit_overbound(error, cn0, np.arange(4000.0), np.zeros(4000, np.int64))
    assert (np.diff(found.sigma_m) <= 0.0).all()
    centre, sigma = found.at([10.0, 60.0])
    assert sigma[0] == found.sigma_m[0]
    assert centre[1] == found.centre_m[-1]
    assert sigma[0] > 5.0 * sigma[1]


def test_too_little_to_fit_is_refused() -> None:
    with pytest.raises(InputError, match="25 errors of one C/N0 class"):
        fit_overbound(np.zeros(3), np.full(3, 40.0), np.zeros(3), np.zeros(3, np.int64))
    with pytest.raises(InputError, match="at least 2"):
        gaussian_bound([1.0])


def test_knots_are_interpolated() -> None:
    errors = CodeErrors(np.array([30.0, 40.0]), np.array([10.0, 0.0]), np.array([8.0, 4.0]), 1.0)
    assert errors.at(35.0) == (5.0, 6.0)
