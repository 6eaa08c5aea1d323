"""The stated variance of a smoothed code against the mean of a simulated Gauss-Markov error."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.positioning.smoothing_kernel import HATCH, smooth


def _shares(decays: np.ndarray, most: float) -> np.ndarray:
    """(white, lasting) that remain after each epoch."""
    hatch, found = np.zeros(1, HATCH), []
    for decay in decays:
        smooth(1.0, 1.0, True, most, 10.0, float(decay), hatch[0])
        found.append((hatch[0]["white"], hatch[0]["lasting"]))
    return np.array(found)


@pytest.mark.parametrize(("most", "rest"), [(np.inf, 0), (np.inf, 600), (100.0, 600)])
def test_the_variance_of_a_mean_is_that_of_simulated_errors(most: float, rest: int) -> None:
    """1,000 epochs of 0.1 s, correlated over 3 s in motion and 300 s at rest; 20,000 runs, 5 sigma."""
    rng, runs, epochs = np.random.default_rng(4), 20000, 1000
    decays = np.where(np.arange(epochs) < epochs - rest, np.exp(-0.1 / 3.0), np.exp(-0.1 / 300.0))
    stated = _shares(decays, most)
    error, noise, mean, of_noise = rng.standard_normal(runs), np.zeros(runs), np.zeros(runs), np.zeros(runs)
    for k, decay in enumerate(decays):
        error = decay * error + np.sqrt(1.0 - decay**2) * rng.standard_normal(runs)
        noise = rng.standard_normal(runs)
        gain = 1.0 / min(k + 1, most)
        mean += gain * (error - mean)
        of_noise += gain * (noise - of_noise)
    assert np.mean(mean**2) == pytest.approx(stated[-1, 1], rel=0.05)
    assert np.mean(of_noise**2) == pytest.approx(stated[-1, 0], rel=0.05)


def test_at_rest_multipath_does_not_average_out() -> None:
    """A minute at rest leaves nearly the whole variance; a minute in motion a tenth."""
    moving, rest = (_shares(np.full(600, np.exp(-0.1 / tau)), np.inf)[-1, 1] for tau in (3.0, 300.0))
    assert moving == pytest.approx(2.0 * 3.0 / 60.0, rel=0.06)
    assert 0.9 < rest < 1.0
    longer = _shares(np.full(600, np.exp(-0.1 / 10.0)), np.inf)[-1, 1]
    assert longer > moving  # the longest correlation bounds shorter ones
