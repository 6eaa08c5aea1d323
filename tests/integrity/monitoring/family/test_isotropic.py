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


def test_the_level_is_conservative_in_other_geometries() -> None:
    found = watch(quiet(20_000, 8, 1, 5), monitor_named("ibpl").config(), 0.01)
    beyond = (np.hypot(*found.position_enu_m[:, :2].T) > found.hpl_m[:, 0]).mean()
    assert beyond < 0.01
