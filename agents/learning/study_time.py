"""The expected time of a study on this machine, from a short measurement of its environments."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np

from lanebound.agents.benchmark.episode import allotted_s
from lanebound.agents.learning.experiment import ExperimentConfig
from lanebound.agents.learning.opening import for_learning
from lanebound.agents.learning.study import BESIDE, Course, LearningStudyConfig
from lanebound.agents.learning.training import one_thread

__all__ = ["Pace", "measured", "study_hours"]

LEARNING_S = 2e-4  # of the networks of PPO, a decision; measured
MOMENT_S = 2.0


class Pace(NamedTuple):
    """Time of a decision in training and alone [s], and decisions of an episode that lasts to its end."""

    learning_s: float
    alone_s: float
    decisions: float


def study_hours(study: LearningStudyConfig, course: Course) -> float:
    """Core time of a whole study [h]: trainings, their evaluations, and the drivers beside them.

    Raises
    ------
    ConfigError, InputError
        An environment is refused.
    """
    paces = {env: measured(next(one for one in course.trainings if one.env == env).experiment(study))
             for env in study.envs}  # fmt: skip
    learning_s = sum(_seconds(one.experiment(study), paces[one.env], study.test_seeds) for one in course.trainings)
    alone_s = sum(paces[env].alone_s * paces[env].decisions for env, _ in study.places)
    return (learning_s + len(BESIDE) * study.test_seeds * alone_s) / 3600.0


def _seconds(planned: ExperimentConfig, pace: Pace, test_seeds: int) -> float:
    checkpoints = -(-planned.steps // planned.checkpoint_steps)
    shown = 0 if planned.imitation is None else planned.imitation.total(planned.count)
    checkpoints += planned.imitation is not None
    judged = (checkpoints * planned.evaluation_episodes + test_seeds) * pace.decisions
    return (planned.steps + shown + judged) * pace.learning_s


def measured(planned: ExperimentConfig) -> Pace:
    """Speed of an experiment's environments on this machine, with random actions."""
    with one_thread(), closing(for_learning(planned, 1)) as many, closing(planned.open()) as single:
        many.reset()
        learning_s = _each(lambda: many.step(np.stack([many.action_space.sample() for _ in range(many.num_envs)])))
        single.reset(seed=planned.seed)

        def step() -> None:
            *_, terminated, truncated, _ = single.step(single.action_space.sample())
            if terminated or truncated:
                single.reset()

        alone_s = _each(step)
        decisions = allotted_s(single) / single.dt_s
    return Pace(learning_s / planned.count + LEARNING_S, alone_s, decisions)


def _each(step: Callable[[], Any]) -> float:
    """Processor time of a step [s], after a first one that is not counted."""
    step()
    begun, count = time.process_time(), 0
    while (passed := time.process_time() - begun) < MOMENT_S:
        step()
        count += 1
    return passed / count
