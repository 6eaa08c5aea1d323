"""The worlds that configurations may name, each declared once: its class, and how the vector engine drives it.

:func:`register_world` adds one from outside. A subclass of :class:`~lanebound.envs.worlds.base.World` that makes a
network and draws the seats of an episode needs nothing else for the single environment and the engine. A world of
highway-env has a :class:`Support` of its own.
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
    """How the vector engine drives a world as highway-env does.

    Attributes
    ----------
    traffic : kind of compiled traffic, ``course``, ``city`` or ``motorway``, or ``package.module:kernel`` of one's own
    vehicles : how many vehicles an episode may have, the ego included
    starter : the start of episodes; the world is asked for its configuration and lanes alone
    ends : fields of the record WORLD: what ends an episode, and the world's own reward
    profile_steps : length of the profile of speeds that vehicles drive, 1 for none
    refusals : options of the world that the engine does not take
    drivers : class of the others, with the parameters that are compiled in and must not have been rewritten
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
    name : what ``base`` of a configuration names: an id of highway-env, or the name of a class of our own
    world : its class; None for the class behind the id of highway-env
    support : makes how the engine drives it, None where it does not
    """

    name: str
    world: type[AbstractEnv] | None
    support: Callable[[], Support] | None = None


_kinds: dict[str, WorldKind] = {}


def register_world(kind: WorldKind) -> None:
    """Add a world that ``base`` of a configuration may name.

    Raises
    ------
    InputError
        There is another one of that name.
    """
    if kind.name in _kinds:
        raise InputError(f"name of a world must not be taken, got {kind.name!r}: choose another")
    _kinds[kind.name] = kind


def withdraw_world(name: str) -> None:
    """Take back a world that was registered."""
    del _kinds[name]


def world_kind(name: str) -> WorldKind | None:
    """The world of a name, None for one that is only an id of highway-env."""
    return _kinds.get(name)


def world_kinds() -> tuple[WorldKind, ...]:
    """All worlds that are declared."""
    return tuple(_kinds.values())
