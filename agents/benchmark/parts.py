"""How much of a benchmark is finished, told without loading what drives it: an interrupted command answers at once."""

from __future__ import annotations

from pathlib import Path

__all__ = ["EPISODES", "episodes_kept"]

EPISODES = "episodes"


def episodes_kept(folder: Path) -> int:
    """Number of finished episodes in a folder of results."""
    return sum(1 for _ in (folder / EPISODES).glob("*/*/*/*.parquet"))
