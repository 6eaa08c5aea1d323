"""The first episodes of a driver on training seeds, in the vector engine all at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.benchmark.suite import SPLITS
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes.opening import full_id
from lanebound.envs.batch.infos import as_ended
from lanebound.envs.ids import has_engine, preset_of
from lanebound.envs.vector.env import VectorDrivingEnv, engine_class, engines
from lanebound.integrity.core.errors import InputError

__all__ = ["Decision", "first_episodes"]


class Decision(NamedTuple):
    """A step of N environments.

    Attributes
    ----------
    infos : arrays (N,), those of the end where an episode ends with the step
    going : (N,), whether the first episode had not ended before the step; what others drive is not counted
    over : (N,), whether an episode ends with the step
    envs : the environments after the step
    """

    infos: dict[str, Any]
    going: NDArray[np.bool_]
    over: NDArray[np.bool_]
    envs: VectorDrivingEnv


def first_episodes(env: str, config: Mapping[str, Any], driver: str, count: int) -> Iterator[Decision]:
    """All steps until ``count`` episodes have ended, under the training seeds from the first on.

    Parameters
    ----------
    env : id, ours without lanebound/, in the engine
    config : changes of its preset

    Raises
    ------
    InputError
        The id has no engine, there is no such driver, or it cannot drive there; ConfigError for the configuration.
    """
    preset = preset_of(full_id(env))
    if preset is None or not has_engine(preset):
        raise InputError(f"envs must be ids with an engine, got '{env}': choose among {', '.join(engines())}")
    kind = engine_class(preset)
    with closing(kind(count, config, "SameStep")) as envs, closing(kind.KIND(config)) as single:
        agent: Any = make_agent(driver, single)
        observations, _ = envs.reset(seed=SPLITS["train"][0])
        going, state, start = np.ones(count, dtype=np.bool_), None, np.ones(count, dtype=np.bool_)
        while going.any():
            actions, state = agent.predict(observations, state=state, episode_start=start, deterministic=True)
            observations, _, terminated, truncated, infos = envs.step(actions)
            start = terminated | truncated
            yield Decision(as_ended(infos, start), going, start, envs)
            going = going & ~start
