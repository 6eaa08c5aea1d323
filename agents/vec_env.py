"""The vector engine as a vector environment of Stable-Baselines3.

>>> from stable_baselines3 import PPO
>>> config = {"observation": {"form": "flat"}}
>>> PPO("MlpPolicy", EngineVecEnv("lanebound/LaneKeeping-v0", 64, config)).learn(100_000)    # doctest: +SKIP
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from lanebound.agents.plugins import load_plugins, loaded_plugins
from lanebound.agents.presets import refuse_journey
from lanebound.envs import IDS
from lanebound.envs.batch.infos import NAMES, as_ended, single_info
from lanebound.envs.config import EnvConfig
from lanebound.envs.core import faults_in
from lanebound.envs.episode_totals import EPISODE_KEY, EpisodeTotals
from lanebound.envs.ids import every_preset, has_engine, id_of, preset_of
from lanebound.envs.info import own_info
from lanebound.envs.vector.env import VectorDrivingEnv, WrappedVectorEnv, engine_class, engines
from lanebound.envs.worlds import world_kind
from lanebound.integrity.core.accel import LOGGER
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["EngineVecEnv", "engine_of"]


class EngineVecEnv(VecEnv):
    """N environments of an id in the vector engine, for Stable-Baselines3. An ended episode restarts at once.

    ``infos[i]`` holds the entries of ``keys`` at every step, to save time. At the end of an episode it holds all
    entries of a single environment, ``terminal_observation``, ``TimeLimit.truncated``, and ``episode`` as
    ``VecMonitor`` does: return ``r``, length ``l`` and time ``t`` since the start [s]. ``arrays`` is the whole info of
    the last step as arrays (N,); where an episode ended, that of its end.

    Parameters
    ----------
    env_id, num_envs, config : as for ``gymnasium.make_vec``, or as for :func:`~lanebound.envs.wrap_vec`
    keys : entries of ``info`` wanted at every step
    statistics : whether the end of an episode also has ``episode_integrity``, as
        :class:`~lanebound.envs.wrappers.EpisodeStatistics` has it for single environments
    processes : over which the environments are divided, with the same results, in a script below
        ``if __name__ == "__main__":``; 1: in this one

    Raises
    ------
    InputError
        The engine does not have the id, or info does not have a key.
    ConfigError
        The engine does not support the configuration.
    """

    def __init__(
        self,
        env_id: str,
        num_envs: int,
        config: Mapping[str, Any] | None = None,
        keys: Sequence[str] = ("cost",),
        statistics: bool = False,
        processes: int = 1,
    ) -> None:
        if (make := engine_of(env_id)) is None:
            refuse_journey(env_id)
            if env_id not in IDS:
                ids = [id_of(kind) for kind in every_preset() if has_engine(kind)]
                raise InputError(f"env_id '{env_id}' is unknown: {nearest(env_id, ids)}")
            raise InputError(
                f"env_id must have an engine, as {', '.join(engines())} do, got {env_id!r}: choose one of these, or "
                "use DummyVecEnv or SubprocVecEnv"
            )
        if isinstance(keys, str):
            raise InputError(f"keys must be a list of entries of info, got {keys!r}: pass [{keys!r}]")
        self.envs: VectorDrivingEnv = make(
            num_envs,
            config,
            AutoresetMode.SAME_STEP,
            processes=processes,
            initialize=partial(load_plugins, tuple(loaded_plugins())),
        )
        known = (*NAMES, *own_info(self.envs.config))
        for key in keys:
            if key not in known:
                self.envs.close()  # its processes as well
                raise InputError(f"keys must be entries of info, got {key!r}: {nearest(key, known)}")
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)
        if (threads := torch.get_num_threads()) > 1:
            _advise_one_thread(threads)
        self.arrays: dict[str, Any] = {}
        self._keys = tuple(keys)
        self._actions: NDArray[Any] | None = None
        self._returns, self._lengths, self._begun = np.zeros(num_envs), np.zeros(num_envs, np.int64), time.time()
        self._totals = EpisodeTotals(num_envs) if statistics else None

    @property
    def config(self) -> EnvConfig:
        """The configuration that all environments share."""
        return self.envs.config

    def reset(self) -> Any:
        """Begin an episode in every environment, under the seeds of ``seed`` and with the faults of ``set_options``.

        Raises
        ------
        InputError
            Options that a single environment refuses.
        """
        everyone, given = np.ones(self.num_envs, dtype=np.bool_), self._options
        self._reset_options()  # those that are refused are not tried again
        observations, infos = self.envs.begin(self._seeds, everyone, [faults_in(own) for own in given])
        self.arrays = infos
        self._clear(slice(None))
        self.reset_infos = [single_info(infos, row) for row in range(self.num_envs)]
        self._reset_seeds()
        return observations

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Options of the next reset alone: of all environments, or a list with those of each.

        Raises
        ------
        InputError
            A list of another length, or options that no environment takes.
        """
        if isinstance(options, list | tuple) and len(options) != self.num_envs:
            raise InputError(
                f"options must be one dict, or one for each of {self.num_envs} environments, got {len(options)} of them"
            )
        for own in options if isinstance(options, list | tuple) else [options or {}]:
            faults_in(own)  # refuses what is misspelt
        super().set_options(options)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds of the next reset: of the first environment, the others have the following ones.

        Raises
        ------
        InputError
            No whole number, or a negative one.
        """
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
            raise InputError(f"seed must be a whole number of 0 or more, got {seed!r}: pass one for all environments")
        return super().seed(seed)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take commands for the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carry them out."""
        if self._actions is None:
            raise InputError("step_wait must follow step_async, got no actions: call step(actions)")
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        over = terminated | truncated
        self._actions, self.arrays = None, as_ended(infos, over)
        self._returns += rewards
        self._lengths += 1
        if self._totals is not None:
            self._totals.add(rewards, self.arrays)
        columns = [list(infos[key]) if infos[key].ndim > 1 else infos[key].tolist() for key in self._keys]
        found = [dict(zip(self._keys, row, strict=True)) for row in zip(*columns, strict=True)]
        found = found or [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(over)
        for row in ended.tolist():
            found[row] = single_info(infos["final_info"], row) | self._episode(row)
            found[row]["terminal_observation"] = infos["final_obs"][row]
            found[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
        if ended.size:
            self._clear(ended)
        return observations, rewards.astype(np.float32), over, found

    def _episode(self, row: int) -> dict[str, Any]:
        """Statistics of the episode that ends in an environment."""
        length, seconds = int(self._lengths[row]), round(time.time() - self._begun, 6)
        found: dict[str, Any] = {"episode": {"r": float(self._returns[row]), "l": length, "t": seconds}}
        if self._totals is not None:
            found[EPISODE_KEY] = self._totals.report(row, bool(self.arrays["is_success"][row]))
        return found

    def _clear(self, rows: Any) -> None:
        """Begin the statistics of episodes."""
        self._returns[rows], self._lengths[rows] = 0.0, 0
        if self._totals is not None:
            self._totals.clear(rows)

    def close(self) -> None:
        """Close the engine."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute that all environments share, once for each index."""
        if attr_name == "render_mode":
            return [None] * self._count(indices)
        if attr_name in ("observation_space", "action_space"):
            attr_name = f"single_{attr_name}"
        if attr_name == "np_random":
            raise InputError("np_random is not shared by the environments of an engine: seed them with seed()")
        return [getattr(self.envs, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the environments of an engine share their attributes."""
        raise InputError(f"{attr_name} must be set by the configuration in the vector engine, got {value!r}")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """``action_masks``, one for each index; no other method belongs to a single environment here."""
        if method_name != "action_masks":
            raise InputError(f"method must be action_masks in the vector engine, got {method_name!r}")
        masks = self.envs.action_masks()
        return [masks[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Whether infos are as the wrapper makes them: those of ``Monitor`` are, though no environment is wrapped."""
        return [wrapper_class is Monitor] * self._count(indices)

    def _count(self, indices: Any) -> int:
        rows: Iterable[int] = self._get_indices(indices)
        return len(list(rows))


def engine_of(env_id: str) -> Callable[..., VectorDrivingEnv] | None:
    """What makes environments of an id in the engine; None for an id without one."""
    own = preset_of(env_id)
    if own is not None and has_engine(own):
        return engine_class(own)
    kind = None if env_id in IDS else world_kind(env_id)
    return None if kind is None or kind.support is None else partial(WrappedVectorEnv, env_id)


@cache
def _advise_one_thread(threads: int) -> None:
    """Log, once, that one thread of torch is better for networks as small as those of policies."""
    LOGGER.warning(
        "lanebound: torch computes on %d threads. Call torch.set_num_threads(1): the networks of policies are so small "
        "that more threads mostly wait, and beside other busy processes learning takes many times as long.",
        threads,
    )
