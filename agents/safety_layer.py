"""Hard constraints around an environment: every action is the nearest one that :mod:`.drivers.rules` permits.

>>> import gymnasium, lanebound.envs
>>> env = SafetyLayer(gymnasium.make("lanebound/Highway-v0"), {"level": False})
>>> observation, info = env.reset(seed=1)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample(env.action_masks()))
>>> info["intervened"], info["intervened_by"]
(False, ())
>>> env.close()
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import unwrap_vec_normalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

from lanebound.agents.drivers.rules import Projected, RuleBook, SafetyRules
from lanebound.agents.interventions import Interventions
from lanebound.envs.core import DrivingEnv
from lanebound.envs.world import checked_command
from lanebound.envs.wrappers import FiveTuple, SafetyGymnasium, Started
from lanebound.integrity.core.errors import InputError

__all__ = ["SafetyLayer", "VecSafetyLayer"]

Rules = SafetyRules | Mapping[str, Any] | None
CHANGING = (gymnasium.ObservationWrapper, gymnasium.ActionWrapper, SafetyGymnasium)


class SafetyLayer(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A single environment under hard rules; it reads observations alone.

    ``info`` of a step has ``intervened`` and ``intervened_by``, that of the last step ``episode_interventions``
    (:class:`.interventions.Interventions`). Put it next to the environment: wrappers that change observations or
    actions, and ``SafetyGymnasium``, are around it.

    Parameters
    ----------
    env : an environment of lanebound
    rules : :class:`.rules.SafetyRules`, or plain data over its defaults such as ``{"level": False}``

    Raises
    ------
    InputError
        The environment is no single one of lanebound's, its observations or actions are changed inside, or they lack
        what a rule needs. ConfigError for rules that are refused.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], rules: Rules = None) -> None:
        if isinstance(env, VectorEnv) or not isinstance(env.unwrapped, DrivingEnv):
            raise InputError(f"env must be a single environment of lanebound, got {env}: vectors take VecSafetyLayer")
        _require_around(env)
        self.book = RuleBook(env.unwrapped, _rules_of(rules))
        RecordConstructorArgs.__init__(self, rules=self.book.rules.to_dict())
        super().__init__(env)
        _require_plain(env, env.unwrapped)
        self._seen: Any = None
        self._counts = Interventions(1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Started:
        """Begin an episode."""
        self._seen, info = self.env.reset(seed=seed, options=options)
        self._counts.clear()
        return self._seen, info

    def step(self, action: Any) -> FiveTuple:
        """Carry out the nearest permitted action until the next decision."""
        found = self._permitted(action)
        self._seen, reward, terminated, truncated, info = self.env.step(found.actions)
        self._counts.add(found)
        self._counts.write(info, 0, terminated or truncated)
        return self._seen, reward, terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """The meta-actions that are possible and permitted, (A,) bool; one at least.

        Raises
        ------
        InputError
            Before the first reset, or under continuous actions.
        """
        possible = self.env.get_wrapper_attr("action_masks")()
        return np.asarray(possible & self.book.permitted(self._seen))

    def _permitted(self, action: Any) -> Projected:
        if self._seen is None:
            raise InputError("reset must come before step, got no episode: call reset() first")
        return self.book.project(self._seen, checked_command(self.action_space, action))


class VecSafetyLayer(VecEnvWrapper):
    """N environments of Stable-Baselines3 under hard rules, whatever their processes: it reads observations alone.

    Infos are as those of :class:`SafetyLayer`, with ``shielded`` as of :class:`.learning.shield.VecShielded`. Wrappers
    that change observations, such as ``VecNormalize``, are around it.

    Parameters
    ----------
    venv : ``EngineVecEnv``, ``DummyVecEnv`` or ``SubprocVecEnv`` of environments of one configuration
    rules : as of :class:`SafetyLayer`
    penalty : taken off the reward, times the mean square of what was changed of an action; 1 for another meta-action

    Raises
    ------
    InputError
        As of :class:`SafetyLayer`.
    """

    def __init__(self, venv: VecEnv, rules: Rules = None, penalty: float = 0.0) -> None:
        try:
            config = venv.get_attr("config", [0])[0]
        except AttributeError:
            raise InputError(f"venv must hold environments of lanebound, got {venv}: use EngineVecEnv") from None
        with closing(DrivingEnv(config)) as single:
            self.book = RuleBook(single, _rules_of(rules))
            super().__init__(venv)
            _require_plain(venv, single)
        if unwrap_vec_normalize(venv) is not None:
            raise InputError("VecNormalize must be around VecSafetyLayer, got it inside: exchange the two")
        self._penalty = penalty
        self._seen: Any = None
        self._found: Projected | None = None
        self._counts = Interventions(venv.num_envs)

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        self._seen = self.venv.reset()
        self._counts.clear()
        return self._seen

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hand on the nearest permitted actions."""
        self._found = self.book.project(self._begun("step"), actions)
        self.venv.step_async(self._found.actions)

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """The outcome of the actions."""
        assert self._found is not None
        self._seen, rewards, over, infos = self.venv.step_wait()
        self._counts.add(self._found)
        for row, (info, ended) in enumerate(zip(infos, over.tolist(), strict=True)):
            self._counts.write(info, row, ended)
            info["shielded"] = info["intervened"]
        return self._seen, rewards - np.float32(self._penalty) * self._found.change.astype(np.float32), over, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """The meta-actions that are possible and permitted, (N, A) bool; one at least in each row."""
        seen = self._begun("action_masks")
        possible: NDArray[np.bool_] = np.stack(self.venv.env_method("action_masks"))
        return possible & self.book.permitted(seen)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """As of the environments; ``action_masks`` is that of the layer."""
        if method_name != "action_masks":
            return list(self.venv.env_method(method_name, *method_args, indices=indices, **method_kwargs))
        masks = self.action_masks()
        return [masks[row] for row in self._get_indices(indices)]

    def _begun(self, what: str) -> Any:
        """The last observations; InputError before the first reset."""
        if self._seen is None:
            raise InputError(f"reset must come before {what}, got no episode: call reset() first")
        return self._seen


def _rules_of(given: Rules) -> SafetyRules:
    return given if isinstance(given, SafetyRules) else SafetyRules.load(given or {}, "rules")


def _require_around(env: gymnasium.Env[Any, Any]) -> None:
    """Refuse wrappers inside that may change observations or actions, or that return six values."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, CHANGING):
            name = type(env).__name__
            raise InputError(f"{name} must be around SafetyLayer, got it inside: {name}(SafetyLayer(env))")
        env = env.env


def _require_plain(env: Any, single: DrivingEnv) -> None:
    """Refuse wrappers inside that change observations or actions."""
    for name in ("observation_space", "action_space"):
        if getattr(env, name) != getattr(single, name):
            raise InputError(
                f"{name} must be that of the environment itself, got {getattr(env, name)}: put the wrapper that "
                "changes it around the safety layer"
            )
