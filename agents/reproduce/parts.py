"""Where a study keeps what is done: one file for each batch of drives, so that an interrupted run can go on."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["drives_kept", "part_path"]

NAME = re.compile(r"^seeds-(\d+)-(\d+)\.json$")


def part_path(out: Path, seeds: list[int]) -> Path:
    """The file of a batch of consecutive seeds."""
    return out / "parts" / f"seeds-{seeds[0]}-{seeds[-1]}.json"


def drives_kept(out: Path) -> int:
    """Number of drives whose results lie in ``out``."""
    found = (NAME.match(path.name) for path in (out / "parts").glob("*.json"))
    return sum(int(name[2]) - int(name[1]) + 1 for name in found if name)
