"""Soft actor-critic under limits of an episode's costs, by a Lagrange multiplier for each.

The actor minimises ``alpha log pi - Q_r + sum_k lambda_k Q_k``, divided by ``1 + sum_k lambda_k`` (Ha et al. 2020,
Stooke et al. 2020, there of one cost); the Q_k are outputs of one critic of the costs of :mod:`.constraints`, with a
target of its own, the lambda_k multipliers of :mod:`.multiplier`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.utils import polyak_update
from torch.nn import functional

from lanebound.agents.learning.constraints import Constraints, GroupLimit, costs_in, limit_of
from lanebound.agents.learning.costs import CostCritic, EpisodeCosts, require_flat
from lanebound.agents.learning.multiplier import MultiplierConfig

__all__ = ["CostReplayBuffer", "SACLagrangian"]


class CostTransitions(NamedTuple):
    """Transitions, (B, ...) each; ``costs`` (B, K)."""

    observations: torch.Tensor
    actions: torch.Tensor
    next_observations: torch.Tensor
    dones: torch.Tensor
    rewards: torch.Tensor
    costs: torch.Tensor


class CostReplayBuffer(ReplayBuffer):
    """Transitions with what they cost; ``cost_limits``: groups whose costs are kept beside the whole."""

    def __init__(self, *arguments: Any, cost_limits: Sequence[GroupLimit] = (), **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.groups = tuple(cost_limits)
        self.costs = np.zeros((self.buffer_size, self.n_envs, 1 + len(self.groups)), dtype=np.float32)

    def add(
        self,
        obs: NDArray[Any],
        next_obs: NDArray[Any],
        action: NDArray[Any],
        reward: NDArray[Any],
        done: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """A step of all environments."""
        self.costs[self.pos] = costs_in(infos, self.groups)
        super().add(obs, next_obs, action, reward, done, infos)

    def draw(self, count: int) -> CostTransitions:
        """A batch drawn evenly."""
        rows = np.random.randint(0, self.size(), size=count)  # noqa: NPY002 - the stream that SB3 seeds
        columns = np.random.randint(0, self.n_envs, size=count)  # noqa: NPY002
        ended = self.dones[rows, columns] * (1.0 - self.timeouts[rows, columns])
        arrays = (
            self.observations[rows, columns],
            self.actions[rows, columns],
            self.next_observations[rows, columns],
            ended[:, None],
            self.rewards[rows, columns][:, None],
            self.costs[rows, columns],
        )
        return CostTransitions(*(torch.as_tensor(array, dtype=torch.float32, device=self.device) for array in arrays))


class SACLagrangian(SAC):
    """SAC of stable-baselines3, whose policy also keeps the costs of an episode below their limits.

    Parameters
    ----------
    policy, env, *arguments, **settings : as of SAC; observations are flat
    cost_limit : of the sum of ``info["cost"]`` over an episode; None: that of the environment
    cost_limits : of groups of causes in addition, as :func:`.group_limits` makes them
    multiplier : gains of the control of each, updated when episodes have ended
    cost_gamma : discount of costs

    Raises
    ------
    InputError
        Observations that are not one vector, a limit that is not positive, or an environment without these costs.
    """

    EXTRA: ClassVar[list[str]] = ["cost_critic", "cost_target", "cost_optimizer"]

    def __init__(
        self,
        policy: Any,
        env: Any,
        *arguments: Any,
        cost_limit: float | None = None,
        cost_limits: Sequence[GroupLimit] = (),
        multiplier: MultiplierConfig | None = None,
        cost_gamma: float = 0.99,
        **settings: Any,
    ) -> None:
        limit = limit_of(cost_limit, env, settings)
        self.constraints = Constraints(limit, cost_limits, multiplier or MultiplierConfig())
        self.cost_gamma = cost_gamma
        settings.setdefault("replay_buffer_class", CostReplayBuffer)
        kept = settings.get("replay_buffer_kwargs") or {}
        settings["replay_buffer_kwargs"] = {**kept, "cost_limits": self.constraints.groups}
        super().__init__(policy, env, *arguments, **settings)

    def _setup_model(self) -> None:
        super()._setup_model()
        size = require_flat(self.observation_space) + int(np.prod(self.action_space.shape or (1,)))
        limits = self.constraints.limits
        self.cost_critic = CostCritic(size, limits, (256, 256)).to(self.device)
        self.cost_target = copy.deepcopy(self.cost_critic)
        self.cost_optimizer = torch.optim.Adam(self.cost_critic.parameters(), lr=float(self.lr_schedule(1.0)))
        self._episodes = EpisodeCosts(self.n_envs, len(limits), self.constraints.window)

    def _update_info_buffer(self, infos: list[dict[str, Any]], dones: NDArray[np.bool_] | None = None) -> None:
        """Called once a step: what it cost; the multipliers move when an episode has ended."""
        super()._update_info_buffer(infos, dones)
        ended = np.zeros(len(infos), dtype=np.bool_) if dones is None else np.asarray(dones, dtype=np.bool_)
        self._episodes.add(costs_in(infos, self.constraints.groups), ended)
        means = self._episodes.take()
        if means is not None:
            self.constraints.update(means, self.num_timesteps)
            for key, mean in self.constraints.named("episode_mean", means).items():
                self.logger.record_mean(key, mean)

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Steps of the critics of reward and cost, the actor, and the temperature."""
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        for _ in range(gradient_steps):
            batch = self.replay_buffer.draw(batch_size)  # type: ignore[union-attr]
            action, log_prob = self.actor.action_log_prob(batch.observations)
            log_prob = log_prob.reshape(-1, 1)
            alpha = self._temperature(log_prob)
            self._step_critics(batch, alpha)
            self._step_actor(batch, action, log_prob, alpha)
            polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
            polyak_update(self.cost_critic.parameters(), self.cost_target.parameters(), self.tau)
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for key, value in self.constraints.named("multiplier", self.constraints.values).items():
            self.logger.record(key, value)

    def _temperature(self, log_prob: torch.Tensor) -> torch.Tensor:
        """alpha as it is; where it is learnt, a step of it after."""
        if self.ent_coef_optimizer is None or self.log_ent_coef is None:
            return self.ent_coef_tensor
        alpha = self.log_ent_coef.detach().exp()
        loss = -(self.log_ent_coef * (log_prob.detach() + float(self.target_entropy))).mean()
        _step(self.ent_coef_optimizer, loss)
        return alpha

    def _step_critics(self, batch: CostTransitions, alpha: torch.Tensor) -> None:
        with torch.no_grad():
            action, log_prob = self.actor.action_log_prob(batch.next_observations)
            worth = torch.cat(self.critic_target(batch.next_observations, action), dim=1).min(dim=1, keepdim=True)[0]
            goal = batch.rewards + (1 - batch.dones) * self.gamma * (worth - alpha * log_prob.reshape(-1, 1))
            to_pay = self.cost_target(torch.cat([batch.next_observations, action], dim=1))
            due = batch.costs + (1 - batch.dones) * self.cost_gamma * to_pay
        found = self.critic(batch.observations, batch.actions)
        _step(self.critic.optimizer, torch.stack([functional.mse_loss(q, goal) for q in found]).sum() / 2)
        given = torch.cat([batch.observations, batch.actions], dim=1)
        _step(self.cost_optimizer, self.cost_critic.loss(given, due))

    def _step_actor(
        self, batch: CostTransitions, action: torch.Tensor, log_prob: torch.Tensor, alpha: torch.Tensor
    ) -> None:
        weights = self.constraints.values
        worth = torch.cat(self.critic(batch.observations, action), dim=1).min(dim=1, keepdim=True)[0]
        costs = self.cost_critic(torch.cat([batch.observations, action], dim=1))
        priced = (costs * torch.tensor(weights, dtype=costs.dtype, device=costs.device)).sum(dim=1, keepdim=True)
        _step(self.actor.optimizer, ((alpha * log_prob - worth + priced) / (1.0 + sum(weights))).mean())

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        names, tensors = super()._get_torch_save_params()
        return [*names, *self.EXTRA], tensors

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *self.EXTRA, "_episodes"]


def _step(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
