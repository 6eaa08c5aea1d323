"""SAC under a cost limit comes to the limit where plain SAC does not; its checkpoint and transitions hold all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.env_util import make_vec_env

from lanebound.agents.learning.sac_lagrangian import CostReplayBuffer, SACLagrangian

SETTINGS: dict[str, Any] = {
    "learning_starts": 200,
    "batch_size": 64,
    "train_freq": 4,
    "gradient_steps": 4,
    "gamma": 0.95,
    "learning_rate": 3e-3,
    "policy_kwargs": {"net_arch": [32, 32]},
    "seed": 1,
    "device": "cpu",
}


@pytest.mark.slow
def test_it_comes_to_the_limit_where_plain_sac_takes_all_there_is(toll: Any) -> None:
    torch.set_num_threads(1)
    plain = SAC("MlpPolicy", make_vec_env(toll, 1, seed=1), **SETTINGS).learn(1500)
    assert toll.driven_by(plain)[1] > 8.0
    fewer = {**SETTINGS, "gradient_steps": 2}
    bound = SACLagrangian("MlpPolicy", make_vec_env(toll, 1, seed=1), cost_limit=2.5, **fewer).learn(4000)
    total, cost = toll.driven_by(bound)
    assert 1.2 < cost < 3.8
    assert 3.3 < total < 6.2
    assert bound.constraints.values[0] > 0.1


def test_each_cost_comes_to_its_own_limit(two_tolls: Any, two_limits: Any) -> None:
    """As for PPO: the whole cost holds nothing back, and shares under limits of 0.9 and 2.5 are 0.3 and 0.5."""
    torch.set_num_threads(1)
    settings = {**SETTINGS, "gradient_steps": 2, "cost_limit": 10.0, "cost_limits": two_limits}
    model = SACLagrangian("MlpPolicy", make_vec_env(two_tolls, 1, seed=1), **settings).learn(6000)
    whole, lane, headway = model.constraints.values
    assert whole < 0.05
    assert min(lane, headway) > 0.1
    assert two_tolls.shares_of(model) == pytest.approx([0.3, 0.5], abs=0.15)


def test_a_step_of_the_actor_is_the_gradient_of_its_equation(two_tolls: Any, two_limits: Any) -> None:
    settings = {**SETTINGS, "cost_limit": 10.0, "cost_limits": two_limits, "ent_coef": 0.2}
    model = SACLagrangian("MlpPolicy", make_vec_env(two_tolls, 1, seed=1), **settings).learn(300)
    for one, value in zip(model.constraints.multipliers, (0.5, 2.0, 0.25), strict=True):
        one.value = value
    batch = model.replay_buffer.draw(64)
    action, log_prob = model.actor.action_log_prob(batch.observations)
    log_prob = log_prob.reshape(-1, 1)
    worth = torch.cat(model.critic(batch.observations, action), dim=1).min(dim=1, keepdim=True)[0]
    costs = model.cost_critic(torch.cat([batch.observations, action], dim=1))
    assert costs.shape == (64, 3)
    objective = 0.2 * log_prob - worth + 0.5 * costs[:, :1] + 2.0 * costs[:, 1:2] + 0.25 * costs[:, 2:]
    wanted = torch.autograd.grad((objective / 3.75).mean(), list(model.actor.parameters()), retain_graph=True)
    model._step_actor(batch, action, log_prob, torch.tensor(0.2))
    for parameter, gradient in zip(model.actor.parameters(), wanted, strict=True):
        torch.testing.assert_close(parameter.grad, gradient)


def test_a_checkpoint_holds_both_cost_critics(two_tolls: type, two_limits: Any, tmp_path: Path) -> None:
    settings = {**SETTINGS, "cost_limit": 2.5, "cost_limits": two_limits}
    model = SACLagrangian("MlpPolicy", make_vec_env(two_tolls, 2, seed=1), **settings).learn(400)
    model.save(tmp_path / "model.zip")
    model.save_replay_buffer(tmp_path / "replay.pkl")
    again = SACLagrangian.load(tmp_path / "model.zip", env=make_vec_env(two_tolls, 2, seed=1), device="cpu")
    again.load_replay_buffer(tmp_path / "replay.pkl")
    for name in ("cost_critic", "cost_target"):
        pairs = zip(getattr(model, name).parameters(), getattr(again, name).parameters(), strict=True)
        assert all(torch.equal(old, new) for old, new in pairs)
    assert again.constraints.multipliers == model.constraints.multipliers
    assert np.array_equal(again.replay_buffer.costs, model.replay_buffer.costs)
    again.learn(100, reset_num_timesteps=False)


def test_a_transition_is_drawn_with_its_own_cost_and_a_cut_off_is_no_end(toll: type) -> None:
    env = toll()
    buffer = CostReplayBuffer(8, env.observation_space, env.action_space, n_envs=2, device="cpu")
    for step in range(8):
        seen = np.full((2, 2), step / 10, np.float32)
        infos = [{"cost": step + 0.5, "TimeLimit.truncated": step % 2 == 0} for _ in range(2)]
        buffer.add(seen, seen, np.zeros((2, 1)), np.full(2, step), np.ones(2), infos)
    batch = buffer.draw(200)
    step = batch.rewards[:, 0]
    assert batch.costs[:, 0].tolist() == pytest.approx((step + 0.5).tolist())
    assert batch.observations[:, 0].tolist() == pytest.approx((step / 10).tolist())
    assert batch.dones[:, 0].tolist() == (step % 2).tolist()
