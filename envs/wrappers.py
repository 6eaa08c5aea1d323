"""Wrappers around any environment of lanebound: costs in the form that a learner wants, and an episode's statistics.

What Gymnasium has already is not repeated here: ``TimeLimit``, ``RecordEpisodeStatistics``, ``RecordVideo`` (it needs
moviepy), ``NormalizeReward`` and the like work as they are. To flatten or to stack, set ``observation.form`` to
``"flat"`` and ``observation.history`` in the configuration, which cost no further copy; Gymnasium's
``FlattenObservation`` gives the same vector as the flat form, and with a history the same entries group by group
instead of moment by moment.

>>> import gymnasium, lanebound.envs
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"})
>>> env = SafetyGymnasium(EpisodeStatistics(env))
>>> observation, info = env.reset(seed=1)
>>> observation, reward, cost, terminated, truncated, info = env.step(env.action_space.sample())

From inside to outside: ``EpisodeStatistics``, Gymnasium's ``Autoreset``, ``SafetyGymnasium``. Another order is refused:
wrappers of this module refuse it in their constructor; wrappers of Gymnasium and stable-baselines3 are found at a step.
``SafetyGymnasiumVector`` is for vector environments.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from types import FrameType
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers import Autoreset
from numpy.typing import NDArray

from lanebound.envs.costs import CAUSES
from lanebound.envs.episode_totals import EPISODE_KEY, EpisodeTotals
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest

__all__ = ["CostIntoReward", "EpisodeStatistics", "SafetyGymnasium", "SafetyGymnasiumVector"]

FIVE_VALUES = ("gymnasium", "stable_baselines3")  # packages whose wrappers and vectors unpack five values of a step
# Of Gymnasium's wrappers these return whatever a step gives.
PASS_ON = {f"{kind}Wrapper.step" for kind in ("", "Action", "Vector", "VectorAction")} | {"OrderEnforcing.step"}

Env = gymnasium.Env[Any, Any]
Wrapper = gymnasium.Wrapper[Any, Any, Any, Any]
FiveTuple = tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]
Started = tuple[Any, dict[str, Any]]


class _OfLanebound(Wrapper):
    """A wrapper that reads the ``info`` of lanebound's environments and refuses other environments and vectors."""

    def __init__(self, env: Env) -> None:
        if isinstance(env, VectorEnv):
            raise InputError(
                f"env must be single, got {env}: wrap each environment in it, or use SafetyGymnasiumVector"
            )
        _refuse_six_values(type(self).__name__, env)
        super().__init__(env)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Started:
        """Begin an episode.

        Raises
        ------
        InputError
            The environment is none of lanebound's: its ``info`` has no costs.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        if "cost" not in info:
            raise InputError(
                f"env must put 'cost' into its info, got {self.env}: wrap an environment of lanebound, "
                "such as gymnasium.make('lanebound/LaneKeeping-v0')"
            )
        return observation, info


class SafetyGymnasium(_OfLanebound, RecordConstructorArgs):
    """Six values of a step, as Safety-Gymnasium's: ``observation, reward, cost, terminated, truncated, info``.

    ``cost`` is ``info["cost"]``, a float. Put it around all other wrappers: those of Gymnasium expect five values.

    Raises
    ------
    InputError
        The environment is a vector or has six values already; at a step, a wrapper or vector of Gymnasium or
        stable-baselines3 is around it.
    """

    def __init__(self, env: Env) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def step(  # type: ignore[override]
        self, action: Any
    ) -> tuple[Any, SupportsFloat, float, bool, bool, dict[str, Any]]:
        """Carry out a command until the next decision."""
        _require_outermost(self, sys._getframe(1))
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, float(info["cost"]), terminated, truncated, info


class SafetyGymnasiumVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """Six values of a step of a vector environment: ``observations, rewards, costs, terminated, truncated, infos``.

    ``costs`` (N,) are those of the step that was made: under ``SameStep`` the cost of the last step of an episode comes
    from ``infos["final_info"]``, as ``infos["cost"]`` is already of the new episode. Put it around all other wrappers.

    >>> import gymnasium, lanebound.envs
    >>> envs = SafetyGymnasiumVector(gymnasium.make_vec("lanebound/LaneKeeping-v0", 2, config={"sky": "open"}))
    >>> observations, infos = envs.reset(seed=1)
    >>> observations, rewards, costs, terminated, truncated, infos = envs.step(envs.action_space.sample())
    >>> costs.shape
    (2,)

    Raises
    ------
    InputError
        The environment is no vector or has six values already; at a step, a vector wrapper of Gymnasium is around it.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env, VectorEnv):
            raise InputError(f"env must be a vector environment, got {env}: use SafetyGymnasium")
        _refuse_six_values(type(self).__name__, env)
        super().__init__(env)

    def step(  # type: ignore[override]
        self, actions: Any
    ) -> tuple[Any, Any, NDArray[np.float64], Any, Any, dict[str, Any]]:
        """Carry out a command in each environment until the next decision."""
        _require_outermost(self, sys._getframe(1))
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        return observations, rewards, _costs(infos), terminated, truncated, infos


def _layers(env: Any) -> Iterator[Any]:
    """The wrappers of an environment, from outside to inside."""
    while isinstance(env, gymnasium.Wrapper | VectorWrapper):
        yield env
        env = env.env


def _refuse_six_values(name: str, env: Any) -> None:
    """Refuse an environment whose steps have six values already, for a wrapper of that name."""
    for layer in _layers(env):
        if isinstance(layer, SafetyGymnasium | SafetyGymnasiumVector):
            inner = type(layer).__name__
            right = f"{inner}(env)" if name == inner else f"{inner}({name}(env))"
            raise InputError(f"{inner} must be around all other wrappers, got {name} around it: write {right}")


def _require_outermost(wrapper: SafetyGymnasium | SafetyGymnasiumVector, caller: FrameType) -> None:
    """Refuse a caller that takes five values of a step.

    It would end with "too many values to unpack", which names neither the wrapper nor the order. Constructors of
    Gymnasium ask nothing of what they wrap, so a step is the first moment that shows who is around.
    """
    while caller.f_code.co_qualname in PASS_ON and caller.f_back is not None:
        caller = caller.f_back
    module = caller.f_globals.get("__name__", "")
    if module.partition(".")[0] not in FIVE_VALUES:
        return
    around, own = _owner(caller), type(wrapper).__name__
    # A function without an owner is internal, such as the loop of a worker process: its module is what users know.
    taker = module if around is None else type(around).__name__
    advice = "leave it out there, as info['cost'] has the cost; SafetyGymnasiumVector(envs) is for Gymnasium's vectors"
    if isinstance(around, gymnasium.Wrapper | VectorWrapper):
        advice = f"write {own}({taker}(env))"
    wrong = f"{own} must be around all other wrappers, got {taker} around it, which takes five values"
    raise InputError(f"{wrong}: {advice}")


def _owner(frame: FrameType | None) -> Any:
    """The object whose method runs in a frame, or called the function that does; None outside of ``FIVE_VALUES``."""
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in FIVE_VALUES:
        if "self" in frame.f_locals:
            return frame.f_locals["self"]
        frame = frame.f_back
    return None


def _costs(infos: dict[str, Any]) -> NDArray[np.float64]:
    """Costs of the steps made, (N,)."""
    if "cost" not in infos:
        raise InputError(f"env must put 'cost' into its infos, got {', '.join(infos)}: wrap a vector of lanebound's")
    costs = np.array(infos["cost"], dtype=np.float64)
    if "final_info" in infos:  # reset in the same step
        ended = infos["_final_info"]
        costs[ended] = infos["final_info"]["cost"][ended]
    return costs


class CostIntoReward(_OfLanebound, RecordConstructorArgs):
    """A reward less the costs, for learners that know no constraints: ``r - sum_i w_i c_i``.

    Parameters
    ----------
    env : an environment of lanebound
    weight : one weight >= 0 of ``info["cost"]`` (which has the weights of the configuration in it already), or a weight
        for each cause by its name in ``info``; causes that are left out count nothing

    Raises
    ------
    InputError
        A negative or infinite weight, or a cause that does not exist, with the nearest one. The environment is a
        vector, or ``SafetyGymnasium`` is inside.
    """

    def __init__(self, env: Env, weight: float | Mapping[str, float] = 1.0) -> None:
        kept = _checked(weight)
        RecordConstructorArgs.__init__(self, weight=kept)
        super().__init__(env)
        self.weights: dict[str, float] = kept if isinstance(kept, dict) else {"cost": kept}

    def step(self, action: Any) -> FiveTuple:
        """Carry out a command; costs in ``info`` stay as they are."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        penalty = sum(weight * info[cause] for cause, weight in self.weights.items())
        return observation, float(reward) - penalty, terminated, truncated, info


def _checked(weight: float | Mapping[str, float]) -> float | dict[str, float]:
    """The weight or weights as plain floats."""
    if not isinstance(weight, Mapping):
        return _checked_one("weight", weight)
    for cause in weight:
        if cause not in CAUSES:
            advice = nearest(cause, CAUSES)
            raise InputError(f"weight must name causes among {', '.join(CAUSES)}, got {cause!r}: {advice}")
    return {cause: _checked_one(f"weight of {cause}", value) for cause, value in weight.items()}


def _checked_one(name: str, value: float) -> float:
    if isinstance(value, bool | str) or not math.isfinite(value) or value < 0.0:
        raise InputError(f"{name} must be a finite number >= 0, got {value!r}: costs are subtracted from the reward")
    return float(value)


class EpisodeStatistics(_OfLanebound, RecordConstructorArgs):
    """Add ``info["episode_integrity"]``, a dict of statistics over an episode, to its last step.

    ``return``, ``length``  sum of rewards, number of steps; ``is_success`` of the last step;
    ``speed_mean_mps``  mean true speed.
    ``cost`` and each ``cost_*``  sums over the episode, to be compared with ``cost_limit``.
    ``availability``  share of steps with the position available; ``mi_steps``, ``hmi_steps``  numbers of steps with
    (hazardously) misleading information.
    ``alert_share``, ``alerts``  share of steps with an alert on, and how often one began.
    ``mode_shares``  share of steps by the name of each :class:`~lanebound.integrity.positioning.modes.Mode`.
    ``err_at_max_m``, ``err_ct_max_m``  largest error without sign.
    ``pl_at_mean_m``, ``pl_ct_mean_m``  mean level over the steps that had one; inf when none had.

    The moment of the reset is not counted. The key is absent before the end, as Gymnasium's ``episode`` is.

    Raises
    ------
    InputError
        ``Autoreset`` is inside: its episodes begin in a step, and statistics would go on from one to the next. The
        environment is a vector, or ``SafetyGymnasium`` is inside.
    """

    def __init__(self, env: Env) -> None:
        if any(isinstance(layer, Autoreset) for layer in _layers(env)):
            raise InputError(
                "EpisodeStatistics must be inside Autoreset, got it around: write Autoreset(EpisodeStatistics(env))"
            )
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._totals = EpisodeTotals(1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Started:
        """Begin an episode, and its statistics."""
        observation, info = super().reset(seed=seed, options=options)
        self._totals.clear()
        return observation, info

    def step(self, action: Any) -> FiveTuple:
        """Carry out a command; the last step of an episode brings the statistics."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._totals.add(float(reward), info)
        if terminated or truncated:
            info[EPISODE_KEY] = self._totals.report(0, info["is_success"])
        return observation, reward, terminated, truncated, info
