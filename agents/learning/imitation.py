"""Where learning by reward may begin: a policy fitted to what a driver does, in the places that the policy comes to.

Dataset aggregation (Ross, Gordon and Bagnell 2011): in the first round the driver drives, in the following ones the
policy as far as it has come; at every decision the driver says what it would do, and after each round the policy is
fitted to all that was said so far. A policy that only copied drives of the driver would not know the way back to them.
What is fitted of continuous actions is their mean; how widely the policy tries others afterwards stays as it was set.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Driver
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig
from lanebound.agents.learning.opening import episode_seeds

__all__ = ["imitate", "imitated_driver"]


def imitated_driver(experiment: ExperimentConfig) -> Driver | None:
    """Whom the policy is to begin from, ready to drive; None where it begins from nothing.

    Raises
    ------
    InputError
        The environment has no actions for the driver, or does not show what it needs.
    """
    if experiment.imitation is None:
        return None
    with closing(experiment.open()) as single:
        return make_agent(experiment.imitation.driver, single)


def imitate(
    experiment: ExperimentConfig,
    config: ImitationConfig,
    driver: Driver,
    model: BaseAlgorithm,
    env: VecEnv,
    stepped: Callable[[int], None] = lambda decisions: None,
) -> list[float]:
    """Fit what the policy of ``model`` does without its noise to a driver; returns the mean loss after each round.

    Parameters
    ----------
    env : of the experiment; the episodes are none of those learnt from by reward, nor of those judged by
    stepped : called with the decisions so far, at every step
    """
    env.seed(episode_seeds(experiment, 0, "imitation"))
    seen: list[NDArray[np.float32]] = []
    said: list[NDArray[Any]] = []
    observations: Any = env.reset()
    starts, state = np.ones(env.num_envs, dtype=np.bool_), None
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=config.learning_rate)
    losses = []
    for turn in range(config.rounds):
        for _ in range(-(-config.decisions // env.num_envs)):
            wanted, state = driver.predict(observations, state, starts)
            seen.append(np.array(observations, dtype=np.float32))
            said.append(np.array(wanted))
            actions = wanted if turn == 0 else model.predict(observations, deterministic=True)[0]
            observations, _, starts, _ = env.step(np.asarray(actions))
            stepped(len(seen) * env.num_envs)
        losses.append(_fit(model, np.concatenate(seen), np.concatenate(said), config, optimiser))
    return losses


def _fit(
    model: BaseAlgorithm, seen: NDArray[np.float32], said: NDArray[Any], config: ImitationConfig, optimiser: Any
) -> float:
    """Some epochs over all that was said; the mean loss of the last."""
    given, wanted = torch.as_tensor(seen, device=model.device), torch.as_tensor(said, device=model.device)
    losses: list[float] = []
    model.policy.set_training_mode(True)
    for _ in range(config.epochs):
        losses = []
        order = torch.randperm(len(given), device=model.device)
        for begin in range(0, len(order), config.batch_size):
            rows = order[begin : begin + config.batch_size]
            loss = _misfit(model, given[rows], wanted[rows])
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            losses.append(loss.item())
    return float(np.mean(losses))


def _misfit(model: BaseAlgorithm, given: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Mean square of how far continuous actions are off; of discrete ones how unlikely the driver's is (log loss)."""
    policy: Any = model.policy
    law = policy.get_distribution(given)
    continuous = isinstance(model.action_space, spaces.Box)
    off: torch.Tensor = (law.mode() - wanted).square() if continuous else -law.log_prob(wanted)
    return off.mean()
