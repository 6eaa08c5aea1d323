"""Danish re-weighting."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.danish import DanishConfig, variance_factor


def test_what_fits_keeps_its_weight_and_what_does_not_loses_it() -> None:
    factor = variance_factor([0.0, 1.5, -1.5, 3.0, -3.0, 1e9], DanishConfig())
    np.testing.assert_allclose(factor, [1.0, 1.0, 1.0, np.exp(3.0), np.exp(3.0), 1e3])


def test_outliers_of_a_mean_are_met_without_naming_them() -> None:
    rng = np.random.default_rng(3)
    y = rng.normal(5.0, 1.0, 60)
    y[:18] += rng.uniform(20.0, 60.0, 18)  # three in ten are late
    config, mean, factor = DanishConfig(iterations=30), np.median(y), np.ones(60)
    for _ in range(config.iterations):
        factor = variance_factor(y - mean, config)
        mean = float((y / factor).sum() / (1.0 / factor).sum())
    assert abs(mean - 5.0) < 4.0 / np.sqrt(42)
    assert (factor[:18] > 100.0).all()


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="threshold must be > 0"):
        DanishConfig(threshold=0.0)
