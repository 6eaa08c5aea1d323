"""Declarations of worlds: the class of each world, and how the vector engine drives it.

:func:`register_world` adds one from outside. A subclass of :class:`~lanebound.envs.worlds.base.World` with a network
and the seats of an episode runs in single environments and in the engine. A world of highway-env needs a
:class:`Support`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import require_registered

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.envs.batch.plans import Plans
    from lanebound.integrity.core.records import Records

__all__ = [
    "Entrance",
    "Refusal",
    "Starter",
    "Support",
    "WorldKind",
    "register_world",
    "withdraw_world",
    "world_kind",
    "world_kinds",
]

Starter = Callable[[np.random.Generator, "Records", "Records", np.ndarray[Any, Any]], int]
"""Fills the vehicles of one environment, (V,) CAR and DRIVER, and its speed profiles (K, S) from a generator; returns
the number of vehicles."""
Entrance = Callable[[np.random.Generator, "Records", "Records", int], int]
"""Puts a vehicle that enters behind the others of an environment, (V,) CAR and DRIVER, of which there are so many;
returns the number after that."""
Refusal = tuple[str, str, object]
"""An option that the engine does not have: its name, the allowed values, and the value given."""


def _no_plans(world: AbstractEnv, table: LaneTable) -> Plans:
    from lanebound.envs.batch.plans import Plans

    return Plans(world.road.network, table)


@dataclass(frozen=True)
class Support:
    """Data with which the vector engine simulates a world as highway-env does.

    Attributes
    ----------
    traffic : kind of compiled traffic, ``course``, ``city``, ``network``, ``crossing`` or ``motorway``, or
        ``package.module:kernel`` of one's own
    vehicles : largest number of vehicles at the start of an episode, the ego included
    starter : the start of episodes; it uses only the configuration and the lanes of the world
    ends : fields of the record WORLD: end rules and the reward of the world
    profile_steps : length of the speed profiles of other vehicles, 1 for none
    profiles : number of these profiles: the k-th of the others has the k-th, those beyond the last
    refusals : options of the world that the engine does not have
    drivers : class of the other vehicles, whose methods and constants must be those of the kind of traffic
    plans : routes that the vehicles may have
    effort : what the world's own reward takes of actions (N, ...) -> (N,); None for nothing
    before : simulation steps of the traffic before an episode
    entrance : vehicles that enter during an episode, between policy steps; None for none
    """

    traffic: str
    vehicles: Callable[[AbstractEnv], int]
    starter: Callable[[AbstractEnv, LaneTable], Starter]
    ends: Callable[[AbstractEnv], Mapping[str, float]]
    profile_steps: Callable[[AbstractEnv], int] = field(default=lambda world: 1)
    profiles: Callable[[AbstractEnv], int] = field(default=lambda world: 1)
    refusals: Callable[[AbstractEnv], list[Refusal]] = field(default=lambda world: [])
    drivers: type | None = None
    plans: Callable[[AbstractEnv, LaneTable], Plans] = field(default=_no_plans)
    effort: Callable[[AbstractEnv, np.ndarray[Any, Any]], np.ndarray[Any, Any]] | None = None
    before: Callable[[AbstractEnv], int] = field(default=lambda world: 0)
    entrance: Callable[[AbstractEnv, LaneTable], Entrance] | None = None


@dataclass(frozen=True)
class WorldKind:
    """A world.

    Attributes
    ----------
    name : value of ``base`` in a configuration: an id of highway-env, or the name of a class
    world : its class; None for the class of that id of highway-env
    support : returns how the engine drives it; None without engine support
    newcomers : slots for vehicles that enter after the start of an episode
    continuous : id of the variant of highway-env for continuous actions, "" for the same id
    arrived : whether the ego of the world is at its goal, where the episode ends; None for a world without a goal
    """

    name: str
    world: type[AbstractEnv] | None
    support: Callable[[], Support] | None = None
    newcomers: int = 0
    continuous: str = ""
    arrived: Callable[[AbstractEnv], bool] | None = None


_kinds: dict[str, WorldKind] = {}


def register_world(kind: WorldKind) -> None:
    """Add a world, which ``base`` of a configuration then selects.

    Raises
    ------
    InputError
        The name is taken, the world is no world of highway-env, or its support is no function.
    """
    if kind.name in _kinds:
        raise InputError(f"name of a world must not be taken, got {kind.name!r}: choose another")
    if kind.world is not None and not (isinstance(kind.world, type) and issubclass(kind.world, AbstractEnv)):
        raise InputError(f"world of {kind.name!r} must be a subclass of World, got {kind.world!r}: pass its class")
    if kind.support is not None and not callable(kind.support):
        raise InputError(f"support of {kind.name!r} must be a function, got {kind.support!r}: pass MyWorld.support")
    _kinds[kind.name] = kind


def withdraw_world(name: str) -> None:
    """Remove a registered world.

    Raises
    ------
    InputError
        There is none of this name.
    """
    require_registered("world", name, _kinds)
    del _kinds[name]


def world_kind(name: str) -> WorldKind | None:
    """The registered world with a name, None for other ids of highway-env."""
    return _kinds.get(name)


def world_kinds() -> tuple[WorldKind, ...]:
    """All registered worlds."""
    return tuple(_kinds.values())
