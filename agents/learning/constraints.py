"""The limits that a policy learns under: of an episode's whole cost, and of groups of its causes.

Everything has an axis of K limits: the whole cost first (``cost_limit``), then the groups of ``cost_limits``. The whole
is always among them, because a crash is in no group: under limits of groups alone an early crash would keep them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from lanebound.agents.learning.multiplier import Multiplier, MultiplierConfig
from lanebound.envs.config import EnvConfig
from lanebound.envs.journeys.config import JourneyConfig
from lanebound.integrity.core.errors import InputError

__all__ = ["Constraints", "GroupLimit", "costs_in", "group_limits", "limit_of"]


class GroupLimit(NamedTuple):
    """A limit of an episode's sum of ``weights @ info["costs"]``.

    Attributes
    ----------
    group : name among :data:`~lanebound.envs.costs.GROUPS`
    limit : positive
    weights : (C,) of the causes, in the order of :data:`~lanebound.envs.costs.CAUSES`
    """

    group: str
    limit: float
    weights: NDArray[np.float64]


def group_limits(config: EnvConfig) -> tuple[GroupLimit, ...]:
    """The limits of ``cost_limits``, with the weights of the configuration."""
    return tuple(
        GroupLimit(group, limit, config.cost.weights_of(group)) for group, limit in config.cost_limits.given.items()
    )


def limit_of(given: float | None, env: Any, settings: Mapping[str, Any]) -> float:
    """The limit of the cost of a learner: the one given, or that of its environment, or of those of a VecEnv.

    settings : of the learner; in one that is loaded (``_init_setup_model`` false) the file replaces what is returned

    Raises
    ------
    InputError
        An environment that has no such limit.
    """
    if given is not None:
        return given
    if env is None or not settings.get("_init_setup_model", True):
        return 1.0
    try:
        config = env.get_attr("config")[0] if isinstance(env, VecEnv) else env.get_wrapper_attr("config")
    except AttributeError:
        config = None
    if not isinstance(config, EnvConfig | JourneyConfig):
        raise InputError(f"cost_limit must be given for {env}, which has no limit of its own: pass cost_limit=25.0")
    return config.cost_limit


def costs_in(infos: Sequence[Mapping[str, Any]], groups: Sequence[GroupLimit] = ()) -> NDArray[np.float32]:
    """What the step cost in each of N environments: ``info["cost"]``, and the costs of groups, (N, K).

    Raises
    ------
    InputError
        An ``info`` without "cost", or where there are groups, without "costs".
    """
    for key in ("cost", "costs") if groups else ("cost",):
        if any(key not in info for info in infos):
            raise InputError(
                f"info must hold '{key}' at every step, got none: use an environment of lanebound, and name {key!r} in "
                "the keys of EngineVecEnv"
            )
    found = np.empty((len(infos), 1 + len(groups)), dtype=np.float32)
    found[:, 0] = [info["cost"] for info in infos]
    if groups:
        found[:, 1:] = np.array([info["costs"] for info in infos]) @ np.array([one.weights for one in groups]).T
    return found


class Constraints:
    """K limits of an episode's costs, each with a multiplier of its own under the same gains.

    Parameters
    ----------
    cost_limit : of the whole cost
    groups : limits of groups, in addition
    config : gains of all multipliers

    Attributes
    ----------
    window : episodes that mean costs are of
    suffixes : names of the limits in logs: nothing for the whole, ``_lane`` and so on

    Raises
    ------
    InputError
        A limit that is not positive.
    """

    def __init__(self, cost_limit: float, groups: Sequence[GroupLimit], config: MultiplierConfig) -> None:
        self.groups, self.window = tuple(groups), config.window
        self.suffixes = ("", *(f"_{one.group}" for one in self.groups))
        self.multipliers = [Multiplier(cost_limit, config)]
        self.multipliers += [Multiplier(one.limit, config, f"cost_limits.{one.group}") for one in self.groups]

    @property
    def limits(self) -> list[float]:
        """The limits, (K,)."""
        return [one.limit for one in self.multipliers]

    @property
    def values(self) -> list[float]:
        """The multipliers, (K,)."""
        return [one.value for one in self.multipliers]

    def update(self, means: Sequence[float], steps: float = math.inf) -> None:
        """Move each multiplier by the mean cost (K,) of the latest episodes, after ``steps`` decisions."""
        for one, cost in zip(self.multipliers, means, strict=True):
            one.update(cost, steps)

    def named(self, name: str, values: Sequence[float]) -> dict[str, float]:
        """Values (K,) by their names in logs: ``cost/NAME`` and the suffix of the limit."""
        return {f"cost/{name}{suffix}": float(value) for suffix, value in zip(self.suffixes, values, strict=True)}
