"""The loop: an agent drives episodes of an environment, and watchers receive every step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from lanebound.agents.drivers.base import Driver
from lanebound.agents.episodes.columns import Moment
from lanebound.envs.core import DrivingEnv

__all__ = ["Watcher", "drive", "moment_of"]


class Watcher(Protocol):
    """Receives every step."""

    def note(self, moment: Moment) -> None:
        """A step was taken, or an episode begins (step 0)."""


def drive(
    env: DrivingEnv,
    agent: Driver,
    seeds: Sequence[int],
    watchers: Sequence[Watcher] = (),
    ended: Callable[[int], None] = lambda episode: None,
    options: dict[str, Any] | None = None,
) -> None:
    """Drive one episode for each seed; the agent receives observations, the watchers whole moments.

    Parameters
    ----------
    ended : called with the number of each finished episode
    options : of every reset
    """
    for episode, seed in enumerate(seeds):
        for moment in _moments(env, agent, episode, seed, options):
            for watcher in watchers:
                watcher.note(moment)
        ended(episode)


def _moments(env: DrivingEnv, agent: Driver, episode: int, seed: int, options: dict[str, Any] | None) -> Any:
    """The moments of an episode, from its start to its end."""
    observation, info = env.reset(seed=seed, options=options)
    yield moment_of(env, episode, seed, 0, None, 0.0, False, False, info)
    state, start, step, over = None, np.ones(1, dtype=np.bool_), 0, False
    while not over:
        try:
            action, state = agent.predict(observation, state=state, episode_start=start, deterministic=True)
        except Exception as error:
            error.add_note(f"at seed {seed}, step {step}")
            raise
        observation, reward, terminated, truncated, info = env.step(action)
        start, step, over = np.zeros(1, dtype=np.bool_), step + 1, terminated or truncated
        yield moment_of(env, episode, seed, step, action, reward, terminated, truncated, info)


def moment_of(env: DrivingEnv, *rest: Any) -> Moment:
    """The present moment; ``rest`` are the fields of a Moment after its belief."""
    assert env.belief_loop is not None
    return Moment(env, env.belief_loop.belief(), *rest)
