"""Work that can be sent to other processes."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["squared"]


def squared(name: str) -> dict[str, Any]:
    """The square of a number by its name, on how many threads, and something that JSON does not take."""
    return {"squared": int(name) ** 2, "threads": os.environ.get("OMP_NUM_THREADS"), "bad": float("nan")}
