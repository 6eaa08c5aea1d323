"""The chain of realised courses: its fit finds a law that is known, and the packaged one has the memory of drives."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lanebound.integrity.sky.journeys.realised import (
    GAP_EDGES_S,
    RUN_EDGES,
    RUNS,
    DrivenWay,
    RealisedLaw,
    _runs,
    packaged_law,
)

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


def test_a_fit_finds_the_probabilities_of_a_known_chain(law: RealisedLaw) -> None:
    found = law.at(np.array([10.0, 20.0]), np.array([2.0, 3.0]))
    # within four standard errors of a share of 1000 samples, fewer than there are: fails by chance once in 1000 runs
    most = 4.0 * np.sqrt(0.25 / 1000.0)
    np.testing.assert_allclose(found.rtk_after[:, 0], COMES, atol=most)
    np.testing.assert_allclose(found.rtk_after[:, 1], KEEPS, atol=most)
    np.testing.assert_allclose(found.usable_after[:, 1], USED, atol=2.0 * most)
    table = law.bridged_table()
    assert table.shape == (2, RUNS, 64, GAP_EDGES_S.size + 1)
    np.testing.assert_allclose(table[1, -1, 6:29, 2:9], USED, atol=3.0 * most)


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
