"""The fault kinds by name: those of the package, and those that a program registers."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest, require_registered
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_table import FAULT_TABLE

__all__ = ["BUILT_IN", "KindName", "fault_kind", "fault_kinds", "register_fault", "withdraw_fault"]

_kinds: dict[str, FaultKind] = {kind.name: kind for kind in FAULT_TABLE}
BUILT_IN = frozenset(_kinds)
"""Names of the kinds of the package."""


def fault_kinds() -> tuple[FaultKind, ...]:
    """All kinds: those of the package, then registered ones in the order of registration."""
    return tuple(_kinds.values())


def fault_kind(name: str) -> FaultKind:
    """The kind of this name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in _kinds:
        raise InputError(f"fault kind must be one of {_names()}, got {name!r}: {nearest(name, _kinds)}")
    return _kinds[name]


def register_fault(kind: FaultKind) -> FaultKind:
    """Add a kind, which faults, schedules, environments, random faults and the fault campaign take from then on.

    A process registers its kinds itself: call this at the top level of a module. The fault campaign registers them in
    its worker processes.

    Returns
    -------
    The kind.

    Raises
    ------
    InputError
        Another kind has this name.
    """
    if _kinds.setdefault(kind.name, kind) != kind:
        raise InputError(
            f"the name of a fault kind must be new, got {kind.name!r}: choose another name, or call "
            f"withdraw_fault({kind.name!r}) before"
        )
    return kind


def withdraw_fault(name: str) -> None:
    """Remove a registered kind.

    Raises
    ------
    InputError
        There is none of this name, or it is a kind of the package.
    """
    if name in BUILT_IN:
        raise InputError(f"a kind of the package cannot be removed, got {name!r}: remove registered kinds alone")
    require_registered("fault kind", name, [kind for kind in _kinds if kind not in BUILT_IN])
    del _kinds[name]


def _names() -> str:
    *head, last = (f"'{name}'" for name in _kinds)
    return f"{', '.join(head)} or {last}"


def _registered(name: Any) -> Any:
    if not isinstance(name, str) or name not in _kinds:
        raise PydanticCustomError("enum", "Input should be {expected}", {"expected": _names()})
    return name


KindName = Annotated[str, BeforeValidator(_registered)]
"""Name of a registered kind, as a field of a configuration."""
