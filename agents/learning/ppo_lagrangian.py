"""Proximal policy optimisation under limits of an episode's costs, by a Lagrange multiplier for each.

The objective is ``A = (A_r - sum_k lambda_k A_k) / (1 + sum_k lambda_k)`` (Stooke et al. 2020, section 5, there of one
cost): A_r and A_k are advantages of the reward and of cost k of :mod:`.constraints`, by one critic of the reward and
one of all costs, lambda_k the multipliers of :mod:`.multiplier`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO

from lanebound.agents.learning.constraints import Constraints, GroupLimit, costs_in, limit_of
from lanebound.agents.learning.costs import CostCritic, EpisodeCosts, advantages, require_flat
from lanebound.agents.learning.multiplier import MultiplierConfig

__all__ = ["PPOLagrangian"]


class PPOLagrangian(PPO):
    """PPO of stable-baselines3, whose policy also keeps the costs of an episode below their limits.

    Parameters
    ----------
    policy, env, *arguments, **settings : as of PPO; observations are flat
    cost_limit : of the sum of ``info["cost"]`` over an episode; None: that of the environment
    cost_limits : of groups of causes in addition, as :func:`.group_limits` makes them
    multiplier : gains of the control of each
    cost_gamma : discount of costs
    cost_gae_lambda : of their advantages
    cost_learning_rate : of the cost critic

    Raises
    ------
    InputError
        Observations that are not one vector, a limit that is not positive, or an environment without these costs.
    """

    EXTRA: ClassVar[list[str]] = ["cost_critic", "cost_optimizer"]

    def __init__(
        self,
        policy: Any,
        env: Any,
        *arguments: Any,
        cost_limit: float | None = None,
        cost_limits: Sequence[GroupLimit] = (),
        multiplier: MultiplierConfig | None = None,
        cost_gamma: float = 0.99,
        cost_gae_lambda: float = 0.95,
        cost_learning_rate: float = 1e-3,
        **settings: Any,
    ) -> None:
        limit = limit_of(cost_limit, env, settings)
        self.constraints = Constraints(limit, cost_limits, multiplier or MultiplierConfig())
        self.cost_gamma, self.cost_gae_lambda = cost_gamma, cost_gae_lambda
        self.cost_learning_rate = cost_learning_rate
        super().__init__(policy, env, *arguments, **settings)

    def _setup_model(self) -> None:
        super()._setup_model()
        limits = self.constraints.limits
        self.cost_critic = CostCritic(require_flat(self.observation_space), limits).to(self.device)
        self.cost_optimizer = torch.optim.Adam(self.cost_critic.parameters(), lr=self.cost_learning_rate)
        self._episodes = EpisodeCosts(self.n_envs, len(limits), self.constraints.window)
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
        costs = costs_in(infos, self.constraints.groups)
        self._episodes.add(costs, ended)
        for i in np.flatnonzero(ended):
            if infos[i].get("TimeLimit.truncated", False) and infos[i].get("terminal_observation") is not None:
                costs[i] += self.cost_gamma * self.cost_critic.of(infos[i]["terminal_observation"])
        self._costs.append(costs)
        self._dones.append(ended)

    def train(self) -> None:
        """Update the multipliers, then the policy by all advantages, then the cost critic."""
        means = self._episodes.take()
        if means is not None:
            self.constraints.update(means, self.num_timesteps)
            self._record("episode_mean", means)
        weights, buffer = self.constraints.values, self.rollout_buffer
        seen = buffer.observations.reshape(buffer.buffer_size * self.n_envs, -1).copy()
        values = self.cost_critic.of(buffer.observations)
        last = self.cost_critic.of(np.asarray(self._last_obs))
        of_cost, returns = advantages(
            np.stack(self._costs), values, last, np.stack(self._dones), self.cost_gamma, self.cost_gae_lambda
        )
        priced = (np.array(weights, dtype=np.float32) * of_cost).sum(axis=-1)
        buffer.advantages = ((buffer.advantages - priced) / (1.0 + sum(weights))).astype(np.float32)
        super().train()
        loss = self._fit(seen, returns.reshape(len(seen), -1))
        self.logger.record("cost/critic_loss", loss)
        self._record("multiplier", weights)

    def _record(self, name: str, values: Sequence[float]) -> None:
        for key, value in self.constraints.named(name, values).items():
            self.logger.record(key, value)

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
