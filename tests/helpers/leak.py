"""How much of the signed position errors an observation gives away, by regression on held-out episodes.

An agent must not know the sign and the size of its position error. ``leak`` fits gradient boosting of the errors along
and across the track on whole observations and returns R^2 on episodes that were not fitted on: 0 for none.

    .venv/bin/python tests/helpers/leak.py CarFollowing sensor 64      # id, perception source, episodes
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

import lanebound.envs  # noqa: F401 - registers the ids
from lanebound.agents.drivers import make_agent
from lanebound.envs.core import DrivingEnv
from lanebound.envs.observation import entries

AXES = ("err_at_m", "err_ct_m")
HELD_OUT = 0.4  # share of the episodes
BATCH = 64  # environments of the engine


class Samples(NamedTuple):
    """Observations (n, E), errors (n, 2) [m], and the episode of each row (n,)."""

    observations: NDArray[np.float32]
    errors: NDArray[np.float64]
    episode: NDArray[np.int64]
    columns: tuple[str, ...]


def samples(name: str, source: str, episodes: int, seed: int = 1000, **config: Any) -> Samples:
    """Drives of ``nominal`` under an id and a perception source, on consecutive seeds."""
    made = {"observation": {"form": "flat"}, "perception": {"source": source}, **config}
    env = gymnasium.make(f"lanebound/{name}-v0", config=made).unwrapped
    assert isinstance(env, DrivingEnv)
    columns = tuple(entry.column for entry in entries(env.config.observation))
    compiled = gymnasium.spec(f"lanebound/{name}-v0").vector_entry_point is not None
    rows = _compiled(name, made, env, episodes, seed) if compiled else _single(env, episodes, seed)
    return Samples(*(np.concatenate(part) for part in zip(*rows, strict=True)), columns)


def _single(env: DrivingEnv, episodes: int, seed: int) -> list[tuple[Any, Any, Any]]:
    agent, rows = make_agent("nominal", env), []
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        over = False
        while not over:
            action, _ = agent.predict(observation)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            rows.append((observation[None], np.array([[info[axis] for axis in AXES]]), np.array([episode])))
    return rows


def _compiled(
    name: str, config: dict[str, Any], env: DrivingEnv, episodes: int, seed: int
) -> list[tuple[Any, Any, Any]]:
    agent, rows, count = make_agent("nominal", env), [], min(episodes, BATCH)
    envs = gymnasium.make_vec(f"lanebound/{name}-v0", count, config=config, autoreset_mode="Disabled")
    for first in range(0, episodes, count):
        observations, _ = envs.reset(seed=seed + first)
        live = np.ones(count, dtype=np.bool_)
        while live.any():
            actions, _ = agent.predict(observations)
            observations, _, terminated, truncated, infos = envs.step(actions)
            here = np.flatnonzero(live)
            rows.append((observations[here], np.stack([infos[axis][here] for axis in AXES], -1), first + here))
            over = terminated | truncated
            live &= ~over
            if over.any() and live.any():
                observations, _ = envs.reset(options={"reset_mask": over})
    return rows


def leak(data: Samples) -> dict[str, float]:
    """R^2 of each error on held-out episodes; negative where the fit is worse than the mean."""
    held = data.episode >= (1.0 - HELD_OUT) * (data.episode.max() + 1)
    found = {}
    for k, axis in enumerate(AXES):
        model = HistGradientBoostingRegressor(max_iter=100, learning_rate=0.1, min_samples_leaf=40, random_state=0)
        truth = data.errors[held, k]
        with threadpool_limits(1):  # threads that wait for each other are slow beside other processes
            model.fit(data.observations[~held], data.errors[~held, k])
            rest = truth - model.predict(data.observations[held])
        found[axis] = 1.0 - float(np.square(rest).sum() / np.square(truth - truth.mean()).sum())
    return found


def suspects(data: Samples, axis: str, most: int = 5) -> list[tuple[str, float]]:
    """The columns that correlate most with an error, with their squared correlation."""
    error = data.errors[:, AXES.index(axis)]
    spread = data.observations.std(0) * error.std()
    both = ((data.observations - data.observations.mean(0)) * (error - error.mean())[:, None]).mean(0)
    squared = np.where(spread > 0.0, both / np.where(spread > 0.0, spread, 1.0), 0.0) ** 2
    return [(data.columns[i], float(squared[i])) for i in np.argsort(-squared)[:most]]


if __name__ == "__main__":
    found = samples(sys.argv[1], sys.argv[2], int(sys.argv[3]))
    print(sys.argv[1:], len(found.errors), {axis: round(value, 3) for axis, value in leak(found).items()})
    print("std", found.errors.std(0).round(3), *(suspects(found, axis) for axis in AXES))
