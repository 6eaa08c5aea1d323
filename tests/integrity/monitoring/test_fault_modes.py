"""Fault modes against counting and enumeration of all events."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.special import comb

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.fault_modes import enumerate_faults

TWO_SYSTEMS = np.repeat([0, 1], 5)


def test_single_faults_suffice_for_the_araim_example() -> None:
    modes = enumerate_faults(TWO_SYSTEMS, 1e-5, 1e-4)
    assert len(modes) == 12  # WG-C ARAIM ADD v3.1, appendix D
    # multiple faults of 10 satellites and 2 constellations, in Stanford's MAAST (maast_for_araim_2): 3.4496e-8
    assert modes.unmonitored == pytest.approx(3.449595977898963e-8, rel=1e-6)
    np.testing.assert_array_equal(modes.removes.sum(-1), [1] * 10 + [5] * 2)
    np.testing.assert_allclose(modes.prior, [1e-5] * 10 + [1e-4] * 2)


def test_likelier_faults_ask_for_pairs() -> None:
    modes = enumerate_faults(TWO_SYSTEMS, 1e-3, 0.0, unmonitored_below=1e-7)
    assert len(modes) == 10 + comb(10, 2) + comb(10, 3)
    assert modes.unmonitored < 1e-7
    assert len(enumerate_faults(TWO_SYSTEMS, 1e-3, 0.0, unmonitored_below=1e-7, at_once=2)) == 10 + comb(10, 2)


def test_modes_that_remove_the_same_satellites_are_one() -> None:
    modes = enumerate_faults(TWO_SYSTEMS, 1e-4, 1e-4, at_once=2)
    # a satellite beside its own constellation is that constellation's mode: 10 + 45 + 2 + 10 others + 1 of everything
    assert len(modes) == 10 + 45 + 2 + 10 + 1
    whole = modes.prior[modes.removes.sum(-1) == 5]
    np.testing.assert_allclose(whole, 1e-4 + 5 * 1e-8)


def test_priors_and_what_is_left_cover_everything() -> None:
    """Every combination of five events, summed: their modes' priors bound it, and what is left is exact."""
    prior, group = np.array([0.02, 0.01, 0.03]), np.array([0, 0, 1])
    system = np.array([0.05, 0.005])
    modes = enumerate_faults(group, prior, system, unmonitored_below=1e-9, at_once=2)
    chance = np.concatenate([prior, system])
    beyond = sum(
        np.prod(np.where(state, chance, 1.0 - chance)) for state in product([False, True], repeat=5) if sum(state) > 2
    )
    assert modes.unmonitored == pytest.approx(beyond, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((TWO_SYSTEMS, 1.0), "satellite_prior"),
        ((TWO_SYSTEMS, 1e-5, [1e-4] * 3), "constellation_prior"),
        ((np.zeros(200), 0.1), "at most 100000 modes"),
    ],
)
def test_bad_priors_are_refused(arguments: tuple, message: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(InputError, match=message):
        enumerate_faults(*arguments)


def test_a_mode_has_at_least_one_event() -> None:
    with pytest.raises(InputError, match="at_once"):
        enumerate_faults(TWO_SYSTEMS, 1e-5, at_once=0)
