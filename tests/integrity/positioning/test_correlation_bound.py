"""A Gauss-Markov error and a white one bound Gauss-Markov errors of every correlation time in a range."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.correlation import bound_correlation
from lanebound.integrity.positioning.motion_config import DopplerConfig

DT = 0.1
RANGES = [(0.1, 10.0), (0.5, 0.5), (0.05, 1.0), (2.0, 30.0)]


def _covariance(decay: float, epochs: int) -> np.ndarray:
    return np.asarray(toeplitz(decay ** np.arange(epochs)))


@pytest.mark.parametrize("times", RANGES)
def test_it_bounds_every_correlation_time_for_every_linear_filter(times: tuple[float, float]) -> None:
    bound, epochs = bound_correlation(*times, DT), 400
    joint = _covariance(bound.decay, epochs) + bound.white * np.eye(epochs)
    for tau in np.geomspace(*times, 9):
        true = _covariance(float(np.exp(-DT / tau)), epochs)
        assert np.linalg.eigvalsh(joint - true).min() > -1e-9
        assert np.linalg.eigvalsh(bound.course * np.eye(epochs) - true).min() > -1e-9
    assert np.linalg.eigvalsh(bound.course * np.eye(epochs) - joint).min() > -1e-9


def test_the_longest_correlation_time_alone_is_no_bound() -> None:
    """A filter that looks at changes, as a turn does, sees more of a shorter correlation time."""
    bound = bound_correlation(0.1, 10.0, DT)
    lacking = _covariance(bound.decay, 400) - _covariance(float(np.exp(-DT / 1.0)), 400)
    assert np.linalg.eigvalsh(lacking).min() < -1.0


def test_one_known_time_needs_no_white_part() -> None:
    bound = bound_correlation(0.54, 0.54, DT)
    assert bound.white == pytest.approx(0.0, abs=1e-12)
    assert bound.decay == pytest.approx(np.exp(-DT / 0.54))
    assert bound.course == pytest.approx((1.0 + bound.decay) / (1.0 - bound.decay))


def test_the_white_part_of_a_wide_range_has_its_closed_form() -> None:
    bound = bound_correlation(0.1, 100.0, DT)
    assert bound.white == pytest.approx(0.1349 * 100.0 / DT, rel=2e-3)


@pytest.mark.parametrize("times", [(0.0, 1.0), (2.0, 1.0)])
def test_a_range_that_does_not_ascend_is_refused(times: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="tau_range_s"):
        DopplerConfig(tau_range_s=times)
