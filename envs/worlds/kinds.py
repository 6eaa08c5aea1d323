"""Registry of the worlds available in configurations, with their classes and their support by the vector engine.

:func:`register_world` adds a world of the user. A subclass of :class:`~lanebound.envs.worlds.base.World` with a network
and initial states is sufficient for the single environment and for the engine. A world of highway-env needs a separate
:class:`Support`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv

from lanebound.integrity.core.errors import InputError

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.envs.batch.records_kernel import Cars
    from lanebound.envs.vector.drivers_kernel import Drivers

__all__ = [
    "Refusal",
    "Starter",
    "Support",
    "WorldKind",
    "register_world",
    "withdraw_world",
    "world_kind",
    "world_kinds",
]

Starter = Callable[[np.random.Generator, "Cars", "Drivers", np.ndarray[Any, Any]], int]
"""Fills the vehicles of one environment and its profile of speeds (S,) from a generator; returns their number."""
Refusal = tuple[str, str, object]
"""An option that the engine does not take: its name, what is allowed, and the value given."""


@dataclass(frozen=True)
class Support:
    """Data with which the vector engine simulates a world as highway-env does.

    Attributes
    ----------
    traffic : kind of compiled traffic, ``course``, ``city`` or ``motorway``, or ``package.module:kernel`` of the user
    vehicles : largest number of vehicles in an episode, including the ego
    starter : start of episodes; uses only the configuration and the lanes of the world
    ends : fields of the record WORLD: end conditions of an episode, and reward of the world
    profile_steps : length of the speed profile of vehicles, 1 for none
    refusals : options of the world that the engine does not support
    drivers : class of the other vehicles, whose parameters are compiled in and must not be changed
    """

    traffic: str
    vehicles: Callable[[AbstractEnv], int]
    starter: Callable[[AbstractEnv, LaneTable], Starter]
    ends: Callable[[AbstractEnv], Mapping[str, float]]
    profile_steps: Callable[[AbstractEnv], int] = field(default=lambda world: 1)
    refusals: Callable[[AbstractEnv], list[Refusal]] = field(default=lambda world: [])
    drivers: type | None = None


@dataclass(frozen=True)
class WorldKind:
    """A world.

    Attributes
    ----------
    name : value of ``base`` in configurations: an id of highway-env, or the name of a class of this package
    world : class of the world; None for the class of the highway-env id
    support : creates the support by the vector engine, None without support
    """

    name: str
    world: type[AbstractEnv] | None
    support: Callable[[], Support] | None = None


_kinds: dict[str, WorldKind] = {}


def register_world(kind: WorldKind) -> None:
    """Register a world under the name used as ``base`` in configurations.

    Raises
    ------
    InputError
        The name is in use.
    """
    if kind.name in _kinds:
        raise InputError(f"name of a world must not be taken, got {kind.name!r}: choose another")
    _kinds[kind.name] = kind


def withdraw_world(name: str) -> None:
    """Remove a registered world."""
    del _kinds[name]


def world_kind(name: str) -> WorldKind | None:
    """The registered world with a name, None for other ids of highway-env."""
    return _kinds.get(name)


def world_kinds() -> tuple[WorldKind, ...]:
    """All registered worlds."""
    return tuple(_kinds.values())
