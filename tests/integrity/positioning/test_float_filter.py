"""Float ambiguities from a filter: equal to batch least squares, and honest about errors that last."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, poisson
from signal_records import records_of

from lanebound.integrity.navigators.rtk_reckoning.navigator import blank_filters
from lanebound.integrity.positioning.codes_kernel import FIXED
from lanebound.integrity.positioning.float_filter_kernel import (
    FloatFilters,
    add_epoch,
    assign_slots,
    drop_slot,
    fade,
    filter_of,
    filtered_ambiguities,
    follows,
    invert_positive,
)
from lanebound.integrity.positioning.parameters import rtk_parameters
from lanebound.integrity.positioning.resolve_kernel import float_solution, resolve, source_of
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, SATELLITE, Carriers
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
SYSTEM = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1])
N = len(SYSTEM)
CODE_M, PHASE_M = 0.3, 0.004


def sky(seed: int, n: int = N) -> Array:
    """Lines of sight (n, 3), at least 15 degrees high."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False), rng.uniform(0.26, 1.4, n)
    return np.column_stack([
        np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)
    ])  # fmt: skip


@dataclass
class Session:
    """A filter, and the errors, truth and geometry of the epochs that go into it."""

    own: FloatFilters
    rules: Any
    satellites: NDArray[np.void]
    ambiguities: NDArray[np.void]
    los: Array
    true: Array
    code_m: float = CODE_M
    phase_m: float = PHASE_M

    def add(self, code_error: Array, phase_error: Array, x: Array, used: NDArray[np.bool_] | None = None,
            gap_s: float = 1.0) -> Carriers:  # fmt: skip
        """Add an epoch at position x (3,) with errors (S, 2) [m] and clocks of its own."""
        used = np.ones(N, np.bool_) if used is None else used
        rng = np.random.default_rng(int(abs(x[0]) * 1e6) % 2**32)
        clock = 100.0 * rng.standard_normal((2, 2, 2))[SYSTEM]  # by system, observable and band
        wave, range_m = self.satellites["wavelength"], -(self.los @ x)[:, None]
        code = range_m + clock[:, 0] + code_error
        phase = range_m + clock[:, 1] + wave * self.true + phase_error
        signals = records_of(OBSERVED_SIGNAL, N, e=self.los, code=code, phase=phase)
        carriers = Carriers(self.satellites, signals, np.full(N, self.phase_m**2))
        fade(self.own, gap_s, self.rules)
        assign_slots(self.own, carriers, np.flatnonzero(used), int(used.sum()), self.ambiguities, self.rules)
        assert add_epoch(self.own, carriers, np.full(N, self.code_m**2), used, used, self.rules)
        return carriers

    def floats(
        self, carriers: Carriers, rows: NDArray[np.int64] | None = None
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        """Float ambiguities, covariance and owners of satellites ``rows``."""
        rows = np.arange(N) if rows is None else rows
        c = 2 * len(rows)
        a, q, owner = np.empty(c), np.empty((c, c)), np.empty(c, np.int64)
        n = filtered_ambiguities(carriers, rows, len(rows), self.ambiguities, self.own, self.rules, a, q, owner)
        return a[:n], q[:n, :n], owner[:n]


def session(seed: int = 1, slots: int = 12, stands: bool = False, **floats: float) -> Session:
    rules = rtk_parameters(RtkConfig(max_candidates=slots, float_solution={"kind": "sequential", **floats}), 2, 1e-5)[0]
    satellites = np.zeros(N, SATELLITE)
    satellites["system"], satellites["fixable"] = SYSTEM, True
    satellites["wavelength"] = WAVELENGTH_M[SYSTEM][:, [0, 2]]
    config = RtkConfig(max_candidates=slots, float_solution={"kind": "sequential"})
    true = np.round(np.random.default_rng(seed).uniform(-1e6, 1e6, (N, 2)))
    return Session(
        filter_of(blank_filters(1, config, stands), 0),
        rules,
        satellites,
        np.zeros(N, AMBIGUITY),
        sky(seed),
        true,
    )


def relative(s: Session, owner: Ints) -> Array:
    """The true ambiguities as the filter counts them: from the first satellite of each system."""
    first = {0: 0, 1: int(np.flatnonzero(SYSTEM == 1)[0])}
    return np.array([s.true[u, i % 2] - s.true[first[SYSTEM[u]], i % 2] for i, u in enumerate(owner)])


def drawn(rng: np.random.Generator, epochs: int, tau_s: float, sigma: float) -> Array:
    """Gauss-Markov errors (epochs, N, 2), 1 s apart."""
    rho = np.exp(-1.0 / tau_s) if tau_s > 0.0 else 0.0
    out = rng.normal(0.0, sigma, (epochs, N, 2))
    for k in range(1, epochs):
        out[k] = rho * out[k - 1] + np.sqrt(1.0 - rho**2) * out[k]
    return out


def batch(s: Session, times: list[tuple[Array, Array, Array, NDArray[np.bool_]]], stands: bool) -> tuple[Array, Array]:
    """White least squares over all epochs at once, with every clock and position an unknown, or one position where the
    receiver ``stands``: (a, Q) of floats. Epochs are code, phase, lines of sight and which satellites are used."""
    wave, pairs = s.satellites["wavelength"], [(u, b) for u in range(N) for b in range(2)]
    firsts = {0: 0, 1: int(np.flatnonzero(SYSTEM == 1)[0])}
    states = {(u, b): i for i, (u, b) in enumerate(p for p in pairs if p[0] not in firsts.values())}
    rows, y, sigma, wide = [], [], [], len(states) + len(times) * (3 + 8)
    for k, (code, phase, los, used) in enumerate(times):
        base = len(states) + k * 11
        for u in np.flatnonzero(used):
            for b in range(2):
                for kind, value in ((0, code[u, b]), (1, phase[u, b])):
                    row = np.zeros(wide)
                    place = len(states) if stands else base
                    row[place : place + 3] = -los[u]
                    row[base + 3 + 4 * SYSTEM[u] + 2 * kind + b] = 1.0
                    if kind == 1 and (u, b) in states:
                        row[states[u, b]] = wave[u, b]
                    rows.append(row)
                    y.append(value)
                    sigma.append(PHASE_M if kind else CODE_M)
    weighted = np.array(rows) / np.array(sigma)[:, None]
    q = np.linalg.pinv(weighted.T @ weighted, hermitian=True, rcond=1e-13)
    return (q @ weighted.T @ (np.array(y) / np.array(sigma)))[: len(states)], q[: len(states), : len(states)]


def test_inverse_of_a_positive_matrix() -> None:
    a = np.random.default_rng(2).standard_normal((9, 7))
    out = np.empty((7, 7))
    assert invert_positive(a.T @ a, 7, out)
    np.testing.assert_allclose(out, np.linalg.inv(a.T @ a), rtol=1e-9)
    assert not invert_positive(np.ones((7, 7)), 7, out)


def test_one_epoch_gives_the_float_solution_of_that_epoch() -> None:
    s = session()
    rng, x = np.random.default_rng(3), np.array([3.0, -2.0, 1.0])
    code_error, phase_error = rng.normal(0, CODE_M, (N, 2)), rng.normal(0, PHASE_M, (N, 2))
    carriers = s.add(code_error, phase_error, x)
    a, q, owner = s.floats(carriers)
    # the position from the codes alone: weighted least squares with a clock for each system and band
    g = np.zeros((2 * N, 3 + 4))
    clock = np.random.default_rng(int(abs(x[0]) * 1e6) % 2**32).standard_normal((2, 2, 2))[SYSTEM]
    code = -(s.los @ x)[:, None] + 100.0 * clock[:, 0] + code_error
    for u in range(N):
        for b in range(2):
            g[2 * u + b, :3], g[2 * u + b, 3 + 2 * SYSTEM[u] + b] = -s.los[u], 1.0
    cov = CODE_M**2 * np.linalg.inv(g.T @ g)
    place = (cov @ g.T @ code.ravel() / CODE_M**2)[:3]
    empty = np.zeros(N, AMBIGUITY)
    source = source_of(carriers, empty, 2, place, np.ascontiguousarray(cov[:3, :3]), s.own, False)
    wanted = float_solution(carriers, np.ones(N, np.bool_), empty, source, s.own, s.rules)
    assert owner.tolist() == wanted.owner[: wanted.n].tolist()
    np.testing.assert_allclose(a, wanted.ambiguity[: wanted.n], atol=1e-5)
    np.testing.assert_allclose(q, wanted.covariance[: wanted.n, : wanted.n], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("stands", [False, True])
def test_white_errors_give_batch_least_squares_with_satellites_that_come_and_go(stands: bool) -> None:
    s = session(stands=stands, memory_s=1e12, code_tau_s=1e-3, phase_tau_s=1e-3)
    start, later, rest = s.los, sky(8), np.array([3.0, -2.0, 1.0])
    rng, times = np.random.default_rng(4), []
    seen = np.ones((6, N), np.bool_)
    seen[:2, 3], seen[3:, 7] = False, False  # one rises, one sets
    for k in range(6):
        x, used = rest if stands else rng.normal(0.0, 10.0, 3), seen[k]
        s.los = start + 0.1 * k * (later - start)
        s.los /= np.linalg.norm(s.los, axis=1)[:, None]
        if k == 3:
            drop_slot(s.own, follows(s.own.slots, 7), s.rules)
        code_error, phase_error = rng.normal(0, CODE_M, (N, 2)), rng.normal(0, PHASE_M, (N, 2))
        carriers = s.add(code_error, phase_error, x, used)
        clock = 100.0 * np.random.default_rng(int(abs(x[0]) * 1e6) % 2**32).standard_normal((2, 2, 2))[SYSTEM]
        times.append((-(s.los @ x)[:, None] + clock[:, 0] + code_error, carriers.signals["phase"].copy(), s.los, used))
    rows = np.delete(np.arange(N), 7)
    a, q, owner = s.floats(carriers, rows)
    wanted, covariance = batch(s, times, stands)
    keep = np.array([i for i in range(14) if i // 2 != 5])  # without the satellite that has set
    assert len(a) == keep.size
    np.testing.assert_allclose(a, wanted[keep], atol=2e-4)
    np.testing.assert_allclose(q, covariance[np.ix_(keep, keep)], rtol=1e-4, atol=1e-9)
    assert set(owner.tolist()) == set(rows.tolist()) - {0, 5}


def squared_errors(true_tau_s: float, declared_tau_s: float, runs: int, epochs: int = 15) -> Array:
    """``(a - true)' Q^-1 (a - true)`` of many sessions, (runs,)."""
    out = np.empty(runs)
    for r in range(runs):
        s = session(7, memory_s=1e9, code_tau_s=declared_tau_s, phase_tau_s=declared_tau_s)
        rng = np.random.default_rng([5, r])
        code, phase = drawn(rng, epochs, true_tau_s, CODE_M), drawn(rng, epochs, true_tau_s, PHASE_M)
        for k in range(epochs):
            carriers = s.add(code[k], phase[k], rng.normal(0.0, 10.0, 3))
        a, q, owner = s.floats(carriers)
        off = a - relative(s, owner)
        out[r] = off @ np.linalg.solve(q, off)
    return out


def test_the_covariance_holds_for_errors_that_last() -> None:
    runs, dim = 200, 14
    low, high = chi2.ppf([5e-4, 1 - 5e-4], df=runs * dim)
    assert low < squared_errors(8.0, 8.0, runs).sum() < high
    for shorter in (0.0, 2.0):  # errors that last less are bounded too
        assert squared_errors(shorter, 8.0, runs).sum() < low


def test_a_filter_that_takes_lasting_errors_as_white_is_overconfident() -> None:
    assert squared_errors(8.0, 1e-3, 50).sum() > 3.0 * 50 * 14


def test_held_satellites_are_known_and_new_ones_count_from_them() -> None:
    s = session()
    rng = np.random.default_rng(6)
    held = [0, 1, 2, 3, 5, 6, 7]
    s.ambiguities["held"][held] = True
    s.ambiguities["integers"][held] = s.true[held] + np.where(SYSTEM[held] == 0, 11.0, -4.0)[:, None]
    carriers = s.add(rng.normal(0, CODE_M, (N, 2)), rng.normal(0, PHASE_M, (N, 2)), np.array([1.0, 2.0, 3.0]))
    a, q, owner = s.floats(carriers, np.array([4, 8]))
    assert owner.tolist() == [4, 4, 8, 8]
    np.testing.assert_allclose(a, [*(s.true[4] + 11.0), *(s.true[8] - 4.0)], atol=0.2)
    assert np.sqrt(np.diag(q)).max() < 0.1  # cycles: from phases, not from codes


def test_the_residual_ionosphere_is_a_state_of_its_own() -> None:
    """An ionosphere of 6 cm breaks a filter without the state and is bounded by one with it."""
    rng, found = np.random.default_rng(8), {}
    vertical = rng.normal(0.0, 0.06, N)
    for sigma in (0.0, 0.06):
        s = session(9, memory_s=1e9, code_tau_s=1e-3, phase_tau_s=1e-3, ionosphere_m=sigma)
        errors = np.random.default_rng(10)
        slant = vertical / np.sqrt(1.0 - (6371.0 / 6721.0) ** 2 * (1.0 - s.los[:, 2] ** 2))
        wave = s.satellites["wavelength"]
        delay = slant[:, None] * (wave / wave[:, :1]) ** 2
        for _ in range(20):
            code, phase = errors.normal(0, CODE_M, (N, 2)) + delay, errors.normal(0, PHASE_M, (N, 2)) - delay
            carriers = s.add(code, phase, errors.normal(0.0, 10.0, 3))
        a, q, owner = s.floats(carriers)
        off = a - relative(s, owner)
        found[sigma] = off @ np.linalg.solve(q, off)
    assert found[0.0] > chi2.isf(1e-6, 14)
    assert found[0.06] < chi2.isf(1e-3, 14)


def is_wrong(s: Session) -> bool:
    """Whether held integers differ from the true ones by more than one number for each system and band."""
    off, held = s.ambiguities["integers"] - s.true, s.ambiguities["held"]
    return any(np.ptp(off[held & (c == SYSTEM)], axis=0).any() for c in np.unique(SYSTEM[held]))


@pytest.mark.parametrize("tau_s", [0.0, 5.0, 10.0])
def test_wrong_integers_stay_within_the_limit_under_lasting_errors(tau_s: float) -> None:
    """Fixes as soon as the failure rate allows, of codes whose errors last up to the declared time."""
    limit, runs, wrong, fixed = 0.05, 150, 0, 0
    for r in range(runs):
        s = session(11, memory_s=100.0, code_tau_s=10.0, phase_tau_s=10.0)
        s.rules["fix_limit"], s.rules["ratio_min"], s.rules["attempts"] = limit, 1.0, 0
        rng = np.random.default_rng([12, r])
        code, phase = drawn(rng, 12, tau_s, 2.0 * CODE_M), drawn(rng, 12, tau_s, PHASE_M)
        for k in range(12):
            carriers = s.add(code[k] / 2.0, phase[k], rng.normal(0.0, 10.0, 3))
            x, q = np.zeros(3), np.eye(3)
            status, _ = resolve(carriers, ~s.ambiguities["held"], s.ambiguities, s.rules, x, q, s.own, True, 1)
            if status == FIXED:
                fixed += 1
                wrong += is_wrong(s)
                break
    assert fixed > 0.5 * runs
    assert wrong <= chi2.isf(1e-3, 2 * (limit * runs + 1)) / 2  # above the limit by chance once in a thousand


def first_fix(run: int, tau_s: float, times: float, limit: float, margin: float) -> tuple[int, bool, float]:
    """The epoch, 5 s apart, of the first fix of a session with a weak geometry (20: none), whether it is wrong, and its
    stated risk; errors last ``tau_s`` (declared: 30 s) and are ``times`` the declared ones."""
    s = session(run % 40 + 11, memory_s=100.0, code_tau_s=30.0, phase_tau_s=30.0)
    s.code_m, s.phase_m = 1.0, 0.012
    s.rules["fix_limit"], s.rules["ratio_min"], s.rules["posterior"] = limit, 2.0, margin**2
    rng = np.random.default_rng([12, run])
    code, phase = (drawn(rng, 20, tau_s / 5.0, times * sigma) for sigma in (s.code_m, s.phase_m))
    for k in range(20):
        carriers = s.add(code[k], phase[k], rng.normal(0.0, 10.0, 3), gap_s=5.0)
        x, q = np.zeros(3), np.eye(3)
        status, _ = resolve(carriers, ~s.ambiguities["held"], s.ambiguities, s.rules, x, q, s.own, True, 1)
        if status == FIXED:
            return k, is_wrong(s), float(s.ambiguities["fix_risk"].max())
    return 20, False, 0.0


def test_integers_are_accepted_earlier_by_their_probability() -> None:
    """As often wrong as stated, at most: 1e-4 of false alarms."""
    known = np.array([first_fix(run, 30.0, 1.0, 0.02, 0.0)[0] for run in range(60)])
    runs, stated, wrong, epochs = 1500, 0.0, 0, []
    for run in range(runs):
        epoch, is_off, risk = first_fix(run, 30.0, 1.0, 0.02, 1.0)
        wrong, stated = wrong + is_off, stated + risk
        epochs.append(epoch)
    assert np.mean(epochs[:60]) < 0.3 * known.mean()
    assert wrong <= poisson.isf(1e-4, stated)
    assert wrong <= poisson.isf(1e-4, 0.02 * runs)


@pytest.mark.parametrize(("times", "margin"), [(1.0, 1.25), (1.25, 1.25), (1.5, 1.5)])
def test_wrong_integers_stay_within_the_limit_for_errors_within_the_margin(times: float, margin: float) -> None:
    """Errors that last the declared time; 1e-4 of false alarms."""
    runs, limit = 600, 0.02
    wrong = sum(first_fix(run, 30.0, times, limit, margin)[1] for run in range(runs))
    assert wrong <= poisson.isf(1e-4, limit * runs)
