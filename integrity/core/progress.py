"""How far long work is: whoever wants to know is told how much is done, and of how much."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress", "silent"]

Progress = Callable[[int, int], None]


def silent(done: int, of: int) -> None:
    """Nobody wants to know."""
