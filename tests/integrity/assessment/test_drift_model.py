"""Errors between fixes have the covariance that the levels assume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from lanebound.integrity.assessment.drift_model import DriftConfig, Outage, drift_exceedance
from lanebound.integrity.monitoring.risk import Variant

NO_BIAS = DriftConfig(doppler_bias_mps=0.0, odometer_bias_mps=0.0, heading_bias_deg=0.0)


@pytest.mark.parametrize("source", ["doppler", "odometer"])
@pytest.mark.parametrize("length_s", [0.1, 3.0, 12.0])
def test_without_biases_the_exact_level_is_exact(source: str, length_s: float) -> None:
    """Each axis' count is binomial with half the risk; 12 of them fail by chance once in 1,000 runs."""
    outage = Outage(source, length_s, 9.0, 0.4, 0.05)  # type: ignore[arg-type]
    found = drift_exceedance(outage, NO_BIAS, [0.1], 20_000, np.random.default_rng(3))[Variant.EXACT]
    low, high = binom.ppf(4e-5, 20_000, 0.05), binom.isf(4e-5, 20_000, 0.05)
    assert ((found[0, :2] >= low) & (found[0, :2] <= high)).all()


@pytest.mark.parametrize("source", ["doppler", "odometer"])
def test_biases_at_their_bounds_use_up_their_share(source: str) -> None:
    outage = Outage(source, 8.0, 12.0, -2.0, 0.0)  # type: ignore[arg-type]
    found = drift_exceedance(outage, DriftConfig(), [0.1], 20_000, np.random.default_rng(4))
    exact, printed = found[Variant.EXACT][0], found[Variant.PUBLISHED][0]
    assert exact[0] > 100  # along track the bias is at its bound: one side uses half of the risk
    assert (exact[:2] <= binom.isf(1e-4, 20_000, 0.05)).all()
    assert (printed[:2] > 5 * 0.05 * 20_000).all()
