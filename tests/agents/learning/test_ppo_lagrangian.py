"""PPO under a cost limit: it comes to the limit where plain PPO does not, and a checkpoint goes on as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from lanebound.agents.learning.costs import EpisodeCosts, advantages
from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig
from lanebound.agents.learning.ppo_lagrangian import PPOLagrangian
from lanebound.agents.learning.sac_lagrangian import SACLagrangian
from lanebound.agents.vec_env import EngineVecEnv
from lanebound.integrity.core.errors import InputError

SETTINGS: dict[str, Any] = {
    "n_steps": 100,
    "batch_size": 100,
    "n_epochs": 5,
    "learning_rate": 3e-3,
    "gamma": 0.95,
    "seed": 1,
    "device": "cpu",
}


def learner(toll: type, **settings: Any) -> PPOLagrangian:
    return PPOLagrangian("MlpPolicy", make_vec_env(toll, 4, seed=1), **{**SETTINGS, "cost_limit": 2.5, **settings})


def test_it_comes_to_the_limit_where_plain_ppo_takes_all_there_is(toll: Any) -> None:
    torch.set_num_threads(1)
    plain = PPO("MlpPolicy", make_vec_env(toll, 4, seed=1), **SETTINGS).learn(12_000)
    assert toll.driven_by(plain)[1] > 8.0
    bound = learner(toll).learn(30_000)
    total, cost = toll.driven_by(bound)
    assert 1.5 < cost < 3.5
    assert 3.8 < total < 6.0
    assert bound.constraints.values[0] > 0.1


def test_each_cost_comes_to_its_own_limit(two_tolls: Any, two_limits: Any) -> None:
    """The whole cost may be 10: it holds nothing back. One limit of the sum would make both shares equal."""
    torch.set_num_threads(1)
    settings = {**SETTINGS, "cost_limit": 10.0, "cost_limits": two_limits}
    model = PPOLagrangian("MlpPolicy", make_vec_env(two_tolls, 4, seed=1), **settings).learn(40_000)
    whole, lane, headway = model.constraints.values
    assert whole < 0.05
    assert min(lane, headway) > 0.1
    assert two_tolls.shares_of(model) == pytest.approx([0.3, 0.5], abs=0.1)


def test_a_multiplier_pulls_its_own_action_alone(two_tolls: Any, two_limits: Any) -> None:
    """The objective of a step is that of its equation: advantages of each cost, weighed by its own multiplier."""
    torch.set_num_threads(1)
    config = MultiplierConfig(start=0.0, integral=0.0, proportional=0.0)
    settings = {**SETTINGS, "cost_limit": 10.0, "cost_limits": two_limits, "multiplier": config, "ent_coef": 0.0}
    model = PPOLagrangian("MlpPolicy", make_vec_env(two_tolls, 4, seed=1), **settings)
    model.constraints.multipliers[1].config = config.replace(proportional=15.0, most=1.0)
    model.constraints.multipliers[1].limit = 1e-3  # exceeded for sure: the multiplier of the lane is 15
    before = two_tolls.shares_of(model)
    model.learn(2_000)
    after = two_tolls.shares_of(model)
    assert model.constraints.values == [0.0, 15.0, 0.0]
    assert after[0] < before[0] - 0.05
    assert after[1] > before[1]


def test_where_the_limit_is_out_of_reach_the_multiplier_dies_out(toll: type) -> None:
    model = learner(toll, cost_limit=50.0).learn(6_000)
    assert model.constraints.values == [0.0]


def test_advantages_are_those_of_the_sum_written_out() -> None:
    rng = np.random.default_rng(1)
    costs, values = rng.normal(size=(2, 7, 3, 2)).astype(np.float32)
    last, dones = rng.normal(size=(3, 2)).astype(np.float32), rng.random((7, 3)) < 0.3
    found, returns = advantages(costs, values, last, dones, 0.9, 0.8)
    after = np.concatenate([values[1:], last[None]])
    delta = costs + 0.9 * after * ~dones[..., None] - values
    for n in range(3):
        for t in range(7):
            total, weight = np.zeros(2), 1.0
            for k in range(t, 7):
                total += weight * delta[k, n]
                if dones[k, n]:
                    break
                weight *= 0.9 * 0.8
            assert found[t, n] == pytest.approx(total, abs=1e-5)
    assert np.allclose(returns, found + values)


def test_costs_of_episodes_are_summed_in_each_environment() -> None:
    episodes = EpisodeCosts(2, 2, window=4)
    episodes.add(np.array([[1.0, 0.5], [10.0, 0.0]], np.float32), np.array([False, False]))
    episodes.add(np.array([[2.0, 0.5], [20.0, 0.0]], np.float32), np.array([True, False]))
    assert episodes.take() is None  # the second environment has ended none yet
    episodes.add(np.array([[4.0, 4.0], [40.0, 7.0]], np.float32), np.array([False, True]))
    assert episodes.take() == [(3.0 + 70.0) / 2, (1.0 + 7.0) / 2]
    assert episodes.take() is None  # none has ended since
    for cost in (6.0, 5.0, 7.0):
        episodes.add(np.array([[cost, 0.0], [0.0, 0.0]], np.float32), np.array([True, False]))
    assert episodes.take() == [((5.0 + 7.0) / 2 + 70.0) / 2, (0.0 + 7.0) / 2]  # two of each, however many have ended


@pytest.mark.parametrize(("one_in", "within"), [(14, False), (50, True)])
def test_the_mean_decides_and_not_how_many_exceed(one_in: int, within: bool) -> None:
    """Crashes of 200 among episodes of 10: 23.6 and 13.8 in the mean, 15 allowed."""
    multiplier, episodes = Multiplier(15.0, MultiplierConfig()), EpisodeCosts(4, 1, window=400)
    for n in range(3000):
        costs = np.array([200.0 if (4 * n + e) % one_in == one_in - 1 else 10.0 for e in range(4)], np.float32)[:, None]
        episodes.add(costs, np.ones(4, dtype=np.bool_))
        means = episodes.take()
        assert means is not None
        multiplier.update(means[0])
    assert multiplier.value == (0.0 if within else MultiplierConfig().largest)


def test_short_episodes_do_not_count_more_often() -> None:
    """One of 48 environments crashes every ten steps, at 200; the others drive a hundred steps at 10."""
    episodes, found = EpisodeCosts(48, 1, window=48), []
    for step in range(1, 1001):
        costs, dones = np.full(48, 0.1, np.float32), np.full(48, step % 100 == 0)
        costs[0], dones[0] = 20.0, step % 10 == 0
        episodes.add(costs[:, None], dones)
        found.append(episodes.take())
    known = [means[0] for means in found if means is not None]
    assert found[:99] == [None] * 99
    assert known == pytest.approx([(200.0 + 47 * 10.0) / 48] * len(known), rel=1e-4)


def test_a_cut_off_episode_is_worth_what_its_end_is(toll: type) -> None:
    """The toll road is cut off after ten steps: the value of its last observation counts on, discounted."""
    model = learner(toll)
    model._setup_learn(400)
    model.cost_critic.net[-1].weight.data.zero_()
    model.cost_critic.net[-1].bias.data.fill_(7.0 / 2.5)  # a critic that says 7 everywhere
    end = {"cost": 0.5, "TimeLimit.truncated": True, "terminal_observation": np.zeros(2, np.float32)}
    going = {"cost": 0.5}
    model._update_info_buffer([end, going, {"cost": 0.5}, going], np.array([True, False, True, False]))
    assert model._costs[-1][:, 0].tolist() == pytest.approx([0.5 + 0.99 * 7.0, 0.5, 0.5, 0.5])


def test_a_checkpoint_holds_critic_optimiser_and_multipliers(two_tolls: type, two_limits: Any, tmp_path: Path) -> None:
    model = learner(two_tolls, multiplier=MultiplierConfig(start=0.7), cost_limits=two_limits).learn(800)
    model.save(tmp_path / "model.zip")
    again = PPOLagrangian.load(tmp_path / "model.zip", env=make_vec_env(two_tolls, 4, seed=1), device="cpu")
    assert len(model.constraints.multipliers) == 3
    assert again.constraints.multipliers == model.constraints.multipliers
    assert again.cost_critic.scale.tolist() == pytest.approx([2.5, 0.9, 2.5])
    for old, new in zip(model.cost_critic.parameters(), again.cost_critic.parameters(), strict=True):
        assert torch.equal(old, new)
    assert again.cost_optimizer.state_dict()["state"].keys() == model.cost_optimizer.state_dict()["state"].keys()
    again.learn(400, reset_num_timesteps=False)
    assert again.num_timesteps == 1200


def test_the_same_seed_learns_the_same(toll: type) -> None:
    one, other = (learner(toll).learn(800) for _ in range(2))
    assert torch.equal(one.policy.mlp_extractor.policy_net[0].weight, other.policy.mlp_extractor.policy_net[0].weight)
    assert one.constraints.multipliers == other.constraints.multipliers


def test_what_it_cannot_learn_from_is_refused(toll: type) -> None:
    free = gymnasium.make("CartPole-v1")
    with pytest.raises(InputError, match="info must hold 'cost'"):
        PPOLagrangian("MlpPolicy", free, cost_limit=1.0, device="cpu", n_steps=16, batch_size=16).learn(16)
    for env in (free, make_vec_env("CartPole-v1", 2)):
        with pytest.raises(InputError, match="cost_limit must be given"):
            PPOLagrangian("MlpPolicy", env, device="cpu", n_steps=16, batch_size=16)

    class Groups(toll):  # type: ignore[misc,valid-type]
        def __init__(self) -> None:
            super().__init__()
            self.observation_space = spaces.Dict({"ego": self.observation_space})

    with pytest.raises(InputError, match=r"observation\.form to flat"):
        PPOLagrangian("MultiInputPolicy", Groups(), cost_limit=1.0, device="cpu")


def test_without_a_limit_that_of_the_environment_is_kept() -> None:
    config = {"sky": "open", "observation": {"form": "flat"}, "cost_limit": 7.0}
    env = gymnasium.make("lanebound/LaneKeeping-v0", config=config)
    envs = [env, make_vec_env(lambda: gymnasium.make("lanebound/LaneKeeping-v0", config=config), 2)]
    envs.append(EngineVecEnv("lanebound/LaneKeeping-v0", 2, config))
    for one in envs:
        for learner_of in (PPOLagrangian, SACLagrangian):
            assert learner_of("MlpPolicy", one, device="cpu").constraints.limits == [7.0]
        one.close()
