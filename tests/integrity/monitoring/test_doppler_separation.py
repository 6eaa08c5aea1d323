"""Positions from velocities without one satellite: oracle by leaving out rows, statistics, factors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from lanebound.integrity.core.records import record
from lanebound.integrity.monitoring import doppler_separation_kernel as dk

Array = NDArray[np.float64]
DT, PHI, WHITE = 0.1, float(np.exp(-0.1 / 0.54)), 0.5
SATELLITES = np.zeros(7, record(prior="[-]", system=("i8", "")))
SATELLITES["prior"] = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4, 1e-4]
SATELLITES["system"] = [0, 0, 0, 0, 0, 2, 2]
SOUND = np.zeros(8)  # prior of a fault of each constellation
ALL = np.ones(7, dtype=np.bool_)


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


class _Monitor:
    """Separations of a position that Doppler moves in every epoch."""

    def __init__(self) -> None:
        self.last, self.now = np.zeros(7, dk.INFLUENCE), np.zeros(7, dk.INFLUENCE)
        self.separations, self.had = np.zeros(7, dk.SEPARATION), False

    def step(self, los: Array, used: NDArray[np.bool_], variance: Array, y: Array, v: Array, q: Array) -> None:
        dk.find_influences(los, used, variance, y, v, q, True, self.now)
        self.advance(True)

    def advance(self, integrates: bool) -> None:
        for k in range(7):
            dk.advance_separation(DT, integrates, self.had, PHI, WHITE, self.last[k], self.now[k], self.separations[k])
        self.last, self.had = self.now.copy(), True


def _run(epochs: int, rng: np.random.Generator, fault: Array | None = None) -> tuple[_Monitor, Array, Array]:
    """The monitor, and separations of the positions found by leaving each satellite out of every epoch, (7, 2)."""
    los, variance = _sky()
    a, error, apart = _Monitor(), rng.normal(size=7), np.zeros((7, 2))
    last = np.zeros((7, 2))
    for epoch in range(epochs):
        error = PHI * error + np.sqrt(1.0 - PHI**2) * rng.normal(size=7)
        y = np.sqrt(variance) * error - los @ np.array([3.0, 4.0, 0.0]) + 0.7 + (0.0 if fault is None else fault)
        used = ALL.copy()
        used[2] = epoch % 11 != 5
        v, q = _velocity(los, variance, y, used)
        a.step(los, used, variance, y, v, q)
        now = np.zeros((7, 2))
        for k in np.flatnonzero(used):
            now[k] = (v - _velocity(los, variance, y, used & (np.arange(7) != k))[0])[:2]
        apart += 0.5 * DT * (last + now) if epoch else DT * now
        last = now
    return a, apart, variance


def test_separation_is_that_of_positions_without_the_satellite() -> None:
    a, apart, _ = _run(60, np.random.default_rng(1))
    found = np.column_stack([a.separations["d_e"], a.separations["d_n"]])
    np.testing.assert_allclose(found, apart, rtol=1e-9, atol=1e-12)
    assert (a.separations["state"] == dk.MONITORED).all()


def test_covariance_without_a_satellite_is_the_fault_free_one_and_that_of_the_separation() -> None:
    los, variance = _sky()
    influences, y = np.zeros(7, dk.INFLUENCE), np.zeros(7)
    v, q = _velocity(los, variance, y, ALL)
    dk.find_influences(los, ALL, variance, y, v, q, True, influences)
    for k in range(7):
        u = np.array([influences["u_e"][k], influences["u_n"][k]])
        without = _velocity(los, variance, y, np.arange(7) != k)[1]
        np.testing.assert_allclose(q[:2, :2] + np.outer(u, u), without[:2, :2], rtol=1e-9)


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
            a.step(los, ALL, variance, y, *_velocity(los, variance, y, ALL))
    states = np.stack([a.separations for a in monitors])
    low, high = chi2.ppf([0.5e-3 / 14, 1.0 - 0.5e-3 / 14], df=drives)
    for name, variance_name in (("d_e", "s_ee"), ("d_n", "s_nn")):
        white = (states[name] ** 2).sum(0) / states[variance_name][0]
        assert ((low < white) & (white < high)).all()


def test_a_drift_shows_in_the_separation_and_is_bounded_whatever_it_does() -> None:
    """A drift of one satellite moves p by S f T; abs(D_k) holds it all but for noise, which ``K_f sigma_k`` bounds."""
    los, variance = _sky()
    fault = np.zeros(7)
    fault[4] = 0.3
    rng, exceeded, trials, k_f = np.random.default_rng(4), 0, 60, float(norm.isf(0.005))
    for _ in range(trials):
        a, _, _ = _run(100, rng, fault)
        s = a.separations[4]
        noise = np.sqrt(s["s_ee"])
        moved = 100 * DT * (_velocity(los, variance, fault, ALL)[0] - _velocity(los, variance, fault * 0.0, ALL)[0])[0]
        exceeded += bool(abs(moved) > abs(s["d_e"]) + k_f * noise)
    assert exceeded <= 4  # expected 0.3 or less: a binomial of 60 with p = 0.01 exceeds 4 once in 2600 runs


def test_a_satellite_that_the_velocity_needs_is_lost() -> None:
    los, variance = _sky()
    a, y, few = _Monitor(), np.zeros(7), ALL.copy()
    few[[1, 3, 5]] = False
    a.step(los, few, variance, y, *_velocity(los, variance, y, few))
    assert (a.now["state"] == np.where(few, dk.LOST, dk.IDLE)).all()
    total, squares, lost = dk.exposure(SATELLITES, SOUND, a.separations, np.zeros(5, dk.SYSTEM_SEPARATION))
    assert total == lost == pytest.approx(1e-5 * 3 + 1e-4)
    assert squares == pytest.approx(1e-10 * 3 + 1e-8)


def test_the_prior_of_a_system_in_use_counts_and_is_lost_where_it_has_no_separation() -> None:
    separations, systems = np.zeros(7, dk.SEPARATION), np.zeros(3, dk.SYSTEM_SEPARATION)
    separations["state"][[0, 1, 2, 3]] = dk.MONITORED
    priors = np.array([1e-6, 2e-6, 4e-6, 0.0, 0.0, 0.0, 0.0, 0.0])
    systems["state"] = dk.MONITORED, dk.IDLE, dk.LOST
    total, squares, lost = dk.exposure(SATELLITES, priors, separations, systems)
    assert lost == 4e-6
    assert total == pytest.approx(4e-5 + 5e-6)
    assert squares == pytest.approx(4e-10 + 17e-12)


SYSTEM = np.array([0, 0, 0, 0, 0, 2, 2])


def _systems(los: Array, variance: Array, y: Array, spendable: float = 0.0) -> tuple[Any, Array, Array]:
    """Influences of the systems on one velocity, that velocity and its covariance."""
    v, q = _velocity(los, variance, y, ALL)
    out, sums = np.zeros(3, dk.SYSTEM_INFLUENCE), np.empty((4, 15))
    priors = np.array([1e-8, 1e-4, 1e-4])
    dk.find_system_influences(los, ALL, variance, y, v, q, True, SYSTEM, priors, spendable, sums, out)
    return out, v, q


def test_a_velocity_without_a_system_is_that_without_its_rows() -> None:
    los, variance = _sky()
    y = np.random.default_rng(6).normal(size=7)
    found, v, q = _systems(los, variance, y)
    without, more = _velocity(los, variance, y, SYSTEM == 0)
    assert found["state"].tolist() == [dk.LOST, dk.IDLE, dk.MONITORED]  # two satellites give no velocity
    np.testing.assert_allclose([found["d_e"][2], found["d_n"][2]], (v - without)[:2], rtol=1e-9)
    factor = np.array([[found["l_ee"][2], 0.0], [found["l_ne"][2], found["l_nn"][2]]])
    np.testing.assert_allclose(q[:2, :2] + factor @ factor.T, more[:2, :2], rtol=1e-9)
    poor, _, _ = _systems(los, variance, y, 1.0)
    limit = dk.POOR * (q[0, 0] + q[1, 1])
    assert poor["state"][2] == (dk.LOST if more[0, 0] + more[1, 1] > limit else dk.MONITORED)


def test_covariance_is_that_of_simulated_separations_by_a_system() -> None:
    """1500 drives of 40 epochs with Gauss-Markov and white errors; fails by chance once in 1000 runs."""
    rng, drives = np.random.default_rng(9), 1500
    los, variance = _sky()
    error, separations = rng.normal(size=(drives, 7)), np.zeros((drives, 1), dk.SYSTEM_SEPARATION)
    last = np.zeros((drives, 3), dk.SYSTEM_INFLUENCE)
    for epoch in range(40):
        error = PHI * error + np.sqrt(1.0 - PHI**2) * rng.normal(size=(drives, 7))
        both = error + np.sqrt(WHITE) * rng.normal(size=error.shape)
        for k, y in enumerate(np.sqrt(variance) * both):
            now, _, _ = _systems(los, variance, y)
            dk.advance_system(DT, True, epoch > 0, PHI, WHITE, last[k, 2], now[2], separations[k, 0])
            last[k] = now
    s = separations[0, 0]
    covariance = np.array([[s["s_ee"], s["s_en"]], [s["s_en"], s["s_nn"]]])
    apart = np.column_stack([separations["d_e"][:, 0], separations["d_n"][:, 0]])
    white = np.linalg.solve(np.linalg.cholesky(covariance), apart.T)
    low, high = chi2.ppf([0.25e-3, 1.0 - 0.25e-3], df=drives)
    assert ((low < (white**2).sum(-1)) & ((white**2).sum(-1) < high)).all()
    assert abs(np.corrcoef(white)[0, 1]) < norm.isf(0.25e-3) / np.sqrt(drives)


def test_at_rest_the_separation_stays_and_its_correlation_fades() -> None:
    a, _, _ = _run(20, np.random.default_rng(5))
    before, a.now = a.separations.copy(), np.zeros(7, dk.INFLUENCE)
    a.advance(False)
    for name in ("d_e", "d_n", "s_ee", "s_en", "s_nn", "state"):
        np.testing.assert_array_equal(a.separations[name], before[name])
    for name in ("c_e", "c_n"):
        np.testing.assert_allclose(a.separations[name], PHI * before[name], rtol=1e-12)


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
