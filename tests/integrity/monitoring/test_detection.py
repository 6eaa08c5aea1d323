"""Detection against re-adjustment without the rows, and against the distributions its thresholds come from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom, chi2, norm
from signed_w import w_statistics

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.detection import (
    Adjustment,
    TestOutcome,
    adjust,
    diagonal_covariance,
    direction_test,
    global_test,
    minimal_detectable_bias,
    mode_statistics,
    separate,
    separation_test,
    w_test,
)
from lanebound.integrity.monitoring.significance import noncentrality

Array = NDArray[np.float64]


def sky(rng: np.random.Generator, m: int, groups: int = 1) -> tuple[Array, Array]:
    """A design ``[-e, clocks]`` of m satellites above 10 degrees, and a correlated covariance."""
    azimuth, sin_el = rng.uniform(0, 2 * np.pi, m), rng.uniform(np.sin(np.radians(10)), 1, m)
    cos_el = np.sqrt(1 - sin_el**2)
    los = np.stack([cos_el * np.sin(azimuth), cos_el * np.cos(azimuth), sin_el], -1)
    design = np.concatenate([-los, np.eye(groups)[np.arange(m) % groups]], -1)
    root = rng.normal(size=(m, m)) * 0.2 + np.diag(rng.uniform(0.5, 1.5, m))
    return design, root @ root.T


def without(design: Array, covariance: Array, y: Array, rows: list[int]) -> tuple[Array, Array]:
    """Solution and gain of a fresh adjustment without ``rows``: the oracle of every downdate."""
    keep = np.setdiff1d(np.arange(y.size), rows)
    G, W = design[keep], np.linalg.inv(covariance[np.ix_(keep, keep)])
    gain = np.zeros((design.shape[1], y.size))
    gain[:, keep] = np.linalg.solve(G.T @ W @ G, G.T @ W)
    return gain @ y, gain


def test_adjustment_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    G, Q = sky(rng, 9)
    y = rng.normal(size=9)
    a = adjust(G, Q, y)
    root = np.linalg.cholesky(np.linalg.inv(Q)).T
    expected = np.linalg.lstsq(root @ G, root @ y, rcond=None)[0]
    assert np.allclose(a.x, expected, rtol=1e-10)
    assert a.df == 5
    Q_e = Q - G @ np.linalg.inv(G.T @ np.linalg.inv(Q) @ G) @ G.T
    assert np.allclose(a.reliability, a.weight @ Q_e @ a.weight, atol=1e-10)


@pytest.mark.parametrize("rows", [[2], [1, 5], [0, 3, 7]])
def test_separation_equals_adjustment_without_the_rows(rows: list[int]) -> None:
    rng = np.random.default_rng(2)
    G, Q = sky(rng, 11, groups=2)
    y = rng.normal(size=11)
    mode = np.zeros((1, 11), dtype=bool)
    mode[0, rows] = True
    a = adjust(G, Q, y)
    s = separate(a, mode)
    x_i, S_i = without(G, Q, y, rows)
    assert np.allclose(s.d_en_m[0], (a.x - x_i)[:2], atol=1e-10)
    difference = (S_i - a.gain)[:2]
    assert np.allclose(s.covariance_m2[0], difference @ Q @ difference.T, atol=1e-10)
    assert s.monitored.all()


def test_global_statistic_drops_by_the_mode_statistic() -> None:
    """Excluding a mode lowers ``e'We`` by exactly its statistic."""
    rng = np.random.default_rng(3)
    G, Q = sky(rng, 10)
    y = rng.normal(size=10)
    mode = np.zeros((1, 10), dtype=bool)
    mode[0, [2, 6]] = True
    full, part = adjust(G, Q, y), adjust(G, Q, y, ~mode[0])
    statistic, rank = mode_statistics(full, mode)
    drop = global_test(full, 0.01).statistic - global_test(part, 0.01).statistic
    assert statistic[0] == pytest.approx(drop, rel=1e-9)
    assert rank[0] == 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(6, 14), st.integers(0, 2))
def test_masked_rows_change_nothing(seed: int, m: int, extra: int) -> None:
    """Rows out of use, however wild, leave every result as if they were absent."""
    rng = np.random.default_rng(seed)
    G, Q = sky(rng, m)
    y = rng.normal(size=m)
    wide_G = np.concatenate([G, rng.normal(size=(extra, 4)) * 1e3])
    wide_Q = np.zeros((m + extra, m + extra))
    wide_Q[:m, :m], wide_Q[m:, m:] = Q, np.eye(extra) * 1e-6
    used = np.arange(m + extra) < m
    a, b = adjust(G, Q, y), adjust(wide_G, wide_Q, np.append(y, rng.normal(size=extra) * 1e6), used)
    assert np.allclose(a.x, b.x, rtol=1e-9, atol=1e-12)
    assert np.allclose(w_statistics(a), w_statistics(b)[:m], rtol=1e-9, atol=1e-9)
    assert not w_statistics(b)[m:].any()
    theirs, ours = direction_test(separate(b), 0.01), direction_test(separate(a), 0.01)
    assert np.allclose(theirs.statistic[:m], ours.statistic, rtol=1e-6, atol=1e-9)
    assert np.allclose(theirs.threshold[:m], ours.threshold)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_single_row_modes_agree_in_every_test(seed: int) -> None:
    """A single-row Q_di has rank 1: AT, CT, maximum direction and w-test are one statistic."""
    rng = np.random.default_rng(seed)
    G, Q = sky(rng, 8)
    a = adjust(G, Q, rng.normal(size=8))
    w = np.abs(w_statistics(a))
    s = separate(a)
    direction = direction_test(s, 0.01)
    assert np.allclose(direction.statistic, w**2, rtol=1e-6, atol=1e-9)
    assert np.allclose(direction.threshold, chi2.isf(0.01 / 8, 1))
    track = separation_test(s, 0.4, 0.01)
    assert np.allclose(track.statistic, w[:, None], rtol=1e-6, atol=1e-9)
    assert np.allclose(track.threshold, norm.isf(0.01 / (2 * 2 * 8)))


def test_code_and_phase_of_one_satellite_are_one_mode() -> None:
    """With an ambiguity of its own the phase row cannot be checked: the mode has rank 1 and can be excluded."""
    rng = np.random.default_rng(5)
    code, _ = sky(rng, 7)
    n = 7
    G = np.zeros((2 * n, 4 + n))
    G[:n, :4] = G[n:, :4] = code
    G[n:, 4:] = np.eye(n)
    modes = np.concatenate([np.eye(n), np.eye(n)], -1).astype(bool)
    a = adjust(G, np.diag([1.0] * n + [1e-4] * n), rng.normal(size=2 * n))
    statistic, rank = mode_statistics(a, modes)
    assert (rank == 1).all()
    assert np.allclose(statistic, w_statistics(a)[:n] ** 2, rtol=1e-6)
    assert separate(a, modes).monitored.all()


def test_mode_that_carries_the_geometry_is_not_monitored() -> None:
    rng = np.random.default_rng(6)
    G, Q = sky(rng, 6)
    modes = np.zeros((2, 6), dtype=bool)
    modes[0, :3] = True
    modes[1, 4] = True
    a = adjust(G, Q, rng.normal(size=6))
    assert separate(a, modes).monitored.tolist() == [False, True]
    assert direction_test(separate(a, modes), 0.01).outcome[0] == TestOutcome.NO_REDUNDANCY.code


def simulate(trials: int, bias: Array | None = None) -> Adjustment:
    rng = np.random.default_rng(7)
    G, Q = sky(np.random.default_rng(8), 10)
    noise = rng.normal(size=(trials, 10)) @ np.linalg.cholesky(Q).T
    return adjust(G, Q, noise + (0.0 if bias is None else bias))


def limits(trials: int, probability: float) -> tuple[float, float]:
    """Counts that a correct rate leaves once in 1000 runs."""
    return tuple(binom.ppf([5e-4, 1 - 5e-4], trials, probability))


@pytest.mark.parametrize("alpha", [0.01, 0.1])
def test_false_alarm_rates(alpha: float) -> None:
    """Global test and each row's w-test raise false alarms at their stated rate."""
    trials = 4000
    a = simulate(trials)
    low, high = limits(trials, alpha)
    assert low <= global_test(a, alpha).failed.sum() <= high
    low, high = binom.ppf([5e-5, 1 - 5e-5], trials, alpha)  # ten rows, together once in 1000 runs
    counts = w_test(a, alpha).failed.sum(0)
    assert (low <= counts).all()
    assert (counts <= high).all()


def test_separation_false_alarms_stay_below_alpha() -> None:
    trials = 4000
    s = separate(simulate(trials))
    _, high = limits(trials, 0.05)
    assert separation_test(s, 0.3, 0.05).failed.any((-1, -2)).sum() <= high
    assert direction_test(s, 0.05).failed.any(-1).sum() <= high


def test_two_row_mode_has_two_degrees_of_freedom() -> None:
    trials = 4000
    modes = np.zeros((1, 10), dtype=bool)
    modes[0, [1, 4]] = True
    low, high = limits(trials, 0.05)
    assert low <= w_test(simulate(trials), 0.05, modes).failed.sum() <= high


def test_power_at_the_minimal_detectable_bias() -> None:
    """A bias of MDB size is found by the w-test with the power that sized it, and the same by MDB formula."""
    trials, row = 4000, 3
    mdb = minimal_detectable_bias(simulate(1), noncentrality(0.001, 0.8))[0, row]
    a = simulate(trials, mdb * np.eye(10)[row])
    low, high = limits(trials, 0.8)
    assert low <= w_test(a, 0.001).failed[:, row].sum() <= high


def test_minimal_detectable_bias_closed_form() -> None:
    """Mean of m equal observations: redundancy of each is 1 - 1/m."""
    a = adjust(np.ones((5, 1)), diagonal_covariance(np.full(5, 4.0)), np.zeros(5))
    assert np.allclose(minimal_detectable_bias(a, 17.07), 2.0 * np.sqrt(17.07 / (1 - 1 / 5)))
    alone = adjust(np.ones((1, 1)), np.eye(1), np.zeros(1))
    assert np.isinf(minimal_detectable_bias(alone, 17.07)).all()


def test_outcomes_without_redundancy_and_without_geometry() -> None:
    rng = np.random.default_rng(9)
    G, Q = sky(rng, 6)
    y = rng.normal(size=6)
    four = np.arange(6) < 4
    assert global_test(adjust(G, Q, y, four), 0.01).outcome == TestOutcome.NO_REDUNDANCY.code
    for count in (0, 1, 3):
        a = adjust(G, Q, y, np.arange(6) < count)
        assert global_test(a, 0.01).outcome == TestOutcome.SINGULAR.code
        assert not a.x.any()
    assert np.isfinite(w_statistics(adjust(G, Q, y, four))).all()


def test_batch_of_mixed_outcomes() -> None:
    rng = np.random.default_rng(10)
    G, Q = sky(rng, 7)
    used = np.arange(7) < np.array([[7], [4], [2]])
    y = np.broadcast_to(rng.normal(size=7), (3, 7)).copy()
    y[0, 2] += 100.0
    names = [TestOutcome.from_code(code).name for code in global_test(adjust(G, Q, y, used), 0.01).outcome]
    assert names == ["FAILED", "NO_REDUNDANCY", "SINGULAR"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"observation": [1.0, np.nan, 0, 0, 0]}, "observation"),
        ({"design": np.ones((4, 4))}, "design"),
        ({"covariance": np.eye(4)}, "covariance"),
        ({"covariance": -np.eye(5)}, "positive"),
        ({"covariance": np.ones((5, 5))}, "positive definite"),
        ({"used": [True, False]}, "used"),
    ],
)
def test_bad_input(change: dict[str, object], message: str) -> None:
    given_input = {"design": np.ones((5, 1)), "covariance": np.eye(5), "observation": np.zeros(5)} | change
    with pytest.raises(InputError, match=message):
        adjust(**given_input)  # type: ignore[arg-type]
