"""Work that can be sent to other processes."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from lanebound.agents.checkpointing.runner import Lost, PartStatus
from lanebound.integrity.core.errors import InputError

__all__ = ["HELD", "Squares", "Unpicklable", "leave", "squared"]

HELD = """
import sys, time
from pathlib import Path
from lanebound.agents.checkpointing.folder import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


def squared(name: str, advance: Callable[[float], None]) -> dict[str, Any]:
    """The square of a number by its name, the number of threads, and a value that JSON does not have."""
    advance(0.5)
    return {"squared": int(name) ** 2, "threads": os.environ.get("OMP_NUM_THREADS"), "bad": float("nan")}


def leave(name: str, advance: Callable[[float], None]) -> None:
    """End the process."""
    os._exit(3)


class Unpicklable(Exception):  # noqa: N818 - no fault of ours
    """An exception that cannot be built from its text alone."""

    def __init__(self, text: str, more: int) -> None:
        super().__init__(text)


class Squares:
    """Squares of numbers; what is no number is an order to fail."""

    timeout_s = 1.0

    def do(self, part: Any, status: PartStatus) -> Any:
        match part:
            case "die":
                os._exit(7)
            case "refuse":
                raise InputError("part must be a number, got refuse: give one")
            case "break":
                raise OSError("a file of the work")
            case "odd":
                raise Unpicklable("odd", 3)
            case "hang":
                status.begin()
                while True:
                    pass
        print("printed by the work")
        return part**2

    def lost(self, part: Any, reason: Lost, message: str) -> Any:
        return f"{part}: {reason}, {message}"
