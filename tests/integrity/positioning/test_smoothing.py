"""Carrier smoothing against a direct form of its recursion."""

from __future__ import annotations

import numpy as np
import pytest

from lanebound.integrity.positioning.smoothing_kernel import HATCH, smooth


def _run(code: np.ndarray, phase: np.ndarray, locked: np.ndarray, most: float, gate: float = 1e9) -> np.ndarray:
    hatch = np.zeros(1, HATCH)[0]
    return np.array(
        [smooth(c, p, bool(k), most, gate, 0.9, hatch) for c, p, k in zip(code, phase, locked, strict=True)]
    )


def test_it_is_the_recursion_of_hatch() -> None:
    rng = np.random.default_rng(1)
    truth = np.cumsum(rng.normal(size=400))
    code, phase = truth + rng.normal(size=400), truth + 17.3 + 0.003 * rng.normal(size=400)
    most, last = 50.0, 0.0
    found = _run(code, phase, np.ones(400, bool), most)
    for k in range(400):  # (1/n) code + (1 - 1/n) (last + change of phase), as printed by Hatch
        n = min(k + 1.0, most)
        last = code[k] / n + (0.0 if k == 0 else (n - 1.0) / n * (last + phase[k] - phase[k - 1]))
        assert found[k] == pytest.approx(last, abs=1e-9)
    assert (found - truth)[60:].std() < 0.25 * (code - truth)[60:].std()


def test_it_begins_anew_without_a_carrier_and_after_a_slip_beyond_the_gate() -> None:
    code, phase = np.zeros(30), np.full(30, 5.0)
    locked = np.ones(30, bool)
    locked[10] = False
    code[10:], phase[20:] = 1.0, 9.0  # the code moves while the carrier is lost, the carrier slips by 4 m
    found = _run(code, phase, locked, 100.0, gate=2.0)
    np.testing.assert_allclose(found, code)


def test_an_ionosphere_that_drifts_moves_it_by_twice_its_change_in_a_time_constant() -> None:
    drift, n = 1e-3, 200.0
    iono = drift * np.arange(4000)
    found = _run(iono, -iono, np.ones(4000, bool), n)
    assert found[-1] - iono[-1] == pytest.approx(-2.0 * drift * (n - 1.0), rel=1e-6)


def test_the_age_of_the_mean_tells_the_lag_by_a_drift() -> None:
    hatch, rate = np.zeros(1, HATCH)[0], 0.01
    for k in range(200):
        found = smooth(rate * k, -rate * k, True, 40.0, 1e9, 0.9, hatch)  # code and carrier apart by twice the rate
        assert found - rate * k == pytest.approx(-2.0 * rate * hatch["age"], abs=1e-9)
    assert hatch["age"] == pytest.approx(39.0, abs=0.5)  # of a time constant of 40 epochs
