"""The chain of realised courses: its fit finds a law that is known, and the packaged one has the memory of drives."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from lanebound.integrity.core.splines import _penalty
from lanebound.integrity.sky.availability import Fit
from lanebound.integrity.sky.journeys.realised import (
    GAP_EDGES_S,
    RUN_EDGES,
    RUNS,
    DrivenWay,
    RealisedLaw,
    _runs,
    packaged_law,
)

Array = NDArray[np.float64]

KEEPS, COMES, USED = 0.9, 0.2, 0.7  # probability that RTK stays, that it comes, that a position is usable


def driven(seed: int, stations: int = 400) -> DrivenWay:
    """A drive by a chain that depends neither on satellites nor on runs; levels tell the state."""
    rng = np.random.default_rng(seed)
    rtk = np.zeros(stations, dtype=np.bool_)
    for k in range(1, stations):
        rtk[k] = rng.random() < (KEEPS if rtk[k - 1] else COMES)
    usable = rng.random(stations) < USED
    level = 1.0 * rtk + 2.0 * usable + 0.5 * rng.random(stations)
    number = rng.integers(5, 30, stations).astype(float)
    return DrivenWay(number, rng.uniform(1.0, 5.0, stations), np.ones(stations), rtk, usable, level)


@pytest.fixture(scope="module")
def law() -> RealisedLaw:
    """The law of 100 such drives."""
    return RealisedLaw.fitted([driven(seed) for seed in range(100)])


def allowed(fit: Fit, share: float, rows: Array, at: Array) -> Array:
    """Four standard errors of a share that a regression on samples (n, 2) finds at points (m, 2)."""
    columns, own, weight = fit.basis.at(*rows.T), fit.basis.at(*at.T), share * (1.0 - share)
    spread = np.linalg.inv(weight * columns.T @ columns + np.diag(_penalty(columns)))
    return 4.0 * weight * np.sqrt(np.einsum("ij,jk,ik->i", own, spread, own))


def test_a_fit_finds_the_probabilities_of_a_known_chain(law: RealisedLaw) -> None:
    ways = [driven(seed) for seed in range(100)]
    number, pdop, gap, rtk = (
        np.concatenate([getattr(way, name)[1:] for way in ways]) for name in ("satellites", "pdop", "gap_s", "rtk")
    )
    had, had_run, used, used_run = (
        np.concatenate([of[:-1] for of in each])
        for name in ("rtk", "usable")
        for each in ([getattr(way, name) for way in ways], [_runs(getattr(way, name)) for way in ways])
    )
    seen, bridging = np.stack([number, np.log(pdop)], -1), np.stack([number, np.log1p(gap)], -1)
    points = np.array([10.0, 20.0]), np.array([2.0, 3.0])
    found, at = law.at(*points), np.stack([points[0], np.log(points[1])], -1)
    table = law.bridged_table()
    assert table.shape == (2, RUNS, 64, GAP_EDGES_S.size + 1)
    cells = [(n, c) for n in range(6, 29) for c in range(2, 9)]
    middles = np.array([(n, np.log1p(np.sqrt(GAP_EDGES_S[c - 1] * GAP_EDGES_S[c]))) for n, c in cells])
    compared = 0
    for run in range(RUNS):
        for was in (0, 1):
            in_use = (used == was) & (used_run == run)
            for fits, values, share, own, rows, where in (
                (law.rtk, found.rtk_after[:, was, run], (COMES, KEEPS)[was], (had == was) & (had_run == run), seen, at),
                (law.usable, found.usable_after[:, was, run], USED, rtk & in_use, seen, at),
                (law.bridged, [table[was, run, n, c] for n, c in cells], USED, ~rtk & in_use, bridging, middles),
            ):
                if own.sum() > 200:  # of most, thousands
                    most = allowed(fits[was][run], share, rows[own], where)
                    assert (np.abs(np.array(values) - share) <= most).all()
                    compared += 1
    assert compared >= 18  # of 24; positions are lost for eight stations in a row hardly ever


def test_below_five_satellites_there_is_no_rtk(law: RealisedLaw) -> None:
    assert (law.at(np.array([0.0, 4.0]), np.array([2.0, 2.0])).rtk_after == 0.0).all()
    assert (law.at(np.array([5.0]), np.array([2.0])).rtk_after > 0.0).all()


def test_quantiles_of_levels_are_those_of_their_state(law: RealisedLaw) -> None:
    for rtk in range(2):
        for usable in range(2):
            low = 1.0 * rtk + 2.0 * usable
            assert ((law.levels[rtk, usable] >= low) & (law.levels[rtk, usable] <= low + 0.5)).all()
    assert (np.diff(law.levels, axis=-1) >= 0.0).all()
    assert abs(law.correlation) < 0.05  # drawn independently: 40,000 pairs, sigma 0.005


def test_runs_count_stations_in_one_state() -> None:
    states = np.array([True, True, False, False, False, False, True, False])
    beyond = RUN_EDGES.size
    np.testing.assert_array_equal(_runs(states), [beyond, beyond, *np.searchsorted(RUN_EDGES, [1, 2, 3, 4, 1, 1])])


def test_a_law_is_the_same_from_its_plain_data(law: RealisedLaw) -> None:
    again = RealisedLaw.of(json.loads(json.dumps(law.to_dict())))
    np.testing.assert_array_equal(again.bridged_table(), law.bridged_table())
    number, pdop = np.array([3.0, 12.0]), np.array([4.0, 2.0])
    for a, b in zip(again.at(number, pdop), law.at(number, pdop), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_packaged_law_keeps_states_the_longer_they_last() -> None:
    law = packaged_law()
    found = law.at(np.array([12.0, 25.0]), np.array([3.0, 1.5]))
    assert (found.rtk_after[1, 1] > 0.8).all()
    assert (found.rtk_after[:, 1] > found.rtk_after[:, 0]).all()
    assert (found.rtk_after[:, 0, -1] < found.rtk_after[:, 0, 0]).all()
    table = law.bridged_table()
    assert table[1, -1, 20, 0] > table[0, -1, 20, 0]
    assert table[1, -1, 12, 4] > table[1, -1, 12, 28]  # dead reckoning lasts for some time
    assert 0.3 < law.correlation < 0.9
