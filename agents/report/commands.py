"""The commands that drive an episode again."""

from __future__ import annotations

import shlex
from pathlib import Path

from lanebound.agents.benchmark.outcome import Outcome

__all__ = ["replay_command"]

UNKNOWN = "DIR"  # results that were made up lie in no folder


def replay_command(folder: Path | None, outcome: Outcome, video: bool = True) -> str:
    """What to type, where the benchmark was started, to drive an episode again and film it."""
    words = ["lanebound", "replay-episode", UNKNOWN if folder is None else str(folder), outcome.id]
    return shlex.join([*words, "--video", "replay.mp4"] if video else words)
