"""Vehicles that join a navigator from another one, under skies of their own."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from lanebound.integrity.errors import InputError
from lanebound.integrity.navigator import Navigator, NavigatorConfig
from lanebound.integrity.streams import STREAM_NAMES, Streams
from lanebound.integrity.truth import Truth, truth_between

DT_S, MPS = 0.1, 8.0


def _truth(epoch: int, vehicles: int) -> Truth:
    """Everybody straight on to the North."""
    before, after = (np.tile([[0.0, MPS * DT_S * n]], (vehicles, 1)) for n in (epoch - 1, epoch))
    velocity, heading = np.tile([[0.0, MPS]], (vehicles, 1)), np.zeros(vehicles)
    return truth_between(epoch * DT_S, DT_S, (before, after), (velocity, velocity), (heading, heading), arc_m=0.0)


def _share(navigator: Navigator, row: int, other: Navigator) -> None:
    """The other's generators for a row, to be drawn from by both alike."""
    for streams in (navigator.state.streams, navigator.state.area.streams):
        for name in STREAM_NAMES:
            streams.states(name)[row] = other.state.streams.states(name)[0]


def test_a_vehicle_taken_over_goes_on_as_it_would_have() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2, 3], duration_s=60.0)
    other = navigator.another(Streams([9]), epoch=17)
    for epoch in range(1, 21):
        navigator.step(_truth(epoch, 3))
        if epoch > 17:
            other.step(_truth(epoch, 1))
    alone = copy.deepcopy(navigator)
    navigator.adopt(np.array([1]), other)
    _share(navigator, 1, other)
    for epoch in range(21, 60):
        both, single, before = (
            navigator.step(_truth(epoch, 3)),
            other.step(_truth(epoch, 1)),
            alone.step(_truth(epoch, 3)),
        )
    for mine, theirs, row in ((both, single, 0), (both, before, 0), (both, before, 2)):
        place = 1 if theirs is single else row
        np.testing.assert_array_equal(mine.position_en_m[place], theirs.position_en_m[row])
        np.testing.assert_array_equal(mine.pl_cases_m[place], theirs.pl_cases_m[row])
        assert mine.mode[place] == theirs.mode[row]
        assert mine.corrections_age_s[place] == theirs.corrections_age_s[row]
    picked = both.rows(np.array([2, 0]))
    np.testing.assert_array_equal(picked.pl_at_m, both.pl_at_m[[2, 0]])
    assert picked.time_s == both.time_s


def test_a_sky_of_ones_own_is_used() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    sky = navigator.track.at(navigator.track.start_s + 30.0, np.zeros(2, dtype=np.int64))
    assert navigator.measure(_truth(1, 2), sky).sky is sky


def test_clocks_must_agree() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    with pytest.raises(InputError, match="epoch"):
        navigator.adopt(np.array([0]), navigator.another(Streams([5]), epoch=3))
