"""The exclusion loop: it finds what was put in, stops where it should, and the kernel does the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom
from signal_records import rows_of

from lanebound.integrity.monitoring import detection_kernel
from lanebound.integrity.monitoring.detection import diagonal_covariance
from lanebound.integrity.monitoring.exclusion import (
    FdeConfig,
    FdeOutcome,
    FdeResult,
    Search,
    detect_and_exclude,
    fde_parameters,
    fde_thresholds,
)
from lanebound.integrity.monitoring.significance import Linking

Array = NDArray[np.float64]


def directions(rng: np.random.Generator, *shape: int) -> Array:
    """Unit vectors to satellites above 10 degrees."""
    azimuth, sin_el = rng.uniform(0, 2 * np.pi, shape), rng.uniform(np.sin(np.radians(10)), 1, shape)
    cos_el = np.sqrt(1 - sin_el**2)
    return np.stack([cos_el * np.sin(azimuth), cos_el * np.cos(azimuth), sin_el], -1)


def design_of(los: Array, group: NDArray[np.int64]) -> Array:
    clocks = np.broadcast_to(np.eye(int(group.max()) + 1)[group], (*los.shape[:-1], int(group.max()) + 1))
    return np.concatenate([-los, clocks], -1)


def run(config: FdeConfig, faults: dict[int, float], m: int = 12, trials: int = 1, **kwargs: Any) -> FdeResult:
    rng = np.random.default_rng(11)
    G = design_of(directions(rng, m), np.zeros(m, dtype=np.int64))
    y = rng.normal(size=(trials, m))
    for row, size in faults.items():
        y[:, row] += size
    return detect_and_exclude(config, G, np.eye(m), y, **kwargs)


def outcome(result: FdeResult) -> str:
    return FdeOutcome.from_code(int(result.outcome[0])).name


@pytest.mark.parametrize("search", list(Search))
@pytest.mark.parametrize("linking", list(Linking))
@pytest.mark.parametrize("faults", [{3: 60.0}, {1: 50.0, 8: -80.0}])
def test_finds_one_and_two_outliers(search: Search, linking: Linking, faults: dict[int, float]) -> None:
    config = FdeConfig(alpha=0.001, search=search, linking=linking)
    result = run(config, faults, heading_rad=0.7)
    assert outcome(result) == "EXCLUDED"
    assert np.flatnonzero(~result.used[0]).tolist() == sorted(faults)
    assert not result.overall.failed.any()
    assert result.worst[0] < 1.0


def test_multi_row_mode_is_excluded_whole() -> None:
    modes = np.repeat(np.eye(6), 2, axis=1).astype(bool)
    result = run(FdeConfig(alpha=0.001, search=Search.DIRECTION), {4: 40.0}, modes=modes)
    assert np.flatnonzero(~result.used[0]).tolist() == [4, 5]
    assert result.excluded[0].tolist() == [False, False, True, False, False, False]


def test_clean_data_false_alarms() -> None:
    """Bonferroni over global and local tests: at most 2 alpha of clean epochs alarm."""
    trials = 3000
    result = run(FdeConfig(alpha=0.02, search=Search.W_TEST), {}, trials=trials)
    alarmed = int((result.outcome != FdeOutcome.CLEAN.code).sum())
    low, high = binom.ppf(5e-4, trials, 0.02), binom.ppf(1 - 5e-4, trials, 0.04)
    assert low <= alarmed <= high


def test_stops_at_the_limit_and_says_so() -> None:
    result = run(FdeConfig(alpha=0.001, max_excluded=1), {1: 50.0, 8: -80.0})
    assert outcome(result) == "UNRESOLVED"
    assert result.excluded[0].sum() == 1
    assert outcome(run(FdeConfig(alpha=0.001, max_excluded=0), {1: 50.0})) == "UNRESOLVED"


def test_one_redundant_row_detects_but_cannot_identify() -> None:
    result = run(FdeConfig(alpha=0.001), {1: 500.0}, m=5)
    assert outcome(result) == "UNRESOLVED"
    assert result.excluded[0].sum() == 0


@pytest.mark.parametrize(("m", "name"), [(4, "NO_REDUNDANCY"), (3, "SINGULAR"), (1, "SINGULAR")])
def test_too_few_rows(m: int, name: str) -> None:
    assert outcome(run(FdeConfig(), {}, m=m)) == name


def test_masked_rows_are_never_excluded_nor_counted() -> None:
    used = np.arange(12) != 3
    result = run(FdeConfig(alpha=0.001), {3: 1e6}, used=used)
    assert outcome(result) == "CLEAN"
    assert result.adjustment.df[0] == 7
    assert result.excluded[0].sum() == 0


def _informative(used: NDArray[np.bool_], group: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows (B, n) in use but those alone with their clock.

    Of a constellation of two satellites with a clock of its own, either satellite and both are modes of one statistic
    and one solution; rounding decides which of them is excluded.
    """
    alone = (used[:, None, :] & (group == group[:, None])).sum(-1) == 1
    return used & ~alone


def compare(
    los: Array, group: NDArray[np.int64], variance: Array, y: Array, used: NDArray[np.bool_], config: FdeConfig,
    system: NDArray[np.int64] | None = None, heading: float = 0.0,
) -> NDArray[np.int64]:  # fmt: skip
    """Kernel against reference, every output; with ``system`` its constellations are modes too. Returns outcomes."""
    B, n = y.shape
    whole = system is not None
    owner = group if system is None else system
    modes = np.concatenate([np.eye(n, dtype=bool), owner == np.unique(owner)[:, None]]) if whole else None
    tables, thresholds, rules = config.tables(n), fde_thresholds(config, n, whole), fde_parameters(config, whole)[0]
    mask, x, Q = used.copy(), np.empty((B, 3)), np.empty((B, 3, 3))
    code, df, count = (np.empty(B, dtype=np.int64) for _ in range(3))
    statistic, worst = np.empty(B), np.empty(B)
    for v in range(B):
        rows = rows_of(los[v], group, used[v], variance[v], y[v], owner)
        code[v], statistic[v], worst[v], df[v], count[v] = detection_kernel.detect_and_exclude(
            rows, heading, thresholds, rules, x[v], Q[v]
        )
        mask[v] = rows["used"]
    ref = detect_and_exclude(
        config, design_of(los, group), diagonal_covariance(variance), y, used, modes=modes, heading_rad=heading
    )
    assert np.array_equal(code, ref.outcome)
    same = (mask == ref.used).all(1)
    assert np.array_equal(_informative(mask, group), _informative(ref.used, group))
    assert whole or same.all()
    assert np.array_equal(count[same], (used & ~ref.used).sum(1)[same])
    assert np.allclose(x, ref.adjustment.x[:, :3], rtol=1e-9, atol=1e-9)
    S = ref.adjustment.gain[:, :3]
    assert np.allclose(
        Q[code != 4], (S @ diagonal_covariance(variance) @ S.swapaxes(1, 2))[code != 4], rtol=1e-9, atol=1e-9
    )
    tested = code <= FdeOutcome.UNRESOLVED.code
    assert np.allclose(statistic[tested], ref.overall.statistic[tested], rtol=1e-9)
    assert np.array_equal(df[tested], ref.adjustment.df[tested])
    if not whole:
        limit = tables.local_normal[df, mask.sum(1)]
        assert np.allclose((worst / limit)[tested] ** 2, ref.worst[tested], rtol=1e-9, atol=1e-9)
    return code


@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("global_first", [True, False])
@pytest.mark.parametrize("search", list(Search))
@pytest.mark.parametrize("linking", list(Linking))
def test_kernel_equals_reference(groups: int, global_first: bool, search: Search, linking: Linking) -> None:
    rng = np.random.default_rng(12)
    B, n = 60, 14
    los, group = directions(rng, B, n), rng.integers(0, groups, n)
    group[:groups] = np.arange(groups)
    variance = rng.uniform(0.5, 3.0, (B, n))
    y = rng.normal(size=(B, n)) * np.sqrt(variance) + (rng.random((B, n)) < 0.1) * rng.normal(size=(B, n)) * 30
    used = rng.random((B, n)) < rng.uniform(0.2, 1.0, (B, 1))
    compare(los, group, variance, y, used, FdeConfig(global_first=global_first, search=search, linking=linking))


@pytest.mark.parametrize("own_clocks", [True, False])
@pytest.mark.parametrize("global_first", [True, False])
@pytest.mark.parametrize("search", list(Search))
@pytest.mark.parametrize("linking", list(Linking))
def test_kernel_equals_reference_for_constellations(
    own_clocks: bool, global_first: bool, search: Search, linking: Linking
) -> None:
    """Faults of satellites and of constellations, with a clock for each (positions) and one for all (velocities)."""
    rng = np.random.default_rng(14)
    B, n = 60, 16
    los, system = directions(rng, B, n), np.sort(rng.integers(0, 3, n))
    system[[0, -1]] = 0, 2
    variance, heading = rng.uniform(0.5, 3.0, (B, n)), 0.8
    ramp = rng.normal(size=(B, n)) * 15 * (system == rng.integers(0, 3, (B, 1))) * (rng.random((B, 1)) < 0.7)
    y = rng.normal(size=(B, n)) * np.sqrt(variance) + ramp
    y += (rng.random((B, n)) < 0.03) * rng.normal(size=(B, n)) * 40
    used = rng.random((B, n)) < rng.uniform(0.5, 1.0, (B, 1))
    group = system if own_clocks else np.zeros(n, dtype=np.int64)
    config = FdeConfig(global_first=global_first, search=search, linking=linking)
    code = compare(los, group, variance, y, used, config, system, heading)
    assert set(code) >= {FdeOutcome.CLEAN.code, FdeOutcome.EXCLUDED.code, FdeOutcome.UNRESOLVED.code}


def test_kernel_when_a_constellation_has_one_satellite() -> None:
    """A row alone with its clock has no redundancy: wild or not, it is neither tested nor excluded."""
    rng = np.random.default_rng(13)
    los, group = directions(rng, 4, 8), np.array([0, 0, 0, 0, 0, 0, 0, 1])
    y = rng.normal(size=(4, 8))
    y[:, 7] += 1e3
    compare(los, group, np.ones((4, 8)), y, np.ones((4, 8), dtype=bool), FdeConfig())


def test_outcome_carries_advice() -> None:
    assert "may be used" in FdeOutcome.CLEAN.value
    assert FdeOutcome.from_code(3) is FdeOutcome.NO_REDUNDANCY
    assert FdeOutcome.count([0, 0, 2])["unresolved"] == 1
