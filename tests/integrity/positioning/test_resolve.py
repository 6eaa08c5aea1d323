"""Which ambiguities are fixed and held: right integers, the promised risk, and nothing held after a refusal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, poisson
from signal_records import records_of, rows_of

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.codes_kernel import FIXED, NOT_CONVERGED, RATIO_FAILED, TOO_FEW
from lanebound.integrity.positioning.parameters import rtk_parameters
from lanebound.integrity.positioning.resolve_kernel import float_solution, resolve, source_of, suspect
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import (
    AMBIGUITY,
    MOST_AMBIGUITIES,
    SATELLITE,
    Carriers,
    add_layer,
    collapse_code,
    drop_small_systems,
    held_risk,
)
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
WAVES = np.ascontiguousarray(WAVELENGTH_M[:, :2])
SYSTEM = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 3, 3, 3])
N_SAT = len(SYSTEM)


def fit_limits(false_rejection: float) -> Array:
    """Largest best norm by number of ambiguities; without bound for 0."""
    return np.asarray(chi2.isf(false_rejection, np.maximum(np.arange(MOST_AMBIGUITIES + 1), 1)))


def satellites_of(system: NDArray[np.int64]) -> NDArray[np.void]:
    """Satellites of these systems, with the wavelengths of two bands."""
    satellites = np.zeros(len(system), SATELLITE)
    satellites["system"], satellites["wavelength"] = system, WAVES[system]
    return satellites


@dataclass
class _Problem:
    """Single differences of one epoch, what is held, and the true integers."""

    los: Array
    code: Array
    phase: Array
    variance_code: Array
    variance_phase: Array
    true: Array
    fixes: NDArray[np.void]
    system: NDArray[np.int64]

    def __getattr__(self, name: str) -> Any:
        """A field of what is held: held, integers, fix_id, fix_risk."""
        if name not in AMBIGUITY.names:
            raise AttributeError(name)
        return self.fixes[name]

    @property
    def carriers(self) -> Carriers:
        signals = records_of(OBSERVED_SIGNAL, len(self.system), e=self.los, code=self.code, phase=self.phase)
        return Carriers(satellites_of(self.system), signals, self.variance_phase)

    def resolve(
        self, *, candidate: Bools | None = None, bands: int = 2, limit: float = 1e-3, ratio: float = 1.0,
        most: int = 16, least: int = 5, further: int = 3, fix: int = 7, fit: float = 0.0, attempts: int = 0,
        margin: float = 0.0,
    ) -> int:  # fmt: skip
        """Run the kernel on everything that is not held; state is changed in place."""
        wanted = ~self.held if candidate is None else candidate
        x, q = self._code_position(bands)
        rules = rtk_parameters(RtkConfig(), bands, 1.0)[0]
        rules["fix_limit"], rules["ratio_min"], rules["misfit"], rules["attempts"] = (
            limit,
            ratio,
            fit_limits(fit),
            attempts,
        )
        rules["posterior"] = margin**2
        rules["max_candidates"], rules["min_satellites"], rules["min_further"] = most, least, further
        status, _ = resolve(self.carriers, wanted, self.fixes, rules, x, q, None, False, fix)
        return int(status)

    def _code_position(self, bands: int) -> tuple[Array, Array]:
        """Position and covariance from the code of all satellites."""
        normal, rhs = np.zeros((3, 3)), np.zeros(3)
        rows = rows_of(self.los, self.system, True, self.variance_code / bands)
        collapse_code(self.carriers.signals, bands, rows)
        add_layer(rows, normal, rhs)
        q = np.linalg.pinv(normal)
        return q @ rhs, q

    def wrong(self, bands: int = 2) -> bool:
        """Whether held integers differ from the true ones by more than one offset for each system and band."""
        off = (self.integers - self.true)[:, :bands]
        return any(
            np.ptp(off[self.held & (self.system == c)], axis=0).any()
            for c in np.unique(self.system[self.held])
        )  # fmt: skip

    def hold_true(self, rows: list[int], risk: float, fix: int = 1) -> None:
        """Hold satellites with their true integers, as an earlier fix would."""
        self.held[rows], self.fix_id[rows], self.fix_risk[rows] = True, fix, risk
        self.integers[rows] = self.true[rows]


def _problem(seed: int, noise: float = 1.0, sigma_code: float = 0.3, system: NDArray[np.int64] = SYSTEM) -> _Problem:
    rng, n = np.random.default_rng(seed), len(system)
    azimuth, elevation = rng.uniform(0.0, 2.0 * math.pi, n), rng.uniform(0.25, 1.5, n)
    c = np.cos(elevation)
    los = np.column_stack([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)])
    factor = 0.5 * (1.0 + 1.0 / np.sin(elevation) ** 2)
    variance_code, variance_phase = sigma_code**2 * factor, 0.0042**2 * factor
    true = np.round(rng.uniform(-1e4, 1e4, (n, 2)))
    clocks = 50.0 * rng.standard_normal((2, 5, 2))
    geometric = -(los @ rng.uniform(-500.0, 500.0, 3))[:, None]
    error = noise * rng.standard_normal((2, n, 2))
    code = geometric + clocks[0, system] + error[0] * np.sqrt(variance_code)[:, None]
    phase = geometric + clocks[1, system] + error[1] * np.sqrt(variance_phase)[:, None] + WAVES[system] * true
    return _Problem(los, code, phase, variance_code, variance_phase, true, np.zeros(n, AMBIGUITY), system)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("bands", [1, 2])
def test_without_noise_all_integers_come_back(seed: int, bands: int) -> None:
    p = _problem(seed, noise=0.0, sigma_code=0.05)
    assert p.resolve(bands=bands, limit=0.1, ratio=2.0) == FIXED
    assert p.held.sum() >= 5
    assert not p.wrong(bands)
    np.testing.assert_array_equal(p.fix_id[p.held], 7)
    assert not p.integers[~p.held].any()


def test_with_a_generous_limit_every_satellite_is_held_the_references_with_zero() -> None:
    p = _problem(3, sigma_code=0.05)
    assert p.resolve(limit=0.2) == FIXED
    assert p.held.all()
    for c in np.unique(SYSTEM):
        members = np.flatnonzero(p.system == c)
        first = members[np.argmin(p.variance_phase[members])]
        np.testing.assert_array_equal(p.integers[first], 0.0)


def test_wrong_fixes_stay_within_the_stated_risk() -> None:
    """2000 fixes on one band, each with its stated risk: the wrong ones are Poisson at most (once in 1000 seeds)."""
    stated, wrong, fixes = 0.0, 0, 0
    for seed in range(2000):
        p = _problem(10_000 + seed, sigma_code=0.6)
        if p.resolve(limit=0.05, bands=1) == FIXED:
            fixes, wrong = fixes + 1, wrong + p.wrong(bands=1)
            rate = held_risk(p.fixes)
            assert 0.0 <= rate <= 0.05
            stated += rate
    assert fixes > 1000
    assert wrong <= poisson.ppf(0.999, stated)
    assert stated > 10.0  # many fixes were risky: otherwise the test would show nothing
    assert wrong > 0


def test_the_ratio_test_refuses_what_fits_no_integers_well() -> None:
    p = _problem(2, sigma_code=0.05)
    p.phase += 0.3 * np.random.default_rng(1).standard_normal(p.phase.shape)
    assert p.resolve(limit=0.2, ratio=2.0) == RATIO_FAILED
    _assert_nothing_held(p)


def _assert_nothing_held(p: _Problem) -> None:
    assert not p.held.any()
    assert not p.integers.any()
    assert not p.fix_id.any()
    assert not p.fix_risk.any()


def test_a_refusal_holds_nothing() -> None:
    loose = _problem(5, sigma_code=30.0)
    assert loose.resolve(limit=1e-9) == NOT_CONVERGED
    few = _problem(5)
    assert few.resolve(candidate=np.arange(N_SAT) < 3) in (TOO_FEW, NOT_CONVERGED)
    none = _problem(5)
    assert none.resolve(candidate=np.zeros(N_SAT, dtype=np.bool_)) == NOT_CONVERGED
    for p in (loose, few, none):
        _assert_nothing_held(p)


def test_held_carriers_of_a_singular_position_are_too_few() -> None:
    p = _problem(4, system=np.array([0, 0, 0]))
    p.hold_true([0], risk=0.0)
    assert p.resolve() == TOO_FEW


def test_a_fix_smaller_than_a_position_needs_is_not_held() -> None:
    p = _problem(6, noise=0.0, sigma_code=0.05)
    four = np.isin(np.arange(N_SAT), [0, 1, 2, 3])
    assert p.resolve(candidate=four, limit=0.5) == TOO_FEW
    _assert_nothing_held(p)
    assert p.resolve(candidate=four, limit=0.5, least=4) == FIXED
    np.testing.assert_array_equal(np.flatnonzero(p.held), [0, 1, 2, 3])


def test_systems_that_would_stay_small_are_not_held() -> None:
    p = _problem(6, noise=0.0, sigma_code=0.05)
    wanted = np.isin(np.arange(N_SAT), [0, 1, 2, 3, 4, 6, 7])
    assert p.resolve(candidate=wanted, limit=0.5) == FIXED
    np.testing.assert_array_equal(np.flatnonzero(p.held), [0, 1, 2, 3, 4])


def test_newcomers_join_what_is_held_and_leave_it_untouched() -> None:
    p = _problem(9)
    old = [0, 1, 2, 3, 4, 6, 7, 8]
    p.hold_true(old, risk=1e-7)
    kept = p.integers[old].copy()
    assert p.resolve(candidate=np.isin(np.arange(N_SAT), [5, 9]), limit=1e-3, fix=2) == FIXED
    np.testing.assert_array_equal(np.flatnonzero(p.held), [*old[:5], 5, *old[5:], 9])
    np.testing.assert_array_equal(p.integers[old], kept)
    np.testing.assert_array_equal(p.integers[[5, 9]], p.true[[5, 9]])
    np.testing.assert_array_equal(p.fix_id[[5, 9]], 2)
    np.testing.assert_array_equal(p.fix_id[old], 1)


def test_risk_that_is_spent_cannot_be_spent_again() -> None:
    p = _problem(9)
    p.hold_true([0, 1, 2, 3, 4], risk=2e-3)
    before = p.integers.copy()
    assert p.resolve(limit=1e-3, fix=2) == NOT_CONVERGED
    np.testing.assert_array_equal(np.flatnonzero(p.held), [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(p.integers, before)


def test_no_more_candidates_are_searched_than_allowed() -> None:
    p = _problem(3, noise=0.0, sigma_code=0.05, system=np.zeros(N_SAT, dtype=np.int64))
    assert p.resolve(limit=0.5, most=6) == FIXED
    np.testing.assert_array_equal(np.flatnonzero(p.held), np.sort(np.argsort(p.variance_phase)[:6]))


def test_a_single_band_leaves_the_second_integers_at_zero() -> None:
    p = _problem(1, noise=0.0, sigma_code=0.02)
    assert p.resolve(bands=1, limit=0.5) == FIXED
    assert not p.integers[:, 1].any()
    assert p.integers[:, 0].any()


def test_the_risk_of_what_is_held_is_the_union_over_its_fixes() -> None:
    fixes = np.zeros(4, AMBIGUITY)
    fixes["fix_id"], fixes["fix_risk"] = [1, 1, 2, 3], [1e-4, 1e-4, 2e-4, 5e-4]
    for held, risk in (([1, 1, 1, 1], 8e-4), ([0, 1, 1, 0], 3e-4), ([0, 0, 0, 0], 0.0)):
        fixes["held"] = held
        assert held_risk(fixes) == pytest.approx(risk)


def test_small_systems_are_left_out_in_place() -> None:
    member = np.ones(N_SAT, dtype=np.bool_)
    assert drop_small_systems(member, satellites_of(SYSTEM), 4) == (10, 2)
    np.testing.assert_array_equal(member, SYSTEM != 3)
    assert drop_small_systems(member, satellites_of(SYSTEM), 7) == (0, 0)


def _half_cycle(p: _Problem, s: int, bands: int = 1) -> None:
    p.phase[s, :bands] += 0.5 * WAVES[p.system[s], :bands]


@pytest.mark.parametrize("s", [0, 3, 5, 7, 11])
def test_a_carrier_half_a_cycle_off_is_named_and_left_out_in_the_same_epoch(s: int) -> None:
    together, apart = _problem(40 + s, noise=0.5, sigma_code=0.1), _problem(40 + s, noise=0.5, sigma_code=0.1)
    for p in (together, apart):
        _half_cycle(p, s)
    assert together.resolve(ratio=2.0, fit=0.01) == RATIO_FAILED
    _assert_nothing_held(together)
    wanted = np.ones(N_SAT, dtype=np.bool_)
    assert apart.resolve(candidate=wanted, ratio=2.0, fit=0.01, attempts=1) == FIXED
    assert wanted.all()
    assert not apart.held[s]
    assert apart.held.sum() >= N_SAT - 3  # the others of its system stay when there are enough of them
    assert not apart.wrong()


def test_the_reference_of_a_system_can_be_the_one_that_is_off() -> None:
    """It has no ambiguity of its own: all others of its system are off against it."""
    for seed in range(10):
        p = _problem(60 + seed, noise=0.5, sigma_code=0.1)
        reference = int(np.argmin(np.where(p.system == 0, p.variance_phase, np.inf)))
        _half_cycle(p, reference)
        assert p.resolve(ratio=2.0, fit=0.01, attempts=1) == FIXED
        assert not p.held[reference]
        assert not p.wrong()


def test_most_half_cycles_are_found_in_few_attempts_and_none_is_held() -> None:
    """Any satellite, one band: found in over 90 of 100 epochs; held in none (0.1 % of epochs: once in 10 seeds)."""
    found = 0
    for seed in range(100):
        p = _problem(5000 + seed, noise=0.7)
        s = int(np.random.default_rng(seed).integers(N_SAT))
        _half_cycle(p, s)
        fixed = p.resolve(limit=1e-5, ratio=2.0, fit=0.01, attempts=6) == FIXED
        found += fixed and not p.held[s]
        assert not (fixed and p.held[s])
    assert found > 90


def test_the_norm_relieved_is_what_is_lost_when_the_satellite_is_left_out() -> None:
    """Against the plain form: the norm of the rest with its own block of the covariance."""
    p = _problem(11)
    rules, carriers = rtk_parameters(RtkConfig(), 2, 1.0)[0], p.carriers
    x, q = p._code_position(2)
    everything = np.ones(N_SAT, dtype=np.bool_)
    source = source_of(carriers, p.fixes, 2, x, q, None, False)
    floats = float_solution(carriers, everything, p.fixes, source, None, rules)
    n, best, relieved = floats.n, np.round(floats.ambiguity), np.empty(N_SAT)
    count = suspect(floats, n // 2, p.fixes, everything, carriers, 2, best, relieved)
    assert count == N_SAT
    v, Q, owner = floats.ambiguity[:n] - best[:n], floats.covariance[:n, :n], floats.owner[:n]
    whole = v @ np.linalg.solve(Q, v)
    for s in np.unique(owner):
        rest = owner != s
        expected = whole - v[rest] @ np.linalg.solve(Q[np.ix_(rest, rest)], v[rest])
        assert relieved[s] == pytest.approx(expected, rel=1e-6)
    references = np.setdiff1d(np.arange(N_SAT), owner)
    assert len(references) == 3
    for s in references:  # with the reference free, the others count from another of them
        mine = np.flatnonzero(p.system[owner] == p.system[s])
        D = np.eye(n)
        for i in mine[2:]:
            D[i, mine[i % 2]] = -1.0
        D = np.delete(D, mine[:2], axis=0)
        expected = whole - (D @ v) @ np.linalg.solve(D @ Q @ D.T, D @ v)
        assert relieved[s] == pytest.approx(expected, rel=1e-6)


def test_all_attempts_together_stay_within_the_risk() -> None:
    """800 epochs, right models, six attempts: the wrong fixes are Poisson at most (once in 1000 seeds).

    A strict fit refuses many sets, so that many fixes come from sets that were chosen by the data.
    """
    stated, wrong, again, limit = 0.0, 0, 0, 0.2
    for seed in range(800):
        p = _problem(20_000 + seed, sigma_code=4.0)
        if p.resolve(limit=limit, fit=0.3, attempts=6) == FIXED:
            rate = held_risk(p.fixes)
            assert rate <= limit
            stated, wrong, again = stated + rate, wrong + p.wrong(), again + (rate >= 0.5 * limit)
    assert again > 100
    assert wrong <= poisson.ppf(0.999, stated)


def test_a_set_without_a_suspect_must_be_safer_by_the_number_of_suspects() -> None:
    """With the risk of the whole set almost used up, no other set of that risk may be tried in its place."""
    p = _problem(2, sigma_code=0.05)
    p.phase += 0.3 * np.random.default_rng(1).standard_normal(p.phase.shape)
    assert p.resolve(limit=0.2, ratio=2.0, fit=0.01, attempts=16) == RATIO_FAILED
    _assert_nothing_held(p)


def test_probabilities_of_smaller_errors_than_declared_are_refused() -> None:
    assert RtkConfig().posterior_margin == 0.0
    with pytest.raises(ConfigError, match=r"posterior_margin must be 0, or at least 1, got 0\.5"):
        RtkConfig(posterior_margin=0.5)


def test_a_set_above_its_failure_rate_is_fixed_by_what_was_measured() -> None:
    """Without noise other integers are improbable at once; by the rate alone nothing is fixed, and nothing in doubt."""
    known, given, noisy = (_problem(4, noise=noise, sigma_code=0.3) for noise in (0.0, 0.0, 1.5))
    assert known.resolve(limit=1e-4, bands=1) == NOT_CONVERGED
    assert given.resolve(limit=1e-4, bands=1, margin=1.25) == FIXED
    assert not given.wrong(1)
    assert 0.0 < given.fix_risk.max() <= 0.5e-4
    assert noisy.resolve(limit=1e-4, bands=1, margin=1.25) == NOT_CONVERGED
    _assert_nothing_held(noisy)


def test_attempts_after_a_refused_probability_stay_within_the_limit() -> None:
    """The first set counts with its share of the limit, however large its failure rate is."""
    limit, again = 0.01, 0
    for seed in range(300):
        p = _problem(30_000 + seed, sigma_code=0.15)
        if p.resolve(bands=1, limit=limit, fit=0.5, attempts=6, margin=1.0) == FIXED:
            assert held_risk(p.fixes) <= limit
            again += held_risk(p.fixes) >= 0.5 * limit
    assert again > 10
