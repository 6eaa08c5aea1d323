"""Imitation before learning by reward: a policy is fitted to the actions of a driver, in states that the policy visits.

Dataset aggregation (Ross, Gordon and Bagnell 2011): in the first round the driver drives, in the following ones the
present policy; every decision is labelled with the action of the driver, and after each round the policy is fitted to
all labels. A policy fitted to drives of the driver alone could not return to them after an error. Of continuous actions
the mean is fitted; the spread of exploration is unchanged. Environments begin together and continue from round to
round: the end of an episode that is longer than all rounds is not shown, and the part of it in the first round is shown
on the driver's own path only.

The driver may observe more than the policy (a privileged teacher): then environments have the observations of the
driver, and the policy receives its part of them.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.checkpointing.files import replace_file
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Driver
from lanebound.agents.drivers.layered import LayeredDriver
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig, Shield
from lanebound.agents.learning.opening import episode_seeds
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = ["Teacher", "imitate", "teacher_of"]

Places = NDArray[np.intp]
UNREADABLE = (
    OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError, EOFError, UnpicklingError,
)  # fmt: skip


class Teacher(NamedTuple):
    """The driver that a policy imitates.

    Attributes
    ----------
    driver, lessons : the driver, under the rules of the shield layer, and the configuration of the imitation
    experiment : has environments with the observations of the driver
    places : places of the policy's entries among those of the driver
    """

    driver: Driver
    lessons: ImitationConfig
    experiment: ExperimentConfig
    places: Places


def teacher_of(experiment: ExperimentConfig) -> Teacher | None:
    """The teacher of an experiment; None without imitation.

    Raises
    ------
    InputError
        The environment has no actions for the driver, or its observations lack entries of the driver or the policy.
    """
    if experiment.imitation is None:
        return None
    with closing(experiment.open()) as single:
        ours = single.config.observation
    try:
        shown = experiment.as_driver_sees()
        single = shown.open()
    except ConfigError as error:  # of the driver's observations, as those of the experiment are valid
        raise ConfigError(str(error).replace("overrides.observation", "imitation.observation")) from None
    with closing(single):
        driver, theirs = make_agent(experiment.imitation.driver, single), single.config.observation
        if experiment.shield is Shield.LAYER:  # labels are what is carried out
            driver = LayeredDriver(single, driver, experiment.rules)
    return Teacher(driver, experiment.imitation, shown, _places(ours, theirs))


def _places(ours: ObservationConfig, theirs: ObservationConfig) -> Places:
    """Places of the entries of one flat observation in another; InputError where one is missing."""
    at = {entry: place for place, entry in enumerate(entries(theirs))}
    missing = [entry.column for entry in entries(ours) if entry not in at]
    if missing:
        raise InputError(
            f"imitation.observation must have all entries of the policy, in the same scales, got none of "
            f"{', '.join(missing[:3])}{' ...' if missing[3:] else ''}: change only what adds entries"
        )
    if ours.history != theirs.history or (ours.integrity == "oracle") != (theirs.integrity == "oracle"):
        raise InputError(
            "imitation.observation must have the history and integrity: oracle of the policy, got others: "
            "leave out history and integrity: oracle"
        )
    frame = np.array([at[entry] for entry in entries(ours)])
    return np.concatenate([frame + newer * len(at) for newer in range(ours.history)])


def imitate(
    teacher: Teacher,
    model: BaseAlgorithm,
    env: VecEnv,
    stepped: Callable[[int], None] = lambda decisions: None,
    kept: Path | None = None,
) -> list[float]:
    """Fit the policy of ``model``, without exploration, to its teacher; returns the mean loss after each round.

    Parameters
    ----------
    env : of the teacher's experiment; the episodes differ from those of learning by reward and of evaluations
    stepped : called with the number of decisions at every step
    kept : file of all labels and the fitted policy, written after each round; an existing file is resumed, with other
        episodes from their beginning; None: no file
    """
    driver, lessons, experiment, places = teacher
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=lessons.learning_rate)
    labels = _Labels([], [], []) if kept is None or not kept.exists() else _resumed(kept, model, optimiser)
    env.seed(episode_seeds(experiment, len(labels.losses), "imitation"))
    observations: Any = env.reset()
    starts, state = np.ones(env.num_envs, dtype=np.bool_), None
    for turn in range(len(labels.losses), lessons.rounds):
        for _ in range(-(-lessons.decisions // env.num_envs)):
            wanted, state = driver.predict(observations, state, starts)
            ours = np.array(observations[:, places], dtype=np.float32)
            labels.observations.append(ours)
            labels.actions.append(np.array(wanted))
            actions = wanted if turn == 0 else model.predict(ours, deterministic=True)[0]
            observations, _, starts, _ = env.step(np.asarray(actions))
            stepped(len(labels.observations) * env.num_envs)
        labels.losses.append(_fit(model, labels, lessons, optimiser))
        if kept is not None:
            _keep(kept, labels, model, optimiser)
    return labels.losses


class _Labels(NamedTuple):
    """Observations and actions of the driver, step by step of all environments, and the loss after each round."""

    observations: list[NDArray[np.float32]]
    actions: list[NDArray[Any]]
    losses: list[float]


def _keep(path: Path, labels: _Labels, model: BaseAlgorithm, optimiser: torch.optim.Optimizer) -> None:
    states = {
        "observations": torch.as_tensor(np.stack(labels.observations)),
        "actions": torch.as_tensor(np.stack(labels.actions)),
        "losses": labels.losses,
        "policy": model.policy.state_dict(),
        "optimiser": optimiser.state_dict(),
        "draws": torch.get_rng_state(),
    }
    with replace_file(path) as draft:
        torch.save(states, draft)


def _resumed(path: Path, model: BaseAlgorithm, optimiser: torch.optim.Optimizer) -> _Labels:
    """Labels of a file; the policy and its optimiser get their states of then."""
    try:
        states = torch.load(path, weights_only=True)
        model.policy.load_state_dict(states["policy"])
        optimiser.load_state_dict(states["optimiser"])
        torch.set_rng_state(states["draws"])
        return _Labels(list(states["observations"].numpy()), list(states["actions"].numpy()), states["losses"])
    except UNREADABLE as error:
        raise InputError(
            f"{path} must be as imitation wrote it, got another file ({type(error).__name__}): delete it to begin anew"
        ) from error


def _fit(model: BaseAlgorithm, labels: _Labels, lessons: ImitationConfig, optimiser: torch.optim.Optimizer) -> float:
    """Some epochs over all labels; the mean loss of the last one."""
    given = torch.as_tensor(np.concatenate(labels.observations), device=model.device)
    wanted = torch.as_tensor(np.concatenate(labels.actions), device=model.device)
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
    """Mean squared error of continuous actions; log loss of discrete ones."""
    policy: Any = model.policy
    law = policy.get_distribution(given)
    continuous = isinstance(model.action_space, spaces.Box)
    off: torch.Tensor = (law.mode() - wanted).square() if continuous else -law.log_prob(wanted)
    return off.mean()
