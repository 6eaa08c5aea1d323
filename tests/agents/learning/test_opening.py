"""Which experiments the vector engine drives is known without opening an environment."""

from __future__ import annotations

import pytest
from experiments import experiment

from lanebound.agents.learning.opening import for_judging, may_use_engine

GIVEN = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 2.0}


@pytest.mark.parametrize(
    ("changes", "may"),
    [
        ({"env": "UrbanCanyon"}, True),
        ({"env": "UrbanCanyon", "engine": False}, False),
        ({"env": "UrbanCanyon", "shield": "cbf"}, False),
        ({"env": "Merge"}, False),
    ],
)
def test_ids_with_an_engine_may_use_it(changes: dict[str, object], may: bool) -> None:
    assert may_use_engine(experiment(**changes)) is may


def test_an_experiment_in_the_city_is_driven_by_the_engine() -> None:
    env = for_judging(experiment(env="UrbanCanyon", overrides=GIVEN, engine=True), 3)
    assert env.num_envs == 3
    env.close()
