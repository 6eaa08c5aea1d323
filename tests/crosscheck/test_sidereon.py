"""Against the independent package sidereon (pip install sidereon==3.0.4); passed over where it is not installed."""

from __future__ import annotations

import numpy as np
import pytest
from navigation_texts import GPS_RECORD, HEADER
from plain_araim import araim

from lanebound.agents.bench.positioning import Araim
from lanebound.integrity.monitoring.araim import AraimConfig
from lanebound.integrity.positioning.least_squares import design_matrix
from lanebound.integrity.sky.broadcast import parse_navigation
from plain_ambiguity import integer_least_squares
from plain_least_squares import dilution

sidereon = pytest.importorskip("sidereon", reason="the independent package sidereon is not installed")


def sky(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    elevation, azimuth = np.arcsin(rng.uniform(0.14, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.cos(elevation)
    return np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)


@pytest.mark.parametrize("seed", range(100))
def test_araim_levels(seed: int) -> None:
    """Random geometries. Its vertical root is solved to about 1e-3 m, its horizontal one to 0.05 m from above.

    Both monitor one event at a time. Constellations fail with 1e-6: with 1e-4 what is not monitored takes up the risk.
    Sidereon has no level from 8e-8 of it on, ours subtracts it from 1e-7.
    """
    rng = np.random.default_rng([20261125, seed])
    n, systems = int(rng.integers(10, 31)), int(rng.integers(2, 5))
    los, group = sky(seed, n), np.arange(n) % min(systems, n // 5)
    variance, bias = rng.uniform(0.5, 3.0, n), rng.uniform(0.2, 0.8, n)
    accuracy = 0.7 * variance
    theirs = Araim(los, group, variance, accuracy, bias, constellation_prior=1e-6).solve()
    ours = araim(los[None], group, variance, accuracy, bias, AraimConfig(at_once=1, constellation_prior=1e-6))
    assert np.isfinite(theirs.vpl_m)
    assert ours.vpl_m[0] == pytest.approx(theirs.vpl_m, abs=5e-3)
    assert -1e-3 < theirs.hpl_m - ours.hpl_m[0] < 0.08
    assert ours.emt_m[0] == pytest.approx(theirs.emt_m, rel=1e-6)
    assert ours.sigma_v_acc_m[0] == pytest.approx(theirs.sigma_acc_v_m, rel=1e-6)


@pytest.mark.parametrize("n", [3, 8, 14, 20])
def test_integer_least_squares(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(5):
        root = rng.standard_normal((n, n))
        covariance = 0.1 * (root @ root.T) + 0.01 * np.eye(n)
        real = rng.uniform(-50.0, 50.0, n)
        theirs, ours = sidereon.lambda_ils_search(real, covariance), integer_least_squares(real, covariance)
        np.testing.assert_array_equal(theirs.fixed, ours.candidates[0])
        np.testing.assert_allclose([theirs.best_score, theirs.second_best_score], ours.norms, rtol=1e-6)


def test_dilution_of_precision() -> None:
    los = sky(9, 12)
    theirs = sidereon.gnss_dop(los[:, [2, 0, 1]].copy(), np.ones(12), sidereon.Wgs84Geodetic(0.0, 0.0, 0.0))
    ours = dilution(design_matrix(los, np.zeros(12, np.int64), 1), np.eye(12))
    assert ours.hdop == pytest.approx(theirs.hdop, rel=1e-9)
    assert ours.pdop == pytest.approx(theirs.pdop, rel=1e-9)


def test_navigation_records() -> None:
    theirs, ours = sidereon.parse_rinex_nav(HEADER + GPS_RECORD), parse_navigation(HEADER + GPS_RECORD)
    assert theirs.record_count == len(ours) == 1
    assert theirs.records[0].satellite == "G04"
    assert theirs.records[0].toe_tow_s == ours.toe_of_week_s[0]
    assert theirs.records[0].group_delay_s == ours.group_delay_s[0, 0]
