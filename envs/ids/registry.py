"""The ids that Gymnasium knows: ours, and those that plug-ins add."""

from __future__ import annotations

from typing import Any

import gymnasium

from lanebound.envs.config import EnvConfig
from lanebound.envs.ids.guidance import Guidance
from lanebound.envs.ids.highway import Highway, Intersection, Merge, Racetrack, Roundabout
from lanebound.envs.ids.platoon import Platoon
from lanebound.envs.ids.preset import Preset, has_engine, id_of
from lanebound.envs.ids.priced import PRICED
from lanebound.envs.ids.streets import CarFollowing, CityStreets, LaneKeeping, UrbanCanyon
from lanebound.envs.ids.tolling import Tolling
from lanebound.envs.ids.work_zone import WorkZone
from lanebound.envs.world import world_defaults
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import require_registered

__all__ = [
    "CLASSES",
    "IDS",
    "MORE",
    "MORE_IDS",
    "enter",
    "every_id",
    "every_preset",
    "preset_of",
    "presets",
    "register_id",
    "withdraw_id",
]

CLASSES: tuple[type[Preset], ...] = (
    LaneKeeping,
    CarFollowing,
    Highway,
    Merge,
    Roundabout,
    Intersection,
    Racetrack,
    UrbanCanyon,
)
MORE: tuple[type[Preset], ...] = (*PRICED, WorkZone, Guidance, Tolling, CityStreets, Platoon)
"""Classes of ids of ours that suites, pages of results and shipped policies do not drive."""

IDS: dict[str, dict[str, Any]] = {}
"""The presets of all ids that are registered."""
MORE_IDS: dict[str, dict[str, Any]] = {}
"""The presets of ``MORE``."""
_registered: list[type[Preset]] = []


def presets() -> tuple[type[Preset], ...]:
    """The classes of all ids; those from outside come last."""
    return (*CLASSES, *_registered)


def every_preset() -> tuple[type[Preset], ...]:
    """The classes of all ids, and of those that no sweep drives."""
    return (*presets(), *MORE)


def every_id() -> dict[str, dict[str, Any]]:
    """The presets of all these."""
    return IDS | MORE_IDS


def preset_of(env_id: str) -> type[Preset] | None:
    """The class of an id of ours; None for another id, such as one of highway-env."""
    return next((kind for kind in every_preset() if id_of(kind) == env_id), None)


def register_id(kind: type[Preset]) -> str:
    """Register an id from outside, for single environments and, if its world has engine support, for the engine.

    Raises
    ------
    InputError
        The id is taken.
    ConfigError
        The preset names no known world, or has another mistake.
    """
    if id_of(kind) in every_id():
        raise InputError(f"id must not be taken, got {id_of(kind)}: set ID in the class")
    world_defaults(EnvConfig.build(kind.PRESET).base)
    _registered.append(kind)
    enter(kind)
    return id_of(kind)


def withdraw_id(name: str) -> None:
    """Remove a registered id.

    Raises
    ------
    InputError
        There is none of this name.
    """
    require_registered("id", name, [id_of(kind) for kind in _registered])
    _registered[:] = [kind for kind in _registered if id_of(kind) != name]
    del IDS[name], gymnasium.registry[name]


def enter(kind: type[Preset]) -> None:
    """Register an id with Gymnasium; doing so twice changes nothing."""
    (MORE_IDS if kind in MORE else IDS)[id_of(kind)] = dict(kind.PRESET)
    if id_of(kind) not in gymnasium.registry:
        engine = f"lanebound.envs.vector.env:Vector{kind.__name__}" if has_engine(kind) else None
        entry = f"{kind.__module__}:{kind.__qualname__}" if kind in (*CLASSES, *MORE) else kind
        gymnasium.register(id_of(kind), entry, vector_entry_point=engine, kwargs={"config": {}})
