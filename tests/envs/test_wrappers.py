"""The wrappers: six values, costs in the reward, statistics, and how they stack, record and refuse."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers import (
    Autoreset,
    FlattenObservation,
    PassiveEnvChecker,
    RecordEpisodeStatistics,
    TimeLimit,
    TransformAction,
)
from gymnasium.wrappers.vector import DictInfoToList
from gymnasium.wrappers.vector import RecordEpisodeStatistics as VectorStatistics
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from lanebound.envs.costs import CAUSES
from lanebound.envs.wrappers import CostIntoReward, EpisodeStatistics, SafetyGymnasium, SafetyGymnasiumVector
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning.modes import Mode

ID = "lanebound/LaneKeeping-v0"
SWERVE = np.array([0.2, 0.3], dtype=np.float32)
TELLS: dict[str, Any] = {
    **dict.fromkeys(("cost", *CAUSES), 0.0),
    **dict.fromkeys(("err_at_m", "err_ct_m"), 0.0),
    **dict.fromkeys(("pl_at_m", "pl_ct_m"), 0.5),
    **dict.fromkeys(("mi", "hmi", "alert", "is_success"), False),
    "available": True,
    "speed_mps": 8.0,
    "mode": int(Mode.RTK),
}


class Told(gym.Env[Any, Any]):
    """An environment that says what it is told to: one change of the usual info for each step, and a reward of 2."""

    observation_space = gym.spaces.Discrete(1)
    action_space = gym.spaces.Discrete(1)

    def __init__(self, *changes: dict[str, Any]) -> None:
        self.changes, self.step_no = changes, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.step_no = 0
        return 0, {**TELLS, "err_at_m": 99.0, "alert": True}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.step_no += 1
        return 0, 2.0, self.step_no == len(self.changes), False, {**TELLS, **self.changes[self.step_no - 1]}


def episode(env: gym.Env[Any, Any]) -> list[tuple[Any, float, bool, bool, dict[str, Any]]]:
    """All steps of one episode that goes off the road."""
    env.reset(seed=2)
    steps: list[Any] = [env.step(SWERVE if isinstance(env.action_space, gym.spaces.Box) else 0)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(SWERVE if isinstance(env.action_space, gym.spaces.Box) else 0))
    return steps


def real() -> gym.Env[Any, Any]:
    return gym.make(ID, config={"sky": "open", "cities": {"count": 1}})


def statistics(*changes: dict[str, Any]) -> dict[str, Any]:
    """Of an episode in which these things were told."""
    *before, last = episode(EpisodeStatistics(Told(*changes)))
    assert all("episode_integrity" not in step[4] for step in before)
    found: dict[str, Any] = last[4]["episode_integrity"]
    return found


# Six values


def test_six_values_are_the_five_and_the_cost() -> None:
    plain, six = real(), SafetyGymnasium(real())
    assert data_equivalence(plain.reset(seed=2), six.reset(seed=2), exact=True)
    for _ in range(6):
        observation, reward, cost, terminated, truncated, info = six.step(SWERVE)
        assert data_equivalence(plain.step(SWERVE), (observation, reward, terminated, truncated, info), exact=True)
        assert type(cost) is float
        assert cost == info["cost"]
    assert cost > 0.0


# Cost into the reward


def test_one_weight_takes_the_weighted_cost_off_the_reward() -> None:
    env = CostIntoReward(Told({"cost": 0.5, "cost_lane": 3.0}, {"cost": 4.0}), 0.5)
    assert [step[1] for step in episode(env)] == [1.75, 0.0]
    assert [step[1] for step in episode(CostIntoReward(Told({"cost": 0.5}, {})))] == [1.5, 2.0]
    assert [step[1] for step in episode(CostIntoReward(Told({"cost": 0.5}), 0))] == [2.0]


def test_weights_by_cause_take_those_causes_off_the_reward() -> None:
    told = Told({"cost": 100.0, "cost_lane": 3.0, "cost_hmi": 0.5, "cost_alert": 7.0}, {"cost_collision": 1.0})
    steps = episode(CostIntoReward(told, {"cost_lane": 0.5, "cost_hmi": 2.0}))
    assert [step[1] for step in steps] == [2.0 - 1.5 - 1.0, 2.0]
    assert steps[0][4]["cost"] == 100.0


def test_costs_of_a_real_drive_come_off_its_reward() -> None:
    plain, less = real(), CostIntoReward(real(), {cause: 2.0 for cause in CAUSES})
    for one, two in zip(episode(plain), episode(less), strict=True):
        assert two[1] == pytest.approx(one[1] - 2.0 * sum(one[4][cause] for cause in CAUSES))
        assert data_equivalence(one[4], two[4], exact=True)


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf, True, "1", {"cost_lane": -1.0}])
def test_weights_that_are_none_are_refused(bad: Any) -> None:
    with pytest.raises(InputError, match=r"weight.* must be a finite number >= 0"):
        CostIntoReward(Told({}), bad)


def test_a_cause_that_does_not_exist_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'cost_lain': did you mean 'cost_lane'"):
        CostIntoReward(Told({}), {"cost_lain": 1.0})


# Statistics


def test_costs_rewards_and_steps_are_summed() -> None:
    found = statistics({"cost": 1.0, "cost_lane": 0.25}, {"cost": 0.5, "cost_lane": 0.5, "cost_hmi": 0.1}, {})
    assert (found["return"], found["length"], found["cost"]) == (6.0, 3, 1.5)
    assert {cause: found[cause] for cause in CAUSES if found[cause]} == {"cost_lane": 0.75, "cost_hmi": 0.1}
    assert found["is_success"] is False
    assert statistics({}, {"is_success": True})["is_success"] is True


def test_shares_and_counts_are_of_steps_without_the_reset() -> None:
    found = statistics(
        {"mode": int(Mode.RTK), "mi": True, "err_at_m": -0.6},
        {"mode": int(Mode.DOPPLER), "alert": True, "available": False},
        {"mode": int(Mode.DOPPLER), "alert": True, "hmi": True, "err_at_m": 0.4, "err_ct_m": -2.5},
        {"mode": int(Mode.DOPPLER)},
        {"mode": int(Mode.NONE), "alert": True, "available": False},
    )
    assert (found["availability"], found["alert_share"], found["alerts"]) == (0.6, 0.6, 2)
    assert (found["mi_steps"], found["hmi_steps"]) == (1, 1)
    assert found["mode_shares"] == dict.fromkeys((m.key for m in Mode), 0.0) | {"none": 0.2, "rtk": 0.2, "doppler": 0.6}
    assert (found["err_at_max_m"], found["err_ct_max_m"]) == (0.6, 2.5)


def test_the_mean_level_is_over_the_steps_that_have_one() -> None:
    found = statistics(
        {"pl_at_m": 1.0, "pl_ct_m": math.inf}, {"pl_at_m": math.inf, "pl_ct_m": math.inf}, {"pl_at_m": 2}
    )
    assert (found["pl_at_mean_m"], found["pl_ct_mean_m"]) == (1.5, 0.5)
    assert statistics({"pl_at_m": math.inf})["pl_at_mean_m"] == math.inf


def test_statistics_start_anew_with_every_episode() -> None:
    env = EpisodeStatistics(Told({"cost": 1.0}, {"cost": 2.0}))
    first, second = (episode(env)[-1][4]["episode_integrity"] for _ in range(2))
    assert first == second
    env.reset()
    env.step(0)  # an episode that is given up
    assert episode(env)[-1][4]["episode_integrity"] == first


def test_statistics_of_a_real_drive_agree_with_its_steps() -> None:
    env = TimeLimit(RecordEpisodeStatistics(EpisodeStatistics(real())), 40)
    steps = episode(env)
    infos, found = [step[4] for step in steps], steps[-1][4]["episode_integrity"]
    assert found["length"] == len(steps) == steps[-1][4]["episode"]["l"]
    assert found["return"] == pytest.approx(steps[-1][4]["episode"]["r"])
    assert found["cost_lane"] == pytest.approx(sum(info["cost_lane"] for info in infos))
    assert found["err_ct_max_m"] == max(abs(info["err_ct_m"]) for info in infos)
    assert found["pl_ct_mean_m"] == pytest.approx(np.mean([info["pl_ct_m"] for info in infos]))
    assert found["speed_mean_mps"] == pytest.approx(np.mean([info["speed_mps"] for info in infos]))
    assert sum(found["mode_shares"].values()) == pytest.approx(1.0)
    values = [*found.values(), *found["mode_shares"].values()]
    assert {type(value) for value in values} <= {bool, int, float, dict}


# How they stack


def test_an_environment_of_somebody_else_is_refused() -> None:
    for wrapper in (SafetyGymnasium, CostIntoReward, EpisodeStatistics):
        env = wrapper(gym.make("CartPole-v1"))
        with pytest.raises(InputError, match="wrap an environment of lanebound"):
            env.reset(seed=0)


@pytest.mark.parametrize("outer", [EpisodeStatistics, CostIntoReward, SafetyGymnasium])
def test_a_wrapper_around_six_values_is_refused_when_it_is_made(outer: Any) -> None:
    right = "env" if outer is SafetyGymnasium else f"{outer.__name__}(env)"
    for inner in (SafetyGymnasium(Told({})), TimeLimit(SafetyGymnasium(Told({})), 9)):
        with pytest.raises(InputError) as refused:
            outer(inner)
        assert str(refused.value).endswith(f"got {outer.__name__} around it: write SafetyGymnasium({right})")
    with pytest.raises(InputError, match="use SafetyGymnasiumVector"):
        outer(SafetyGymnasiumVector(gym.vector.SyncVectorEnv([lambda: Told({})])))


def around_single(outer: Any) -> Any:
    env = outer(SafetyGymnasium(Told({}, {})))
    env.reset()
    return env


def around_vector(outer: Any) -> Any:
    envs = outer(SafetyGymnasiumVector(gym.vector.SyncVectorEnv([lambda: Told({}, {})])))
    envs.reset()
    return envs


@pytest.mark.parametrize(
    ("env", "right"),
    [
        (around_single(RecordEpisodeStatistics), "SafetyGymnasium(RecordEpisodeStatistics(env))"),
        (around_single(Autoreset), "SafetyGymnasium(Autoreset(env))"),
        (around_single(PassiveEnvChecker), "SafetyGymnasium(PassiveEnvChecker(env))"),
        (around_single(lambda env: gym.Wrapper(Monitor(env))), "SafetyGymnasium(Monitor(env))"),
        (around_vector(VectorStatistics), "SafetyGymnasiumVector(RecordEpisodeStatistics(env))"),
        (around_vector(lambda envs: VectorWrapper(DictInfoToList(envs))), "SafetyGymnasiumVector(DictInfoToList(env))"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_wrapper_that_takes_five_values_is_refused_at_each_step(env: Any, right: str) -> None:
    action = np.zeros(1, dtype=np.int64) if isinstance(env, gym.vector.VectorEnv) else 0
    for _ in range(2):
        with pytest.raises(InputError) as refused:
            env.step(action)
        assert str(refused.value).endswith(f"takes five values: write {right}")


def test_a_wrapper_that_is_added_after_a_step_is_refused() -> None:
    env = SafetyGymnasium(Told({}, {}, {}))
    env.reset()
    env.step(0)
    with pytest.raises(InputError, match="got RecordEpisodeStatistics around it"):
        RecordEpisodeStatistics(env).step(0)


@pytest.mark.filterwarnings("ignore:.*ERROR:UserWarning")  # what Gymnasium tells of a worker process that ended
def test_vectors_of_six_values_are_refused_without_names_of_internal_functions() -> None:
    makers: list[Any] = [lambda: SafetyGymnasium(Told({}))]
    vector = gym.vector.SyncVectorEnv(makers)
    vector.reset()
    with pytest.raises(InputError, match=r"got SyncVectorEnv around it.* SafetyGymnasiumVector\(envs\)"):
        vector.step(np.zeros(1, dtype=np.int64))
    processes = gym.vector.AsyncVectorEnv(makers)
    processes.reset()
    with pytest.raises(InputError, match=r"got gymnasium\.vector\.async_vector_env around it") as refused:
        processes.step(np.zeros(1, dtype=np.int64))
    assert "worker" not in str(refused.value)
    processes.close(terminate=True)
    for_sb3 = DummyVecEnv(makers)
    for_sb3.reset()
    with pytest.raises(InputError, match=r"got DummyVecEnv around it.* info\['cost'\] has the cost"):
        for_sb3.step(np.zeros(1, dtype=np.int64))


def test_another_order_of_wrappers_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"write Autoreset\(EpisodeStatistics\(env\)\)"):
        EpisodeStatistics(Autoreset(Told({})))
    envs = gym.vector.SyncVectorEnv([lambda: Told({})])
    with pytest.raises(InputError, match="use SafetyGymnasiumVector"):
        SafetyGymnasium(envs)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"use SafetyGymnasium$"):
        SafetyGymnasiumVector(Told({}))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"write SafetyGymnasiumVector\(env\)$"):
        SafetyGymnasiumVector(VectorWrapper(SafetyGymnasiumVector(envs)))


def test_the_orders_that_the_page_names_work_over_two_episodes() -> None:
    env = SafetyGymnasium(Autoreset(EpisodeStatistics(Told({"cost": 1.0}, {"cost": 2.0}))))
    env.reset()
    steps = [env.step(0) for _ in range(5)]
    assert [step[2] for step in steps] == [1.0, 2.0, 0.0, 1.0, 2.0]
    assert [step[5]["episode_integrity"]["cost"] for step in (steps[1], steps[4])] == [3.0, 3.0]
    passed_on = TransformAction(gym.Wrapper(SafetyGymnasium(Told({"cost": 1.0}))), lambda action: action, None)
    passed_on.reset()
    assert len(passed_on.step(0)) == 6
    vector = VectorWrapper(SafetyGymnasiumVector(gym.vector.SyncVectorEnv([lambda: Told({"cost": 1.0})])))
    vector.reset()
    assert len(vector.step(np.zeros(1, dtype=np.int64))) == 6


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_costs_of_a_vector_are_those_of_the_steps_made(mode: str) -> None:
    makers = [lambda: Told({"cost": 1.0}, {"cost": 200.0}), lambda: Told({"cost": 3.0}, {"cost": 4.0}, {"cost": 5.0})]
    envs = SafetyGymnasiumVector(gym.vector.SyncVectorEnv(makers, autoreset_mode=mode))
    envs.reset()
    costs = [envs.step(np.zeros(2, dtype=np.int64))[2].tolist() for _ in range(3)]
    assert costs[:2] == [[1.0, 3.0], [200.0, 4.0]]
    assert costs[2] == ([1.0, 5.0] if mode == "SameStep" else [0.0, 5.0])


def test_the_engine_gives_the_cost_of_a_last_step_as_single_environments_do() -> None:
    config = {"sky": "open", "cities": {"count": 1}}
    envs = SafetyGymnasiumVector(gym.make_vec(ID, 2, config=config, autoreset_mode="SameStep"))
    envs.reset(seed=2)
    single = SafetyGymnasium(gym.make(ID, config=config))
    single.reset(seed=2)
    over = False
    while not over:
        *_, cost, terminated, truncated, _ = single.step(SWERVE)
        costs = envs.step(np.stack([SWERVE, SWERVE]))[2]
        assert costs[0] == pytest.approx(cost)
        over = terminated or truncated
    assert cost >= 200.0  # off the road


def test_a_stack_of_wrappers_goes_through_a_specification_in_json() -> None:
    env = SafetyGymnasium(EpisodeStatistics(CostIntoReward(real(), {"cost_hmi": 2.5})))
    spec = EnvSpec.from_json(env.spec.to_json())  # type: ignore[union-attr]
    again = gym.make(spec)
    assert isinstance(again, SafetyGymnasium)
    assert isinstance(again.env, EpisodeStatistics)
    assert isinstance(again.env.env, CostIntoReward)
    assert again.env.env.weights == {"cost_hmi": 2.5}
    assert again.spec == env.spec
    assert data_equivalence(env.reset(seed=1), again.reset(seed=1), exact=True)
    assert data_equivalence(env.step(SWERVE), again.step(SWERVE), exact=True)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_in_the_middle_of_an_episode_tells_the_same_in_the_end(copied: Any) -> None:
    env = EpisodeStatistics(Told({"cost": 1.0}, {"cost": 2.0}, {"hmi": True}))
    env.reset()
    env.step(0)
    twin = copied(env)
    ends = [[one.step(0) for _ in range(2)][-1][4]["episode_integrity"] for one in (env, twin)]
    assert ends[0] == ends[1]
    assert ends[0]["cost"] == 3.0


def test_statistics_come_through_a_vector() -> None:
    makers = [lambda: EpisodeStatistics(Told({"cost": 1.0}, {"cost": 2.0}))] * 2
    vector = gym.vector.SyncVectorEnv(makers)
    vector.reset(seed=1)
    *_, info = vector.step(np.zeros(2, dtype=np.int64))
    assert "episode_integrity" not in info
    *_, info = vector.step(np.zeros(2, dtype=np.int64))
    np.testing.assert_array_equal(info["episode_integrity"]["cost"], [3.0, 3.0])
    np.testing.assert_array_equal(info["episode_integrity"]["mode_shares"]["rtk"], [1.0, 1.0])


@pytest.mark.parametrize("history", [1, 2])
def test_gymnasium_flattens_group_by_group_and_our_flat_form_moment_by_moment(history: int) -> None:
    def seen(form: str) -> gym.Env[Any, Any]:
        return gym.make(
            ID, config={"sky": "open", "cities": {"count": 1}, "observation": {"form": form, "history": history}}
        )

    by_group, by_moment, groups = FlattenObservation(seen("dict")), seen("flat"), seen("dict")
    for env in (by_group, by_moment, groups):
        env.reset(seed=1)
    (one, *_), (two, *_), (observation, *_) = (env.step(SWERVE) for env in (by_group, by_moment, groups))
    halves = {group: np.split(vector, history) for group, vector in observation.items()}
    np.testing.assert_array_equal(one, np.concatenate(list(observation.values())))
    np.testing.assert_array_equal(two, np.concatenate([halves[g][k] for k in range(history) for g in halves]))
    assert np.array_equal(one, two) == (history == 1)
