"""Slips that one signal of a satellite shows of another, and which satellites make the code position."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.positioning.config import RtkConfig
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.replay.baseline import PLENTY, SlipComparison, code_rows
from lanebound.integrity.replay.differences import Reduced
from lanebound.integrity.replay.rtk_stages import Entries, Signals

SATELLITES, COLUMNS = 6, 3
N = SATELLITES * COLUMNS
WAVE = np.array([0.1903, 0.2442, 0.2548])


def entries() -> Entries:
    satellite, column = np.repeat(np.arange(SATELLITES), COLUMNS), np.tile(np.arange(COLUMNS), SATELLITES)
    return Entries(satellite, column, column.copy(), satellite * COLUMNS, WAVE[column], np.ones(N, np.bool_))


def signals(phase: np.ndarray) -> Signals:
    there = np.ones(N, np.bool_)
    los = np.tile([0.0, 0.0, 1.0], (N, 1))
    return Signals(los, np.ones(N), there, np.full(N, 45.0), np.ones(N), phase, np.zeros(N, np.bool_))


def test_a_jump_of_one_signal_marks_it_and_those_it_is_compared_with() -> None:
    """Motion of metres and clocks of each signal do not count; a slip of one cycle of satellite 2 does."""
    rng, compare = (
        np.random.default_rng(1),
        SlipComparison(entries(), RtkConfig(sigma_phase_m=0.004), CycleSlipConfig()),
    )
    e, start = entries(), 100.0 * rng.standard_normal(N)
    for k in range(6):
        moved = (
            np.repeat(5.0 * rng.standard_normal(SATELLITES), COLUMNS) + (30.0 * rng.standard_normal(COLUMNS))[e.column]
        )
        slip = e.wavelength_m * ((k >= 3) & (e.satellite == 2) & (e.column == 1))
        lost = compare.lost(signals(start + moved + slip + rng.normal(0.0, 0.002, N)), 1.0)
        if k == 3:
            assert lost[e.satellite == 2].all()
            assert not lost[e.satellite != 2].any()
        else:
            assert not lost.any(), k


def test_a_satellite_that_returns_is_not_compared_with_before() -> None:
    compare = SlipComparison(entries(), RtkConfig(), CycleSlipConfig())
    for phase in (np.ones(N), np.where(np.arange(N) == 4, 0.0, 1.0), np.where(np.arange(N) == 4, 7.0, 1.0)):
        assert not compare.lost(signals(phase), 1.0).any()


def reduced(both: int, satellites: int = 12) -> Reduced:
    """One epoch whose first ``both`` satellites have two signals; codes 1 and 3 m."""
    tracked = np.zeros((satellites, 4), np.bool_)
    tracked[:, 0], tracked[:both, 1] = True, True
    code = np.where(tracked, [1.0, 3.0, 0.0, 0.0], 0.0)
    los, none = np.tile([0.0, 0.0, 1.0], (satellites, 1)), np.zeros((satellites, 4))
    return Reduced(los, code, none, np.full((satellites, 4), 60.0), tracked, none > 0.0)


def test_codes_of_two_bands_are_averaged_where_enough_satellites_have_both() -> None:
    rtk = RtkConfig(sigma_code_m=0.4)
    for both, rows, y, variance in ((PLENTY, PLENTY, 2.0, 0.08), (PLENTY - 1, 12, 1.0, 0.16)):
        epoch = reduced(both)
        found = code_rows(epoch, epoch.sight_enu, rtk)
        assert found[0].size == rows
        np.testing.assert_allclose(found[1], y)
        np.testing.assert_allclose(found[2], variance, rtol=0.01)
