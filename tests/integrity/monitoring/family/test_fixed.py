"""CRAIM: the level of fixed carriers at the risk that the fix leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from code_geometry import quiet, with_everything
from scipy.stats import binom

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.kinds import monitor_named
from lanebound.integrity.monitoring.family.monitor import watch
from lanebound.integrity.monitoring.family.outcome import MonitorOutcome
from lanebound.integrity.navigators.navigator import NavigatorConfig

CONFIG = monitor_named("craim").config()
LAMBDA_M = 0.19


def fixed(epochs: int = 50, risk: float = 0.0, seed: int = 61) -> CodeEpochs:
    """Epochs of two systems with fixed carriers of 1 cm."""
    e = with_everything(quiet(epochs, 12, 2, seed), seed)
    return replace(e, fix_risk=np.full(epochs, risk))


def test_without_risk_of_the_fix_it_is_separation_of_carriers() -> None:
    e = fixed()
    found = watch(e, CONFIG, [1e-3, 1e-5])
    rows = CodeEpochs.of(e.fixed_m, e.los_enu, e.fixed_sigma_m, e.fixed_kept, e.system)
    plain = watch(rows, monitor_named("separation_fde").config(), [1e-3, 1e-5])
    np.testing.assert_allclose(found.hpl_m[plain.usable], plain.hpl_m[plain.usable], rtol=1e-12)
    np.testing.assert_allclose(found.position_enu_m, solve_codes(rows).x_m, atol=0.02)
    assert found.hpl_m.max() < 0.3


def test_the_risk_of_the_fix_is_spent_first() -> None:
    levels = [watch(fixed(5, risk), CONFIG, 1e-5).hpl_m[:, 0] for risk in (0.0, 5e-6, 9.9e-6, 1e-5, 1e-3)]
    assert (levels[1] > levels[0]).all()
    assert (levels[2] > levels[1]).all()
    assert np.isinf(levels[3]).all()
    assert np.isinf(levels[4]).all()
    half = watch(fixed(5), CONFIG, 5e-6).hpl_m[:, 0]
    np.testing.assert_allclose(levels[1], half, rtol=1e-9)  # what remains of 1e-5


def test_a_wrong_integer_is_excluded_and_noise_stays_within_the_level() -> None:
    """3,000 epochs of which each has one carrier off by a cycle; at 1e-2 a bound that fails by chance once in 1,000."""
    e, rng = fixed(3000), np.random.default_rng(7)
    fixed_m = e.fixed_m.copy()
    fixed_m[np.arange(3000), rng.integers(12, size=3000)] += LAMBDA_M
    found = watch(replace(e, fixed_m=fixed_m), CONFIG, 1e-2)
    error = np.hypot(*found.position_enu_m[:, :2].T)
    assert found.usable.mean() > 0.9
    assert (error[found.usable] > found.hpl_m[found.usable, 0]).sum() <= binom.ppf(0.999, 3000, 1e-2)
    assert np.median(error[found.usable]) < 0.02
    out = found.excluded & found.usable[:, None]
    assert (out.sum(-1)[found.usable] >= 1).mean() > 0.99  # carriers, though all codes are right
    assert not (found.used & found.excluded).any()
    assert (found.outcome[out.any(-1)] == MonitorOutcome.EXCLUDED.code).all()


def test_without_a_fix_there_is_no_level_and_without_the_fields_an_error() -> None:
    e = fixed(4)
    kept = e.fixed_kept.copy()
    kept[1] = False
    found = watch(replace(e, fixed_kept=kept), CONFIG, 1e-3)
    assert found.outcome[1] == MonitorOutcome.NO_REDUNDANCY.code
    assert found.usable[[0, 2, 3]].all()
    with pytest.raises(InputError, match="fixed_m must be known"):
        watch(quiet(2), CONFIG, 1e-3)
    with pytest.raises(ConfigError, match="rtk_reckoning"):
        NavigatorConfig.load({"kind": "monitored_codes", "monitor": {"kind": "craim"}})
