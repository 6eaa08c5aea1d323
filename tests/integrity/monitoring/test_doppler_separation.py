"""Positions from velocities without one satellite: oracle by leaving out rows, statistics, factors."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from signal_records import records_of, rows_of

from lanebound.integrity.core.records import Records
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.monitoring import doppler_separation_kernel as dk
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import FAULT
from lanebound.integrity.positioning.rtk_kernel import SATELLITE

Array = NDArray[np.float64]
DT, PHI, WHITE = 0.1, float(np.exp(-0.1 / 0.54)), 0.5
SYSTEM = np.array([0, 0, 0, 0, 0, 2, 2])
MODES = 7 + 3  # satellites, then systems
PRIOR = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-8, 1e-4, 1e-4])
ALL = np.ones(7, dtype=np.bool_)
EACH = [np.arange(7) == k for k in range(7)] + [g == SYSTEM for g in range(3)]  # satellites of each mode


def _sky(seed: int = 3) -> tuple[Array, Array]:
    """Unit vectors (7, 3) and variances (7,) of range rates."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.linspace(0.0, 5.4, 7), rng.uniform(0.3, 1.3, 7)
    c = np.cos(elevation)
    los = np.column_stack([np.sin(azimuth) * c, np.cos(azimuth) * c, np.sin(elevation)])
    return los, rng.uniform(0.5, 2.0, 7) * 0.01


def _velocity(los: Array, variance: Array, y: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Weighted least squares with a clock drift: velocity (3,) and covariance (3, 3)."""
    design = np.column_stack([-los, np.ones(len(los))])[used]
    inverse = np.linalg.inv(design.T @ (design / variance[used, None]))
    return (inverse @ design.T @ (y[used] / variance[used]))[:3], inverse[:3, :3]


def _influences(
    los: Array, used: NDArray[np.bool_], variance: Array, y: Array, spendable: float = 0.0
) -> tuple[Records, Array, Array]:
    """Influences on one velocity, that velocity and its covariance."""
    v, q = _velocity(los, variance, y, used)
    faults, centred, sums = np.zeros(MODES, FAULT), np.zeros(7, dk.CENTRED), np.zeros(MAX_GROUPS + 1, dk.SUMS)
    dk.centre_rows(rows_of(los, 0, used, variance, np.where(used, y, np.nan)), v, centred, sums)
    dk.find_satellite_influences(q, centred, sums, faults)
    satellites = records_of(SATELLITE, 7, system=SYSTEM)
    dk.find_system_influences(q, satellites, PRIOR, spendable, centred, sums, faults)
    return faults["now"].copy(), v, q


@numba.njit
def _advance(t: Any, weight: float, last: Records, now: Records, separations: Records) -> None:
    for k in range(separations.shape[0]):
        dk.advance_separation(t, weight, last[k], now[k], separations[k])


class _Monitor:
    """Separations of a position that Doppler moves in every epoch."""

    def __init__(self) -> None:
        self.last, self.now = np.zeros(MODES, dk.INFLUENCE), np.zeros(MODES, dk.INFLUENCE)
        self.separations = np.zeros(MODES, dk.SEPARATION)
        self.had, self.weight = False, 0.0

    def step(self, los: Array, used: NDArray[np.bool_], variance: Array, y: Array) -> None:
        self.now = _influences(los, used, variance, y)[0]
        t = dk.trapezoid(DT, self.had, PHI, WHITE)
        _advance(t, self.weight, self.last, self.now, self.separations)
        self.last, self.had, self.weight = self.now, True, t.now


def _run(epochs: int, rng: np.random.Generator) -> tuple[_Monitor, Array]:
    """The monitor, and separations of the positions found by leaving each mode out of every epoch, (10, 2)."""
    los, variance = _sky()
    a, error, apart, last = _Monitor(), rng.normal(size=7), np.zeros((MODES, 2)), np.zeros((MODES, 2))
    for epoch in range(epochs):
        error = PHI * error + np.sqrt(1.0 - PHI**2) * rng.normal(size=7)
        y = np.sqrt(variance) * error - los @ np.array([3.0, 4.0, 0.0]) + 0.7
        used = ALL.copy()
        used[2] = epoch % 11 != 5
        a.step(los, used, variance, y)
        v, now = _velocity(los, variance, y, used)[0], np.zeros((MODES, 2))
        for k, members in enumerate(EACH):
            if (used & members).any() and (used & ~members).sum() >= 4:
                now[k] = (v - _velocity(los, variance, y, used & ~members)[0])[:2]
        apart += 0.5 * DT * (last + now) if epoch else DT * now
        last = now
    return a, apart


def test_separation_is_that_of_positions_without_the_mode() -> None:
    a, apart = _run(60, np.random.default_rng(1))
    s = a.separations
    np.testing.assert_allclose(np.column_stack([s["d_e"], s["d_n"]]), apart, rtol=1e-9, atol=1e-12)
    assert s["state"].tolist() == [dk.MONITORED] * 7 + [dk.LOST, dk.IDLE, dk.MONITORED]


def test_covariance_without_a_mode_is_the_fault_free_one_and_that_of_the_separation() -> None:
    los, variance = _sky()
    found, _, q = _influences(los, ALL, variance, np.zeros(7))
    for k in (*range(7), 9):
        factor = np.array([[found["l_ee"][k], 0.0], [found["l_ne"][k], found["l_nn"][k]]])
        without = _velocity(los, variance, np.zeros(7), ~EACH[k])[1]
        np.testing.assert_allclose(q[:2, :2] + factor @ factor.T, without[:2, :2], rtol=1e-9)


def test_covariance_is_that_of_simulated_separations() -> None:
    """1500 drives of 40 epochs with Gauss-Markov and white errors; fails by chance once in 1000 runs."""
    rng, drives = np.random.default_rng(2), 1500
    los, variance = _sky()
    error = rng.normal(size=(drives, 7))
    monitors = [_Monitor() for _ in range(drives)]
    for _ in range(40):
        error = PHI * error + np.sqrt(1.0 - PHI**2) * rng.normal(size=(drives, 7))
        both = error + np.sqrt(WHITE) * rng.normal(size=error.shape)
        for a, y in zip(monitors, np.sqrt(variance) * both, strict=True):
            a.step(los, ALL, variance, y)
    states = np.stack([a.separations for a in monitors])
    low, high = chi2.ppf([0.5e-3 / 17, 1.0 - 0.5e-3 / 17], df=drives)
    for k in (*range(7), 9):
        assert low < (states["d_e"][:, k] ** 2).sum() / states["s_ee"][0, k] < high
        assert low < (states["d_n"][:, k] ** 2).sum() / states["s_nn"][0, k] < high
    s_ee, s_en, s_nn = (states[name][0, 9] for name in ("s_ee", "s_en", "s_nn"))
    factor = np.linalg.cholesky(np.array([[s_ee, s_en], [s_en, s_nn]]))
    white = np.linalg.solve(factor, np.stack([states["d_e"][:, 9], states["d_n"][:, 9]]))
    assert abs(np.corrcoef(white)[0, 1]) < norm.isf(0.5e-3 / 17) / np.sqrt(drives)


def test_a_drift_shows_in_the_separation_and_is_bounded_whatever_it_does() -> None:
    """A drift of one satellite moves p by S f T; abs(D_k) holds it all but for noise, which ``K_f sigma_k`` bounds."""
    los, variance = _sky()
    fault = np.zeros(7)
    fault[4] = 0.3
    rng, exceeded, trials, k_f = np.random.default_rng(4), 0, 60, float(norm.isf(0.005))
    for _ in range(trials):
        a, error = _Monitor(), rng.normal(size=7)
        for _ in range(100):
            error = PHI * error + np.sqrt(1.0 - PHI**2) * rng.normal(size=7)
            a.step(los, ALL, variance, np.sqrt(variance) * error + fault)
        moved = 100 * DT * (_velocity(los, variance, fault, ALL)[0] - _velocity(los, variance, fault * 0.0, ALL)[0])[0]
        mine = a.separations[4]
        exceeded += bool(abs(moved) > abs(mine["d_e"]) + k_f * np.sqrt(mine["s_ee"]))
    assert exceeded <= 4  # expected 0.3 or less: a binomial of 60 with p = 0.01 exceeds 4 once in 2600 runs


def test_modes_that_the_velocity_needs_are_lost() -> None:
    los, variance = _sky()
    few = ALL.copy()
    few[[1, 3, 5]] = False
    found, _, _ = _influences(los, few, variance, np.zeros(7))
    assert found["state"].tolist() == [*np.where(few, dk.LOST, dk.IDLE), dk.LOST, dk.IDLE, dk.LOST]
    total, squares, lost = dk.exposure(PRIOR, found)
    assert total == lost == pytest.approx(1e-5 * 3 + 1e-4 + 1e-8 + 1e-4)
    assert squares == pytest.approx(1e-10 * 3 + 2e-8, rel=1e-6)


def test_the_prior_of_a_mode_counts_from_its_first_use() -> None:
    separations = np.zeros(MODES, dk.SEPARATION)
    separations["state"][[0, 1, 2, 3, 7]], separations["state"][9] = dk.MONITORED, dk.LOST
    total, squares, lost = dk.exposure(PRIOR, separations)
    assert lost == 1e-4
    assert total == pytest.approx(4e-5 + 1e-8 + 1e-4)
    assert squares == pytest.approx(4e-10 + 1e-16 + 1e-8)


def test_a_system_of_small_prior_is_lost_where_the_velocity_without_it_is_poor() -> None:
    los, variance = _sky()
    better = variance.copy()
    better[SYSTEM == 2] *= 1e-3
    for of_rows in (variance, better):
        found, _, q = _influences(los, ALL, of_rows, np.zeros(7), 1.0)
        without = _velocity(los, of_rows, np.zeros(7), SYSTEM == 0)[1]
        poor = without[0, 0] + without[1, 1] > dk.POOR * (q[0, 0] + q[1, 1])
        assert found["state"][9] == (dk.LOST if poor else dk.MONITORED)
    assert poor


def test_where_doppler_does_not_move_the_position_the_separation_stays_and_its_correlation_fades() -> None:
    a, _ = _run(20, np.random.default_rng(5))
    before = a.separations.copy()
    for s in a.separations:
        dk.fade_separation(PHI, s)
    for name in dk.SEPARATION.fields:
        factor = PHI if name.startswith(("ne_", "nn_")) else 1.0
        np.testing.assert_array_equal(a.separations[name], factor * before[name])


def test_the_worst_separation_is_the_largest_of_the_monitored_modes() -> None:
    a, _ = _run(20, np.random.default_rng(6))
    s, sine, cosine, sigma, by_heading, k_f = a.separations, 0.6, 0.8, 0.3, 0.05, 4.0
    sigma_d = np.sqrt(sine**2 * s["s_ee"] + 2 * sine * cosine * s["s_en"] + cosine**2 * s["s_nn"])
    level = np.abs(sine * s["d_e"] + cosine * s["d_n"]) + k_f * np.hypot(sigma, sigma_d + by_heading)
    worst = dk.worst_separation(sine, cosine, sigma, by_heading, k_f, s)
    assert worst == pytest.approx(level[s["state"] == dk.MONITORED].max(), rel=1e-12)
    s["state"] = dk.LOST
    assert dk.worst_separation(sine, cosine, sigma, by_heading, k_f, s) == 0.0


@pytest.mark.parametrize("budget", [5e-6, 5e-7, 4e-4])
@pytest.mark.parametrize("lost", [0.0, 1e-7])
def test_factors_spend_the_budget_and_no_more(budget: float, lost: float) -> None:
    share, pair, total = 0.5, 1e-8, 1e-3
    k_0, k_f = dk.risk_factors(budget, share, pair, total, lost)
    spent = 2.0 * norm.sf(k_0) + (total - lost) * 2.0 * norm.sf(k_f) + share * (pair + lost)
    assert spent == pytest.approx(budget, rel=1e-6)


def test_small_priors_are_spent_and_large_ones_leave_nothing() -> None:
    k_0, k_f = dk.risk_factors(1e-4, 0.5, 0.0, 1e-5, 0.0)
    assert k_f == -np.inf
    assert 2.0 * norm.sf(k_0) + 0.5e-5 == pytest.approx(1e-4)
    assert dk.risk_factors(5e-6, 0.5, 2e-5, 1e-3, 0.0) == (np.inf, np.inf)
    assert dk.risk_factors(5e-6, 0.5, 0.0, 1e-3, 1e-5) == (np.inf, np.inf)
