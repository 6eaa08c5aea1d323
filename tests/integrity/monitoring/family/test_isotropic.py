"""IBPL: factors of house equations 7, and exceedances of isotropic errors equal to the risk."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import quiet, ring
from scipy.stats import binom, f

from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.levels import isotropic_factor
from lanebound.integrity.monitoring.family.monitor import watch


def test_factors_at_a_risk_of_one_in_a_thousand() -> None:
    k = isotropic_factor(np.array([6, 2, 0]), np.array([1e-3]))[:, 0]
    assert k[0] == pytest.approx(3.0, abs=1e-12)
    assert k[1] == pytest.approx(np.sqrt(999.0), rel=1e-12)  # 31.6
    assert np.isinf(k[2])
    for df in (1, 3, 9):  # the closed form is the quantile of F(2, N - n)
        wanted = np.sqrt(2.0 / df * f.isf(1e-3, 2, df))
        assert isotropic_factor(np.array([df]), np.array([1e-3]))[0, 0] == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("heavy", [False, True])
def test_exceedances_of_isotropic_errors_in_a_circular_geometry_equal_the_risk(heavy: bool) -> None:
    rng, trials, risk = np.random.default_rng(3), 40_000, 0.01
    y = rng.normal(size=(trials, 9))
    if heavy:  # any scale: the errors of an epoch share a factor over four decades
        y *= 10.0 ** rng.uniform(-2.0, 2.0, (trials, 1))
    found = watch(CodeEpochs.of(y, ring(9, trials)), monitor_named("ibpl").config(), risk)
    beyond = int((np.hypot(*found.position_enu_m[:, :2].T) > found.hpl_m[:, 0]).sum())
    low, high = binom.ppf([5e-4, 1 - 5e-4], trials, risk)
    assert low <= beyond <= high


def test_the_published_level_is_k_r_hdop_and_the_exact_one_has_the_largest_deviation() -> None:
    """S3 eq 15 by a plain solution of one epoch, weights of 1 m."""
    epochs, risk = quiet(50, 8, 1, 5), np.array([1e-3])
    exact, published = (
        watch(epochs, monitor_named(name).config({"vertical": True}), 1e-3) for name in ("ibpl", "ibpl_published")
    )
    for e in range(50):
        sigma = epochs.sigma_m[e]
        design = np.column_stack([-epochs.los_enu[e], np.ones(8)]) / sigma[:, None]
        cov = np.linalg.inv(design.T @ design)
        whitened = epochs.y_m[e] / sigma
        residual = whitened - design @ (cov @ design.T @ whitened)
        k = isotropic_factor(np.array([8 - 4]), risk)[0, 0]
        hdop, major = np.sqrt(np.trace(cov[:2, :2])), np.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1])
        assert published.hpl_m[e, 0] == pytest.approx(k * np.linalg.norm(residual) * hdop, rel=1e-9)
        assert exact.hpl_m[e, 0] == pytest.approx(k * np.linalg.norm(residual) * major, rel=1e-9)
    ratio = exact.hpl_m / published.hpl_m
    assert (ratio >= np.sqrt(0.5) - 1e-12).all()
    assert (ratio < 1.0).all()
    np.testing.assert_array_equal(exact.vpl_m, published.vpl_m)


def test_the_level_is_conservative_in_other_geometries() -> None:
    found = watch(quiet(20_000, 8, 1, 5), monitor_named("ibpl").config(), 0.01)
    beyond = (np.hypot(*found.position_enu_m[:, :2].T) > found.hpl_m[:, 0]).mean()
    assert beyond < 0.01
