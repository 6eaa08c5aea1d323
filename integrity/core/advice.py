"""Enums of outcomes: the value of a member is a sentence for the user, its code is a small integer."""

from __future__ import annotations

from enum import Enum
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError

__all__ = ["Advice"]


class Advice(Enum):
    """Base class of outcomes; members are declared as ``NAME = code, "advice to print"``.

    ``member.value`` is the advice; ``member.code`` is the integer in arrays and observations.
    """

    code: int

    def __new__(cls, code: int, advice: str) -> Self:
        member = object.__new__(cls)
        member._value_ = advice
        member.code = code
        return member

    @classmethod
    def from_code(cls, code: int) -> Self:
        """The member with a code.

        Raises
        ------
        InputError
            No member has the code.
        """
        for member in cls:
            if member.code == int(code):
                return member
        known = ", ".join(f"{m.code} {m.name}" for m in cls)
        raise InputError(f"{cls.__name__} code must be one of ({known}), got {code}")

    @classmethod
    def count(cls, codes: ArrayLike) -> dict[str, int]:
        """Number of occurrences of each member in an array of codes, by lower-case name."""
        found: NDArray[Any] = np.asarray(codes)
        return {member.name.lower(): int((found == member.code).sum()) for member in cls}
