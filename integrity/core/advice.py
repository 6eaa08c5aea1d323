"""Enums of outcomes: the value of a member is a sentence for the user, its code is a small integer."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError

__all__ = ["Advice", "OpenAdvice"]


class _Coded:
    """What tables of members with a code have in common."""

    @classmethod
    def from_code(cls, code: int) -> Self:
        """The member with this code, or InputError."""
        members: list[Any] = list(cls)  # type: ignore[call-overload]
        for member in members:
            if member.code == int(code):
                return member  # type: ignore[no-any-return]
        known = ", ".join(f"{m.code} {m.name}" for m in members)
        raise InputError(f"{cls.__name__} code must be one of ({known}), got {code}: use a code of the table")

    @classmethod
    def count(cls, codes: ArrayLike) -> dict[str, int]:
        """How often each member occurs in an array of codes, by lower-case name."""
        found: NDArray[Any] = np.asarray(codes)
        return {member.name.lower(): int((found == member.code).sum()) for member in cls}  # type: ignore[attr-defined]


class Advice(_Coded, Enum):
    """Base of outcomes: members are declared ``NAME = code, "advice to print"``.

    ``member.value`` is the advice; ``member.code`` is the integer in arrays and observations.
    """

    code: int

    def __new__(cls, code: int, advice: str) -> Self:
        member = object.__new__(cls)
        member._value_ = advice
        member.code = code
        return member


T = TypeVar("T", bound="OpenAdvice")


class _Table(type):
    """Lets a class be used as the table of its members, as an Enum is."""

    members: dict[str, Any]

    def __iter__(cls) -> Iterator[Any]:
        return iter(list(cls.members.values()))

    def __len__(cls) -> int:
        return len(cls.members)

    def __call__(cls, code: int) -> Any:
        return cls.from_code(code)  # type: ignore[attr-defined]

    def __getitem__(cls, name: str) -> Any:
        return cls.members[name]


class OpenAdvice(_Coded, metaclass=_Table):
    """As :class:`Advice`, of a table that may grow: members are added by :meth:`register`.

    A call with a code gives the member, as that of an enum does.
    """

    members: ClassVar[dict[str, Any]]
    name: str
    code: int
    value: str

    def __init_subclass__(cls) -> None:
        cls.members = {}

    @classmethod
    def register(cls, name: str, advice: str) -> Self:
        """Add a member, with the next code; the same member when name and advice are known already.

        Raises
        ------
        InputError
            The name is no identifier, or known with another advice.
        """
        if not name.isidentifier():
            raise InputError(f"name of {cls.__name__} must be an identifier, got {name!r}: write it as clock_jump")
        name = name.upper()
        known = cls.members.get(name)
        if known is not None:
            if known.value != advice:
                raise InputError(
                    f"advice of {cls.__name__} {name} must be {known.value!r}, got {advice!r}: choose another name"
                )
            return known  # type: ignore[no-any-return]
        member = object.__new__(cls)
        member.name, member.code, member.value = name, len(cls.members), advice
        cls.members[name] = member
        setattr(cls, name, member)
        return member

    @classmethod
    def withdraw(cls, name: str) -> None:
        """Take back the member that was registered last, or InputError."""
        if not cls.members or name.upper() != list(cls.members)[-1]:
            raise InputError(f"name must be that of the last {cls.__name__}, got {name!r}: withdraw in reverse order")
        del cls.members[name.upper()]
        delattr(cls, name.upper())

    def __repr__(self) -> str:
        return f"{type(self).__name__}.{self.name}"

    def __reduce__(self) -> tuple[Any, ...]:
        return _member, (type(self), self.name)


def _member(cls: type[T], name: str) -> T:
    """A member by its name, as pickles need it."""
    return cls.members[name]  # type: ignore[no-any-return]
