"""Experiments are driven by the vector engine where their environment has one."""

from __future__ import annotations

import pytest
from experiments import experiment

from lanebound.agents.learning.opening import for_judging

GIVEN = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 2.0}


@pytest.mark.parametrize(
    ("changes", "count"), [({"env": "UrbanCanyon", "engine": True}, 3), ({"env": "UrbanCanyon", "engine": False}, 1)]
)
def test_an_experiment_in_the_city_is_driven_by_the_engine(changes: dict[str, object], count: int) -> None:
    env = for_judging(experiment(overrides=GIVEN, **changes), 3)
    assert env.num_envs == count
    env.close()
