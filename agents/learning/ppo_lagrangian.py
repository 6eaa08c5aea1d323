"""Proximal policy optimisation under a limit of an episode's cost, by a Lagrange multiplier.

The objective is ``A = (A_r - lambda A_c) / (1 + lambda)`` (Stooke et al. 2020, section 5): A_r and A_c are advantages
of reward and cost, each with a critic of its own, lambda the multiplier of :mod:`.multiplier`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO

from lanebound.agents.learning.costs import CostCritic, EpisodeCosts, advantages, costs_in, require_flat
from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig

__all__ = ["PPOLagrangian"]


class PPOLagrangian(PPO):
    """PPO of stable-baselines3, whose policy also keeps ``info["cost"]`` of an episode below a limit.

    Parameters
    ----------
    policy, env, *arguments, **settings : as of PPO; observations are flat
    cost_limit : of the sum of costs over an episode
    multiplier : gains of its control
    cost_gamma : discount of costs
    cost_gae_lambda : of their advantages
    cost_learning_rate : of the cost critic

    Raises
    ------
    InputError
        Observations that are not one vector, a limit that is not positive, or an environment without costs.
    """

    EXTRA: ClassVar[list[str]] = ["cost_critic", "cost_optimizer"]

    def __init__(
        self,
        policy: Any,
        env: Any,
        *arguments: Any,
        cost_limit: float = 1.0,
        multiplier: MultiplierConfig | None = None,
        cost_gamma: float = 0.99,
        cost_gae_lambda: float = 0.95,
        cost_learning_rate: float = 1e-3,
        **settings: Any,
    ) -> None:
        self.cost_limit = cost_limit
        self.multiplier = Multiplier(cost_limit, multiplier or MultiplierConfig())
        self.cost_gamma, self.cost_gae_lambda = cost_gamma, cost_gae_lambda
        self.cost_learning_rate = cost_learning_rate
        super().__init__(policy, env, *arguments, **settings)

    def _setup_model(self) -> None:
        super()._setup_model()
        self.cost_critic = CostCritic(require_flat(self.observation_space), self.cost_limit).to(self.device)
        self.cost_optimizer = torch.optim.Adam(self.cost_critic.parameters(), lr=self.cost_learning_rate)
        self._episodes = EpisodeCosts(self.n_envs, self.multiplier.config.window)
        self._costs: list[NDArray[np.float32]] = []
        self._dones: list[NDArray[np.bool_]] = []

    def collect_rollouts(self, *arguments: Any, **settings: Any) -> bool:
        """As PPO, noting the costs."""
        self._costs, self._dones = [], []
        return bool(super().collect_rollouts(*arguments, **settings))

    def _update_info_buffer(self, infos: list[dict[str, Any]], dones: NDArray[np.bool_] | None = None) -> None:
        """Called once a step of the rollout: what it cost; where an episode is cut off, its end's value too."""
        super()._update_info_buffer(infos, dones)
        ended = np.zeros(len(infos), dtype=np.bool_) if dones is None else np.asarray(dones, dtype=np.bool_)
        costs = costs_in(infos)
        self._episodes.add(costs, ended)
        for i in np.flatnonzero(ended):
            if infos[i].get("TimeLimit.truncated", False) and infos[i].get("terminal_observation") is not None:
                costs[i] += self.cost_gamma * self.cost_critic.of(infos[i]["terminal_observation"])
        self._costs.append(costs)
        self._dones.append(ended)

    def train(self) -> None:
        """Update the multiplier, then the policy by both advantages, then the cost critic."""
        mean = self._episodes.take()
        if mean is not None:
            self.multiplier.update(mean, self.num_timesteps)
            self.logger.record("cost/episode_mean", mean)
        weight, buffer = self.multiplier.value, self.rollout_buffer
        seen = buffer.observations.reshape(buffer.buffer_size * self.n_envs, -1).copy()
        values = self.cost_critic.of(buffer.observations)
        last = self.cost_critic.of(np.asarray(self._last_obs))
        of_cost, returns = advantages(
            np.stack(self._costs), values, last, np.stack(self._dones), self.cost_gamma, self.cost_gae_lambda
        )
        buffer.advantages = ((buffer.advantages - weight * of_cost) / (1.0 + weight)).astype(np.float32)
        super().train()
        loss = self._fit(seen, returns.reshape(-1))
        self.logger.record("cost/critic_loss", loss)
        self.logger.record("cost/multiplier", weight)

    def _fit(self, seen: NDArray[np.float32], returns: NDArray[np.float32]) -> float:
        """As many epochs over the rollout as the policy's, in batches of the same size."""
        given = torch.as_tensor(seen, dtype=torch.float32, device=self.device)
        goal = torch.as_tensor(returns, dtype=torch.float32, device=self.device)
        losses = []
        for _ in range(self.n_epochs):
            order = torch.randperm(len(given), device=self.device)
            for start in range(0, len(given), self.batch_size):
                batch = order[start : start + self.batch_size]
                loss = self.cost_critic.loss(given[batch], goal[batch])
                self.cost_optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                torch.nn.utils.clip_grad_norm_(self.cost_critic.parameters(), self.max_grad_norm)
                self.cost_optimizer.step()
                losses.append(loss.item())
        return float(np.mean(losses))

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        names, tensors = super()._get_torch_save_params()
        return [*names, *self.EXTRA], tensors

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *self.EXTRA, "_episodes", "_costs", "_dones"]
