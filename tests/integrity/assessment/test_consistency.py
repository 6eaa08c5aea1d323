"""Estimators are as good as they say: normalised squared errors and innovations, and detectable biases as in theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2
from signed_w import w_statistics

from lanebound.integrity.assessment.drift_model import DriftConfig, Outage, draw_drift
from lanebound.integrity.assessment.exceedance import Case, draw_case
from lanebound.integrity.monitoring.detection import (
    adjust,
    diagonal_covariance,
    minimal_detectable_bias,
    normal_threshold,
)
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.monitoring.significance import noncentrality
from lanebound.integrity.positioning.least_squares import design_matrix
from plain_least_squares import solve

TAIL = 5e-5  # each band is left by chance once in 10,000 runs
NO_BIAS = DriftConfig(doppler_bias_mps=0.0, odometer_bias_mps=0.0, heading_bias_deg=0.0)


def geometry(satellites: int, seed: int) -> tuple[Case, np.ndarray, np.ndarray]:
    case = draw_case(np.random.default_rng(seed), satellites, 0.0)
    return case, design_matrix(case.los_enu, case.group, int(case.group.max()) + 1), np.diag(case.sigma_m**2)


@pytest.mark.parametrize("satellites", [6, 12, 25, 35])
def test_least_squares_errors_and_residuals_are_chi_square(satellites: int) -> None:
    """NEES of the position with 3 degrees of freedom, and ``e'We`` with those of the redundancy, each as a sum."""
    case, design, covariance = geometry(satellites, satellites)
    runs = 2000
    y = case.sigma_m * np.random.default_rng(1).standard_normal((runs, satellites))
    found = solve(design, covariance, y)
    error = found.estimate[:, :3]
    inverse = np.linalg.inv(found.gain.cofactor[..., :3, :3])
    nees = np.einsum("ri,...ij,rj->r", error, inverse.reshape(-1, 3, 3)[0], error)
    for statistic, freedom in ((nees, 3), (found.chi2, satellites - design.shape[1])):
        low, high = chi2.ppf([TAIL, 1.0 - TAIL], runs * freedom)
        assert low < statistic.sum() < high


@pytest.mark.parametrize("source", ["doppler", "odometer"])
@pytest.mark.parametrize("length_s", [1.0, 10.0])
def test_errors_between_fixes_are_chi_square(source: str, length_s: float) -> None:
    """NEES of the position at the end of an outage, two degrees of freedom; the printed growth is far outside."""
    vehicles = 4000
    outage = Outage(source, length_s, 8.0, 1.0, -0.05)  # type: ignore[arg-type]
    error, growths, _ = draw_drift(outage, NO_BIAS, vehicles, np.random.default_rng(2))
    sums = {}
    for variant, growth in growths.items():
        inverse = np.linalg.inv(growth.position_covariance_m2.reshape(2, 2))
        sums[variant] = np.einsum("ri,ij,rj->r", error, inverse, error).sum()
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], 2 * vehicles)
    assert low < sums[Variant.EXACT] < high
    assert sums[Variant.PUBLISHED] > 1.3 * high


@pytest.mark.parametrize("power", [0.5, 0.8, 0.95])
def test_minimal_detectable_biases_are_found_as_often_as_promised(power: float) -> None:
    """A bias of that size in each of some satellites, by the w-test at 1e-3; counts are binomial."""
    alpha, runs, rng = 1e-3, 4000, np.random.default_rng(3)
    case, design, _ = geometry(14, 7)
    covariance = diagonal_covariance(case.sigma_m**2)
    smallest = minimal_detectable_bias(adjust(design, covariance, np.zeros(14)), noncentrality(alpha, power))
    noise = case.sigma_m * rng.standard_normal((runs, 14))
    for k in range(0, 14, 3):
        found = np.abs(w_statistics(adjust(design, covariance, noise + smallest[k] * (np.arange(14) == k))))[:, k]
        count = int((found > normal_threshold(0.5 * alpha)).sum())
        low, high = binom.ppf(TAIL, runs, power), binom.isf(TAIL, runs, power)
        assert low <= count <= high
