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
    assert bound.multiplier.value > 0.1


def test_a_checkpoint_holds_both_cost_critics(toll: type, tmp_path: Path) -> None:
    model = SACLagrangian("MlpPolicy", make_vec_env(toll, 2, seed=1), cost_limit=2.5, **SETTINGS).learn(400)
    model.save(tmp_path / "model.zip")
    model.save_replay_buffer(tmp_path / "replay.pkl")
    again = SACLagrangian.load(tmp_path / "model.zip", env=make_vec_env(toll, 2, seed=1), device="cpu")
    again.load_replay_buffer(tmp_path / "replay.pkl")
    for name in ("cost_critic", "cost_target"):
        pairs = zip(getattr(model, name).parameters(), getattr(again, name).parameters(), strict=True)
        assert all(torch.equal(old, new) for old, new in pairs)
    assert again.multiplier == model.multiplier
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
