"""Where learning by reward may begin: a policy fitted to what a driver does, in the places that the policy comes to.

Dataset aggregation (Ross, Gordon and Bagnell 2011): in the first round the driver drives, in the following ones the
policy as far as it has come; at every decision the driver says what it would do, and after each round the policy is
fitted to all that was said so far. A policy that only copied drives of the driver would not know the way back to them.
What is fitted of continuous actions is their mean; how widely the policy tries others afterwards stays as it was set.
Environments begin together and drive on from round to round: of episodes longer than all rounds nobody shows the end,
and of the part in which the first round falls only the driver's own way is shown.

The driver may be shown more than the policy (a privileged teacher): then environments show what the driver needs, and
the policy is handed its part of that.
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
from lanebound.agents.learning.experiment import ExperimentConfig, ImitationConfig
from lanebound.agents.learning.opening import episode_seeds
from lanebound.envs.observation import ObservationConfig, entries
from lanebound.integrity.core.errors import ConfigError, InputError

__all__ = ["Teacher", "imitate", "teacher_of"]

Places = NDArray[np.intp]
UNREADABLE = (
    OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError, EOFError, UnpicklingError,
)  # fmt: skip


class Teacher(NamedTuple):
    """Whom a policy begins from, ready to drive, and how it is shown.

    Attributes
    ----------
    driver, lessons : who shows, and how long
    experiment : whose environments show what the driver needs
    places : where the entries that the policy sees stand among those
    """

    driver: Driver
    lessons: ImitationConfig
    experiment: ExperimentConfig
    places: Places


def teacher_of(experiment: ExperimentConfig) -> Teacher | None:
    """Whom the policy is to begin from; None where it begins from nothing.

    Raises
    ------
    InputError
        The environment has no actions for the driver, or does not show what it or the policy needs.
    """
    if experiment.imitation is None:
        return None
    with closing(experiment.open()) as single:
        ours = single.config.observation
    shown = experiment.as_driver_sees()
    try:
        single = shown.open()
    except ConfigError as error:  # of what is shown otherwise, since the experiment's own could be opened
        raise ConfigError(str(error).replace("overrides.observation", "imitation.observation")) from None
    with closing(single):
        driver, theirs = make_agent(experiment.imitation.driver, single), single.config.observation
    return Teacher(driver, experiment.imitation, shown, _places(ours, theirs))


def _places(ours: ObservationConfig, theirs: ObservationConfig) -> Places:
    """Where the entries of one flat observation stand in another; InputError where they are not all there."""
    at = {entry: place for place, entry in enumerate(entries(theirs))}
    missing = [entry.column for entry in entries(ours) if entry not in at]
    if missing:
        raise InputError(
            f"imitation.observation must show the driver all that the policy sees, in the same scales, got none of "
            f"{', '.join(missing[:3])}{' ...' if missing[3:] else ''}: change of it only what adds entries"
        )
    if ours.history != theirs.history or (ours.integrity == "oracle") != (theirs.integrity == "oracle"):
        raise InputError(
            "imitation.observation must keep history and whether the truth is shown, got others than the policy's: "
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
    """Fit what the policy of ``model`` does without its noise to its teacher; returns the mean loss after each round.

    Parameters
    ----------
    env : of the teacher's experiment; the episodes are none of those learnt from by reward, nor of those judged by
    stepped : called with the decisions so far, at every step
    kept : file for what was said so far and the policy fitted to it, written after each round; from one that is there
        it goes on, with other episodes and these from their beginning; None: nowhere
    """
    driver, lessons, experiment, places = teacher
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=lessons.learning_rate)
    heard = _Heard([], [], []) if kept is None or not kept.exists() else _taken_up(kept, model, optimiser)
    env.seed(episode_seeds(experiment, len(heard.losses), "imitation"))
    observations: Any = env.reset()
    starts, state = np.ones(env.num_envs, dtype=np.bool_), None
    for turn in range(len(heard.losses), lessons.rounds):
        for _ in range(-(-lessons.decisions // env.num_envs)):
            wanted, state = driver.predict(observations, state, starts)
            ours = np.array(observations[:, places], dtype=np.float32)
            heard.seen.append(ours)
            heard.said.append(np.array(wanted))
            actions = wanted if turn == 0 else model.predict(ours, deterministic=True)[0]
            observations, _, starts, _ = env.step(np.asarray(actions))
            stepped(len(heard.seen) * env.num_envs)
        heard.losses.append(_fit(model, heard, lessons, optimiser))
        if kept is not None:
            _keep(kept, heard, model, optimiser)
    return heard.losses


class _Heard(NamedTuple):
    """What the policy saw and the driver said, step by step of all environments, and the loss after each round."""

    seen: list[NDArray[np.float32]]
    said: list[NDArray[Any]]
    losses: list[float]


def _keep(path: Path, heard: _Heard, model: BaseAlgorithm, optimiser: torch.optim.Optimizer) -> None:
    states = {
        "seen": torch.as_tensor(np.stack(heard.seen)),
        "said": torch.as_tensor(np.stack(heard.said)),
        "losses": heard.losses,
        "policy": model.policy.state_dict(),
        "optimiser": optimiser.state_dict(),
        "draws": torch.get_rng_state(),
    }
    with replace_file(path) as draft:
        torch.save(states, draft)


def _taken_up(path: Path, model: BaseAlgorithm, optimiser: torch.optim.Optimizer) -> _Heard:
    """What was kept after a round; the policy and its fit are as they were then."""
    try:
        states = torch.load(path, weights_only=True)
        model.policy.load_state_dict(states["policy"])
        optimiser.load_state_dict(states["optimiser"])
        torch.set_rng_state(states["draws"])
        return _Heard(list(states["seen"].numpy()), list(states["said"].numpy()), states["losses"])
    except UNREADABLE as error:
        raise InputError(
            f"{path} must be as imitation wrote it, got another file ({type(error).__name__}): delete it to begin anew"
        ) from error


def _fit(model: BaseAlgorithm, heard: _Heard, lessons: ImitationConfig, optimiser: torch.optim.Optimizer) -> float:
    """Some epochs over all that was said; the mean loss of the last."""
    given = torch.as_tensor(np.concatenate(heard.seen), device=model.device)
    wanted = torch.as_tensor(np.concatenate(heard.said), device=model.device)
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
