"""Plain data for JSON, which has no infinity and no NaN, and counts in words."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

__all__ = ["counted", "finite_or_none", "to_json_text"]


def counted(count: int, what: str) -> str:
    """A count with its noun, singular or plural.

    >>> counted(1, "process"), counted(2, "process"), counted(0, "episode")
    ('1 process', '2 processes', '0 episodes')
    """
    plural = f"{what}es" if what.endswith("s") else f"{what}s"
    return f"{count} {what if count == 1 else plural}"


def finite_or_none(data: Any) -> Any:
    """A copy of nested plain data with None in place of infinite and NaN floats."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: finite_or_none(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite_or_none(value) for value in data]
    return data


def to_json_text(data: Any, indent: int = 2) -> str:
    """Standard JSON text: ``null`` for infinity and NaN, letters outside ASCII unescaped."""
    return json.dumps(finite_or_none(data), indent=indent, ensure_ascii=False, allow_nan=False)
