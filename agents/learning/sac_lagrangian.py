"""Soft actor-critic under a limit of an episode's cost, by a Lagrange multiplier.

The actor minimises ``alpha log pi - Q_r + lambda Q_c``, divided by ``1 + lambda`` (Ha et al. 2020, Stooke et al. 2020);
Q_c is a critic of costs with a target of its own, lambda the multiplier of :mod:`.multiplier`.
"""

from __future__ import annotations

import copy
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.utils import polyak_update
from torch.nn import functional

from lanebound.agents.learning.costs import CostCritic, EpisodeCosts, costs_in, require_flat
from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig

__all__ = ["CostReplayBuffer", "SACLagrangian"]


class CostTransitions(NamedTuple):
    """Transitions, (B, ...) each."""

    observations: torch.Tensor
    actions: torch.Tensor
    next_observations: torch.Tensor
    dones: torch.Tensor
    rewards: torch.Tensor
    costs: torch.Tensor


class CostReplayBuffer(ReplayBuffer):
    """Transitions with what they cost."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.costs = np.zeros((self.buffer_size, self.n_envs), dtype=np.float32)

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
        self.costs[self.pos] = costs_in(infos)
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
            self.costs[rows, columns][:, None],
        )
        return CostTransitions(*(torch.as_tensor(array, dtype=torch.float32, device=self.device) for array in arrays))


class SACLagrangian(SAC):
    """SAC of stable-baselines3, whose policy also keeps ``info["cost"]`` of an episode below a limit.

    Parameters
    ----------
    policy, env, *arguments, **settings : as of SAC; observations are flat
    cost_limit : of the sum of costs over an episode
    multiplier : gains of its control, updated when episodes have ended
    cost_gamma : discount of costs

    Raises
    ------
    InputError
        Observations that are not one vector, a limit that is not positive, or an environment without costs.
    """

    EXTRA: ClassVar[list[str]] = ["cost_critic", "cost_target", "cost_optimizer"]

    def __init__(
        self,
        policy: Any,
        env: Any,
        *arguments: Any,
        cost_limit: float = 1.0,
        multiplier: MultiplierConfig | None = None,
        cost_gamma: float = 0.99,
        **settings: Any,
    ) -> None:
        self.cost_limit, self.cost_gamma = cost_limit, cost_gamma
        self.multiplier = Multiplier(cost_limit, multiplier or MultiplierConfig())
        settings.setdefault("replay_buffer_class", CostReplayBuffer)
        super().__init__(policy, env, *arguments, **settings)

    def _setup_model(self) -> None:
        super()._setup_model()
        size = require_flat(self.observation_space) + int(np.prod(self.action_space.shape or (1,)))
        self.cost_critic = CostCritic(size, self.cost_limit, (256, 256)).to(self.device)
        self.cost_target = copy.deepcopy(self.cost_critic)
        self.cost_optimizer = torch.optim.Adam(self.cost_critic.parameters(), lr=float(self.lr_schedule(1.0)))
        self._episodes = EpisodeCosts(self.n_envs, self.multiplier.config.window)

    def _update_info_buffer(self, infos: list[dict[str, Any]], dones: NDArray[np.bool_] | None = None) -> None:
        """Called once a step: what it cost; the multiplier moves when an episode has ended."""
        super()._update_info_buffer(infos, dones)
        ended = np.zeros(len(infos), dtype=np.bool_) if dones is None else np.asarray(dones, dtype=np.bool_)
        self._episodes.add(costs_in(infos), ended)
        mean = self._episodes.take()
        if mean is not None:
            self.multiplier.update(mean, self.num_timesteps)
            self.logger.record_mean("cost/episode_mean", mean)

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
        self.logger.record("cost/multiplier", self.multiplier.value)

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
            to_pay = self.cost_target(torch.cat([batch.next_observations, action], dim=1))[:, None]
            due = batch.costs + (1 - batch.dones) * self.cost_gamma * to_pay
        found = self.critic(batch.observations, batch.actions)
        _step(self.critic.optimizer, torch.stack([functional.mse_loss(q, goal) for q in found]).sum() / 2)
        given = torch.cat([batch.observations, batch.actions], dim=1)
        _step(self.cost_optimizer, self.cost_critic.loss(given, due[:, 0]))

    def _step_actor(
        self, batch: CostTransitions, action: torch.Tensor, log_prob: torch.Tensor, alpha: torch.Tensor
    ) -> None:
        weight = self.multiplier.value
        worth = torch.cat(self.critic(batch.observations, action), dim=1).min(dim=1, keepdim=True)[0]
        cost = self.cost_critic(torch.cat([batch.observations, action], dim=1))[:, None]
        _step(self.actor.optimizer, ((alpha * log_prob - worth + weight * cost) / (1.0 + weight)).mean())

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        names, tensors = super()._get_torch_save_params()
        return [*names, *self.EXTRA], tensors

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *self.EXTRA, "_episodes"]


def _step(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
