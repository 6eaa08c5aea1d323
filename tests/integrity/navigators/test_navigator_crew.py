"""Vehicles that join a navigator from another one, under skies of their own."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Navigator, NavigatorConfig
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.sensors.faults import Fault, FaultSchedule

DT_S, MPS = 0.1, 8.0


def _truth(epoch: int, *own: int) -> Truth:
    """Everybody straight on to the North; ``own``: epochs of each vehicle."""
    before, after = (np.array([[0.0, MPS * DT_S * (n + past)] for n in own]) for past in (-1, 0))
    velocity, heading = np.tile([[0.0, MPS]], (len(own), 1)), np.zeros(len(own))
    return truth_between(epoch * DT_S, DT_S, (before, after), (velocity, velocity), (heading, heading), arc_m=0.0)


def _step(navigator: Navigator, truth: Truth) -> Solution:
    """Under a sky that stands still, for clocks differ."""
    sky = navigator.track.at(navigator.track.start_s + 30.0, np.zeros(navigator.batch, dtype=np.int64))
    return navigator.locate(navigator.measure(truth, sky))


def _share(navigator: Navigator, row: int, other: Navigator, theirs: int) -> None:
    """The other's generators for a row, to be drawn from by both alike."""
    for streams in (navigator.state.streams, navigator.state.area.streams):
        streams.adopt(np.array([row]), other.state.streams, np.array([theirs]))


@pytest.mark.parametrize("when", [10, 17, 23])
def test_a_vehicle_taken_over_goes_on_as_it_would_have(when: int) -> None:
    """Wherever the clocks of both are: its messages come, and its area changes, by its own."""
    config = NavigatorConfig.load({"corrections": {"outage_per_h": 900.0}, "imu": {"mems_exponential": True}})
    navigator = Navigator.nominal(config, [1, 2, 3], duration_s=60.0)
    other = navigator.another(Streams([8, 9]))
    for epoch in range(1, 21):
        _step(navigator, _truth(epoch, *3 * [epoch]))
    for epoch in range(1, when + 1):
        _step(other, _truth(epoch, epoch, epoch))
    alone = copy.deepcopy(navigator)
    navigator.adopt(np.array([1]), other, np.array([1]))
    _share(navigator, 1, other, 1)
    for epoch in range(21, 60):
        own = when + epoch - 20
        both = _step(navigator, _truth(epoch, epoch, own, epoch))
        single = _step(other, _truth(own, own, own)).rows(np.array([1]))
        before = _step(alone, _truth(epoch, *3 * [epoch]))
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
    assert navigator.measure(_truth(1, 1, 1), sky).sky is sky


def test_who_has_a_time_of_ones_own_needs_a_sky() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    navigator.adopt(np.array([0]), navigator.another(Streams([5])), np.array([0]))
    navigator.step(_truth(1, 1, 1))  # still of one time
    navigator.adopt(np.array([0]), navigator.another(Streams([5])), np.array([0]))
    kept = navigator.snapshot()
    with pytest.raises(InputError, match="sky"):
        navigator.step(_truth(2, 1, 2))
    again = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    again.restore(kept)
    with pytest.raises(InputError, match="sky"):
        again.step(_truth(2, 1, 2))


def test_who_shares_generators_or_faults_is_not_handed_over() -> None:
    own = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    joint = Navigator.nominal(NavigatorConfig(), 1, 2, duration_s=60.0)
    faulty = Navigator(own.config, own.track, own.mask, [1, 2], faults=FaultSchedule((Fault(kind="odometer_frozen"),)))
    for one, two in ((own, joint), (joint, own), (own, faulty), (faulty, own)):
        with pytest.raises(InputError, match="must have"):
            one.adopt(np.array([0]), two, np.array([0]))
    with pytest.raises(InputError, match="jointly"):
        joint.state.streams.adopt(np.array([0]), own.state.streams, np.array([0]))


def test_areas_must_be_their_own() -> None:
    navigator = Navigator.nominal(NavigatorConfig(), [1, 2], duration_s=60.0)
    shared = Navigator(navigator.config, navigator.track, navigator.mask, [5, 6], area_seed=7)
    with pytest.raises(InputError, match="area_seed"):
        navigator.adopt(np.array([0]), shared, np.array([0]))
    with pytest.raises(InputError, match="area_seed"):
        shared.adopt(np.array([0]), navigator, np.array([0]))
