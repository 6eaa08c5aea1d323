"""Overbounds and laws of errors against laws that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import genpareto

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.family.error_classes import ErrorClasses
from lanebound.integrity.monitoring.family.laws import (
    NormalMixture,
    ParetoTail,
    fit_jumps,
    fit_mixture,
    fit_normal,
    fit_pareto,
    fit_rayleigh,
)
from lanebound.integrity.monitoring.family.overbounds import BoundForm, ErrorSides, overbound


def skewed(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.where(rng.random(count) < 0.2, rng.exponential(8.0, count), rng.normal(0.0, 1.0, count))


@pytest.mark.parametrize("form", [BoundForm.CDF, BoundForm.TAIL])
@pytest.mark.parametrize("sides", list(ErrorSides))
def test_a_bound_of_the_distribution_covers_the_sample(form: BoundForm, sides: ErrorSides) -> None:
    e, tail = np.sort(skewed()), 0.25 if form is BoundForm.TAIL else 0.49
    b = overbound(e, form, sides)
    n = e.size
    for k in range(n):
        late, early = (n - k) / (n + 1.0), (k + 1) / (n + 1.0)
        if sides is not ErrorSides.EARLY and late <= tail:
            assert ndtr(-e[k] / b.sigma_m) >= late - 1.0 / (n + 1) - 1e-9
        if sides is not ErrorSides.LATE and early <= tail:
            assert ndtr(e[k] / b.sigma_m) >= early - 1e-9


def test_bounds_of_normal_errors_are_near_their_deviation_and_order_by_what_they_cover() -> None:
    e = np.random.default_rng(2).normal(0.0, 3.0, 20_000)
    for form in (BoundForm.TAIL, BoundForm.PDF):
        assert overbound(e, form, centred=True).sigma_m == pytest.approx(3.0, rel=0.25)
    late, early = (overbound(skewed(), BoundForm.TAIL, side).sigma_m for side in (ErrorSides.LATE, ErrorSides.EARLY))
    assert late > 3.0 * early
    assert overbound(skewed(), BoundForm.TAIL).sigma_m == max(late, early)
    assert overbound(skewed(), BoundForm.CDF).sigma_m >= overbound(skewed(), BoundForm.TAIL).sigma_m


def test_a_paired_bound_has_the_whole_law_between_its_centres() -> None:
    e = np.sort(skewed())
    b = overbound(e, BoundForm.PAIRED)
    f = np.arange(1, e.size + 1) / (e.size + 1.0)
    assert (ndtr((e - b.bias_m) / b.sigma_m) <= f + 1e-9).all()
    assert (ndtr((e + b.bias_m) / b.sigma_m) >= f - 1e-9).all()
    assert b.bias_m > 0.0


def test_the_density_of_a_bound_is_above_the_histogram_beyond_one_sigma() -> None:
    e = skewed()
    b = overbound(e, BoundForm.PDF)
    density, edges = np.histogram(e, bins=max(8, round(2.0 * e.size ** (1.0 / 3.0))), density=True)
    x = np.abs(0.5 * (edges[1:] + edges[:-1]))
    own = x > b.sigma_m
    bound = np.exp(-0.5 * np.square(x / b.sigma_m)) / (b.sigma_m * np.sqrt(2.0 * np.pi))
    assert (bound[own] >= density[own] * (1.0 - 1e-6)).all()


def test_mixtures_find_the_parts_that_errors_were_drawn_from() -> None:
    rng = np.random.default_rng(3)
    jump = rng.random(20_000)
    e = np.where(jump < 0.7, rng.normal(0, 1, 20_000), np.where(jump < 0.85, rng.normal(12, 1, 20_000),
                 rng.normal(0, 6, 20_000)))  # fmt: skip
    law = fit_jumps(e)
    np.testing.assert_allclose(law.share, [0.7, 0.15, 0.15], atol=0.03)
    assert law.mean_m[1] == pytest.approx(12.0, abs=0.3)
    np.testing.assert_allclose(law.sigma_m, [1.0, 1.0, 6.0], rtol=0.1)
    assert law.criterion(e) < fit_mixture(e, 2).criterion(e) < fit_normal(e).criterion(e)
    assert law.quantile_m(0.01) == pytest.approx(np.quantile(np.abs(e), 0.99), rel=0.05)


def test_a_mixture_of_one_is_the_normal_law() -> None:
    law = NormalMixture(np.ones(1), np.zeros(1), np.array([2.0]), 2)
    assert law.quantile_m(0.0455003) == pytest.approx(4.0, rel=1e-5)
    assert np.exp(law.log_density(0.0)) == pytest.approx(1.0 / (2.0 * np.sqrt(2.0 * np.pi)))


def test_position_laws_find_their_parameters() -> None:
    rng = np.random.default_rng(4)
    assert fit_rayleigh(rng.rayleigh(2.5, 50_000)) == pytest.approx(2.5, rel=0.02)
    sizes = genpareto.rvs(0.25, scale=1.5, size=50_000, random_state=rng)
    tail = fit_pareto(sizes, 1.0 - 1e-9)
    assert tail.shape == pytest.approx(0.25, abs=0.05)
    assert tail.scale == pytest.approx(1.5, rel=0.05)
    part = fit_pareto(sizes, 0.2)
    assert part.quantile(0.01) == pytest.approx(genpareto.isf(0.01, 0.25, scale=1.5), rel=0.05)
    assert ParetoTail(1.0, 0.5, 2.0, 0.0).quantile(0.5 * np.exp(-3.0)) == pytest.approx(7.0)
    assert ParetoTail(1.0, 0.5, 2.0, 0.3).quantile(0.9) == 1.0


def test_classes_look_up_by_strength_elevation_and_path() -> None:
    laws = [{"sigma_m": float(k + 1), "centre_m": -float(k)} for k in range(8)]
    table = ErrorClasses.load({
        "cn0_edges_dbhz": [0.0, 35.0, 60.0], "elevation_edges_deg": [0.0, 30.0, 90.0],
        "paths": ["direct", "shadowed"], "laws": laws,
    })  # fmt: skip
    centre, sigma = table.at([20.0, 99.0, 35.0], np.radians([10.0, 95.0, 31.0]), [True, False, False])
    np.testing.assert_allclose(sigma, [2.0, 7.0, 7.0])
    np.testing.assert_allclose(centre, [-1.0, -6.0, -6.0])
    with pytest.raises(ConfigError, match="laws must have 4 entries"):
        ErrorClasses.load({"cn0_edges_dbhz": [0.0, 35.0, 60.0], "elevation_edges_deg": [0.0, 30.0, 90.0]})


def test_too_few_errors_are_refused() -> None:
    with pytest.raises(InputError, match="10 errors or more, got 3"):
        overbound(np.ones(3))
    with pytest.raises(InputError, match="5 errors or more"):
        fit_normal(np.ones(2))
