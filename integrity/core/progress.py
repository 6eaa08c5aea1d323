"""Callbacks for the progress of long work: ``progress(done, of)`` is called with two numbers of units."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress", "silent"]

Progress = Callable[[int, int], None]


def silent(done: int, of: int) -> None:
    """Ignore the progress."""
