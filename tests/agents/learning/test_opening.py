"""Experiments are driven by the vector engine where their environment has one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pytest
from experiments import experiment

from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.learning.opening import episode_seeds, for_judging, for_learning
from lanebound.envs.ids import META, Preset, register_id
from lanebound.integrity.core.errors import ConfigError

GIVEN = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 2.0}


@pytest.mark.parametrize(
    ("changes", "count"), [({"env": "UrbanCanyon", "engine": True}, 3), ({"env": "UrbanCanyon", "engine": False}, 1)]
)
def test_an_experiment_in_the_city_is_driven_by_the_engine(changes: dict[str, object], count: int) -> None:
    env = for_judging(experiment(overrides=GIVEN, **changes), 3)
    assert env.num_envs == count
    env.close()


def test_no_two_trainings_share_episodes_nor_meet_those_of_evaluations() -> None:
    count = 64
    beginnings = [(0, "traffic"), (50_000, "traffic"), (0, "imitation")]

    def drawn() -> list[int]:
        return [episode_seeds(experiment(seed=seed, count=count), *one) for seed in range(20) for one in beginnings]

    firsts = drawn()
    seeds = np.sort(firsts)
    assert (np.diff(seeds) >= count).all()
    assert seeds[0] > max(max(split) for split in SPLITS.values())
    assert seeds[-1] + count <= 2**31
    assert firsts == drawn()


def test_what_the_filter_changes_costs_reward_in_training_alone() -> None:
    def rewards(penalty: float) -> np.ndarray:
        changes = {"env": "CarFollowing", "shield": "cbf", "shield_penalty": penalty, "overrides": GIVEN}
        env = for_learning(experiment(**changes), 1)
        env.reset()
        found = env.step(np.tile(np.float32([1.0, 1.0]), (env.num_envs, 1)))[1]
        env.close()
        return np.asarray(found)

    free, dear, dearer = (rewards(penalty) for penalty in (0.0, 1.0, 3.0))
    assert (free - dear > 0.01).all()
    np.testing.assert_allclose(free - dearer, 3.0 * (free - dear), rtol=1e-5)


def test_an_engine_where_there_is_none_is_refused_in_the_words_of_an_experiment() -> None:
    class LongMerge(Preset):
        PRESET: ClassVar[Mapping[str, Any]] = {"base": "merge-generic-v0", **META}

    register_id(LongMerge)
    with pytest.raises(
        ConfigError, match=r"^engine must be left out for LongMerge-v0, got true: the vector engine supports .*Highway"
    ):
        for_judging(experiment(env="LongMerge", engine=True), 1)
