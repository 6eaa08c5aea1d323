"""Replay of recorded measurements through the same positioning and monitoring as simulated ones, with assessment."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

__all__ = ["write_summary"]


def write_summary(path: Path, summary: dict[str, Any]) -> Path:
    """Write statistics of a replay as JSON, without infinity and NaN; its folder is made. Returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return path
