"""Signals as entries of their own: the same as bands of a satellite, in the filter, in the search and for suspects."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from signal_records import records_of, rows_of

from lanebound.integrity.navigators.rtk_reckoning.navigator import blank_filters
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import MARK
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import find_members
from lanebound.integrity.positioning.codes_kernel import FIXED, RATIO_FAILED
from lanebound.integrity.positioning.float_filter_kernel import (
    add_epoch,
    assign_slots,
    fade,
    filter_of,
    filtered_ambiguities,
    follows,
)
from lanebound.integrity.positioning.parameters import rtk_parameters
from lanebound.integrity.positioning.resolve_kernel import resolve
from lanebound.integrity.positioning.rtk_config import RtkConfig
from lanebound.integrity.positioning.rtk_kernel import AMBIGUITY, SATELLITE, Carriers
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL
from lanebound.integrity.sky.systems import WAVELENGTH_M

Array = NDArray[np.float64]
SYSTEM = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
N = len(SYSTEM)
CODE_M, PHASE_M = 0.3, 0.004
WAVE = WAVELENGTH_M[SYSTEM][:, [0, 2]]
FLOATS = {"kind": "sequential", "ionosphere_m": 0.02, "troposphere_m": 0.01}


def sky() -> Array:
    azimuth, rng = np.linspace(0.0, 2.0 * np.pi, N, endpoint=False), np.random.default_rng(1)
    elevation = rng.uniform(0.26, 1.4, N)
    c = np.cos(elevation)
    return np.column_stack([c * np.sin(azimuth), c * np.cos(azimuth), np.sin(elevation)])


def apart() -> NDArray[np.void]:
    """Each band of each satellite as an entry: first bands, then second ones, whose clocks are groups of their own."""
    out = np.zeros(2 * N, SATELLITE)
    out["system"], out["fixable"] = np.concatenate([SYSTEM, SYSTEM + 2]), True
    out["wavelength"][:, 0] = WAVE.T.ravel()
    out["further"][N:], out["host"], out["first"] = True, np.tile(np.arange(N), 2), np.tile(WAVE[:, 0], 2)
    return out


def together() -> NDArray[np.void]:
    out = np.zeros(N, SATELLITE)
    out["system"], out["fixable"], out["wavelength"] = SYSTEM, True, WAVE
    return out


class Filter:
    """A filter of two-band satellites, or of one-band entries."""

    def __init__(self, satellites: NDArray[np.void], bands: int) -> None:
        config = RtkConfig(max_candidates=2 * N + 1, float_solution=FLOATS)
        self.bands, self.satellites, self.n = bands, satellites, len(satellites)
        self.rules: Any = rtk_parameters(config, bands, 1e-5)[0]
        self.own = filter_of(blank_filters(1, config), 0)
        self.ambiguities = np.zeros(self.n, AMBIGUITY)

    def add(self, code: Array, phase: Array, used: NDArray[np.bool_]) -> Carriers:
        """Add an epoch; code, phase (N, 2), used (N,)."""
        if self.bands == 1:
            empty = np.zeros(self.n)
            code, phase = (np.column_stack([a.T.ravel(), empty]) for a in (code, phase))
            used = np.tile(used, 2)
        carriers, order = self.carriers(code, phase), np.flatnonzero(used)
        fade(self.own, 1.0, self.rules)
        assign_slots(self.own, carriers, order, order.size, self.ambiguities, self.rules)
        assert add_epoch(self.own, carriers, np.full(self.n, CODE_M**2), used, used, self.rules)
        return carriers

    def carriers(self, code: Array | float, phase: Array) -> Carriers:
        """Carriers of the entries; code, phase (n, 2)."""
        e = np.tile(sky(), (self.n // N, 1))
        signals = records_of(OBSERVED_SIGNAL, self.n, e=e, code=code, phase=phase)
        return Carriers(self.satellites, signals, np.full(self.n, PHASE_M**2))

    def floats(self, carriers: Carriers, rows: NDArray[np.int64]) -> dict[tuple[int, int], tuple[float, Array]]:
        """By satellite and band, the ambiguity and its row of the covariance."""
        a, q, owner = np.empty(2 * N), np.empty((2 * N, 2 * N)), np.empty(2 * N, np.int64)
        n = filtered_ambiguities(carriers, rows, rows.size, self.ambiguities, self.own, self.rules, a, q, owner)
        keys = [(int(s) % N, int(s) // N if self.bands == 1 else i % 2) for i, s in enumerate(owner[:n])]
        order = sorted(range(n), key=lambda i: keys[i])
        return {keys[i]: (float(a[i]), q[i, order]) for i in order}


def test_the_filter_is_that_of_two_bands() -> None:
    """With an ionosphere of each satellite, a zenith delay, errors that last, and a satellite that rises."""
    pair, single, rng = Filter(together(), 2), Filter(apart(), 1), np.random.default_rng(2)
    true = np.round(rng.uniform(-1e5, 1e5, (N, 2)))
    for k in range(5):
        range_m, clock = -(sky() @ rng.normal(0.0, 10.0, 3))[:, None], 100.0 * rng.standard_normal((2, 2, 2))[SYSTEM]
        code = range_m + clock[:, 0] + rng.normal(0.0, CODE_M, (N, 2))
        phase = range_m + clock[:, 1] + WAVE * true + rng.normal(0.0, PHASE_M, (N, 2))
        used = np.ones(N, np.bool_)
        used[4] = k > 1
        carriers = [f.add(code, phase, used) for f in (pair, single)]
    wanted = pair.floats(carriers[0], np.arange(N))
    found = single.floats(carriers[1], np.arange(2 * N))
    assert list(found) == list(wanted)
    assert len(wanted) == 2 * (N - 2)
    for key, (value, row) in wanted.items():
        assert found[key][0] == pytest.approx(value, abs=1e-5), key
        np.testing.assert_allclose(found[key][1], row, rtol=1e-6, atol=1e-9)


def test_a_further_signal_is_followed_only_with_its_satellite() -> None:
    single, used = Filter(apart(), 1), np.ones(2 * N, np.bool_)
    used[3] = False  # the first band of satellite 3
    carriers = single.carriers(1.0, np.ones((2 * N, 2)))
    order = np.flatnonzero(used)[::-1].copy()  # further ones first
    assign_slots(single.own, carriers, order, order.size, single.ambiguities, single.rules)
    followed = [follows(single.own.slots, s) >= 0 for s in range(2 * N)]
    assert [s for s in range(2 * N) if not followed[s]] == [3, N + 3]


def test_a_satellite_under_suspicion_is_left_out_with_all_its_signals() -> None:
    """Both signals of satellite 2 are off by half a cycle: no set that has one of them fits."""
    rng, single = np.random.default_rng(3), Filter(apart(), 1)
    true = np.round(rng.uniform(-1e4, 1e4, (N, 2)))
    x, clock = rng.normal(0.0, 10.0, 3), 50.0 * rng.standard_normal((2, 2))[SYSTEM]
    phase = -(sky() @ x)[:, None] + clock + WAVE * (true + 0.5 * (np.arange(N) == 2)[:, None])
    phase += rng.normal(0.0, 0.001, (N, 2))
    carriers = single.carriers(0.0, np.column_stack([phase.T.ravel(), np.zeros(2 * N)]))
    place, q = x + rng.normal(0.0, 0.02, 3), 0.05**2 * np.eye(3)
    for attempts, wanted in ((0, RATIO_FAILED), (1, FIXED)):
        rules, ambiguities = single.rules, np.zeros(2 * N, AMBIGUITY)
        rules["attempts"], rules["max_candidates"], rules["fix_limit"] = attempts, 2 * N, 1e-4
        candidate = np.ones(2 * N, np.bool_)
        status, _ = resolve(carriers, candidate, ambiguities, rules, place.copy(), q.copy(), single.own, False, 1)
        assert status == wanted
        assert candidate.all()
    assert np.flatnonzero(~ambiguities["held"]).tolist() == [2, N + 2]
    off = ambiguities["integers"][:, 0].reshape(2, N) - true.T
    for system in (0, 1):
        mine = (system == SYSTEM) & (np.arange(N) != 2)
        assert (np.ptp(off[:, mine], axis=1) == 0.0).all()
    rows, marks = rows_of(np.tile(sky(), (2, 1)), 0, False), records_of(MARK, 2 * N, used=True)
    count, positioned = find_members(ambiguities, marks, single.satellites, rules, rows)
    assert (count, positioned) == (N - 1, True)  # positions take the first signals alone
    assert rows["used"].tolist() == [s != 2 for s in range(N)] + N * [False]
