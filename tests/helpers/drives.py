"""Many episodes of an agent under an id: in the vector engine where it has the world, else one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import full_id
from lanebound.envs.core import DrivingEnv

BATCH = 64  # environments of the engine
Array = NDArray[Any]


class Decisions(NamedTuple):
    """What follows from a decision in n episodes.

    episode (n,): their numbers; observations (n, ...), rewards (n,), over (n,): whether an episode ends; infos: arrays
    (n,) by name.
    """

    episode: Array
    observations: Any
    rewards: Array
    over: Array
    infos: Mapping[str, Array]


def single_of(name: str, config: Mapping[str, Any]) -> DrivingEnv:
    """A single environment of an id."""
    env = gymnasium.make(full_id(name), config=dict(config)).unwrapped
    assert isinstance(env, DrivingEnv)
    return env


def drives(
    name: str, config: Mapping[str, Any], agent: str, figures: Mapping[str, Any] | None, episodes: int, seed: int
) -> Iterator[Decisions]:
    """Drive consecutive seeds with flat observations."""
    made = {**config, "observation": {**config.get("observation", {}), "form": "flat"}}
    env = single_of(name, made)
    driver = make_agent(agent, env, figures)
    compiled = gymnasium.spec(full_id(name)).vector_entry_point is not None
    return _compiled(name, made, driver, episodes, seed) if compiled else _single(env, driver, episodes, seed)


def _single(env: DrivingEnv, driver: Any, episodes: int, seed: int) -> Iterator[Decisions]:
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        over, state, start = False, None, np.ones(1, dtype=np.bool_)
        while not over:
            action, state = driver.predict(observation, state=state, episode_start=start)
            observation, reward, terminated, truncated, info = env.step(action)
            start, over = np.zeros(1, dtype=np.bool_), terminated or truncated
            infos = {key: np.array([value]) for key, value in info.items() if key != "rewards"}
            yield Decisions(np.array([episode]), observation[None], np.array([reward]), np.array([over]), infos)


def _compiled(name: str, config: dict[str, Any], driver: Any, episodes: int, seed: int) -> Iterator[Decisions]:
    count = min(episodes, BATCH)
    envs = gymnasium.make_vec(full_id(name), count, config=config, autoreset_mode="Disabled")
    for first in range(0, episodes, count):
        observations, _ = envs.reset(seed=seed + first)
        live, state, start = np.ones(count, dtype=np.bool_), None, np.ones(count, dtype=np.bool_)
        live[episodes - first :] = False
        while live.any():
            actions, state = driver.predict(observations, state=state, episode_start=start)
            observations, rewards, terminated, truncated, infos = envs.step(actions)
            here, over = np.flatnonzero(live), terminated | truncated
            shown = {key: value[here] for key, value in infos.items() if key != "rewards" and key[0] != "_"}
            yield Decisions(first + here, observations[here], rewards[here], over[here], shown)
            live &= ~over
            start = over
            if over.any() and live.any():
                observations, _ = envs.reset(options={"reset_mask": over})
