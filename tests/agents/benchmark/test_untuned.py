"""Constant margins are tuned at the places of their preset alone; with figures of its own an agent is what they say."""

from __future__ import annotations

import pytest

from lanebound.agents.benchmark import untuned
from lanebound.agents.benchmark.outcome import Place
from lanebound.agents.benchmark.suite import AgentConfig
from lanebound.agents.drivers.margins import TunedCaution

CAUTIOUS = AgentConfig(agent="cautious")


@pytest.mark.parametrize(
    ("chosen", "place", "found"),
    [
        (CAUTIOUS, Place("CarFollowing-v0", "dense", "none"), False),
        (CAUTIOUS, Place("CarFollowing-v0", "dense", "stress"), True),
        (CAUTIOUS, Place("CarFollowing-v0", "open", "none"), True),
        (CAUTIOUS, Place("LaneKeeping-v0", "dense", "none"), True),
        (CAUTIOUS, Place("two-way-v0", "dense", "none"), True),
        (AgentConfig(agent="cautious", figures={"gap_m": 2.0}), Place("LaneKeeping-v0", "dense", "none"), False),
        (AgentConfig(agent="nominal"), Place("LaneKeeping-v0", "dense", "none"), False),
    ],
)
def test_what_was_not_tuned_for_a_place_is_known(monkeypatch, chosen, place, found):
    monkeypatch.setattr(untuned, "tuned_places", lambda: (("CarFollowingWorld", "dense"),))
    assert untuned.is_untuned(chosen, place) is found


def test_the_places_are_those_that_the_driver_itself_knows():
    known = TunedCaution.preset("drivers/cautious").at
    assert untuned.tuned_places() == tuple((base, sky) for base, skies in known.items() for sky in skies) != ()
