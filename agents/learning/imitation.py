"""Where learning by reward may begin: a policy fitted to what a driver does, in the places that the policy comes to.

Dataset aggregation (Ross, Gordon and Bagnell 2011): in the first round the driver drives, in the following ones the
policy as far as it has come; at every decision the driver says what it would do, and after each round the policy is
fitted to all that was said so far. A policy that only copied drives of the driver would not know the way back to them.
What is fitted of continuous actions is their mean; how widely the policy tries others afterwards stays as it was set.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any, NamedTuple

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

__all__ = ["Teacher", "imitate", "teacher_of"]


class Teacher(NamedTuple):
    """Whom a policy begins from, ready to drive, and how it is shown."""

    driver: Driver
    lessons: ImitationConfig


def teacher_of(experiment: ExperimentConfig) -> Teacher | None:
    """Whom the policy is to begin from; None where it begins from nothing.

    Raises
    ------
    InputError
        The environment has no actions for the driver, or does not show what it needs.
    """
    if experiment.imitation is None:
        return None
    with closing(experiment.open()) as single:
        return Teacher(make_agent(experiment.imitation.driver, single), experiment.imitation)


def imitate(
    experiment: ExperimentConfig,
    teacher: Teacher,
    model: BaseAlgorithm,
    env: VecEnv,
    stepped: Callable[[int], None] = lambda decisions: None,
) -> list[float]:
    """Fit what the policy of ``model`` does without its noise to its teacher; returns the mean loss after each round.

    Parameters
    ----------
    env : of the experiment; the episodes are none of those learnt from by reward, nor of those judged by
    stepped : called with the decisions so far, at every step
    """
    driver, lessons = teacher
    env.seed(episode_seeds(experiment, 0, "imitation"))
    seen: list[NDArray[np.float32]] = []
    said: list[NDArray[Any]] = []
    observations: Any = env.reset()
    starts, state = np.ones(env.num_envs, dtype=np.bool_), None
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=lessons.learning_rate)
    losses = []
    for turn in range(lessons.rounds):
        for _ in range(-(-lessons.decisions // env.num_envs)):
            wanted, state = driver.predict(observations, state, starts)
            seen.append(np.array(observations, dtype=np.float32))
            said.append(np.array(wanted))
            actions = wanted if turn == 0 else model.predict(observations, deterministic=True)[0]
            observations, _, starts, _ = env.step(np.asarray(actions))
            stepped(len(seen) * env.num_envs)
        losses.append(_fit(model, np.concatenate(seen), np.concatenate(said), lessons, optimiser))
    return losses


def _fit(
    model: BaseAlgorithm, seen: NDArray[np.float32], said: NDArray[Any], lessons: ImitationConfig, optimiser: Any
) -> float:
    """Some epochs over all that was said; the mean loss of the last."""
    given, wanted = torch.as_tensor(seen, device=model.device), torch.as_tensor(said, device=model.device)
    losses: list[float] = []
    model.policy.set_training_mode(True)
    for _ in range(lessons.epochs):
        losses = []
        order = torch.randperm(len(given), device=model.device)
        for begin in range(0, len(order), lessons.batch_size):
            rows = order[begin : begin + lessons.batch_size]
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
