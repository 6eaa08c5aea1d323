"""Records what the other vehicles of an engine broadcast, with its errors, in traffic without an ego."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.batch.surrogate_kernel import NOTE, note
from lanebound.envs.core import DrivingEnv
from lanebound.envs.vector.engine import Engine, Rows, Stage
from lanebound.integrity.core.records import Records

__all__ = ["Recorder"]


class Recorder(Engine):
    """An engine that notes what its vehicles say.

    Parameters
    ----------
    single, count : see :class:`.Engine`
    away_m : how far behind its place and beside the road each ego is put
    """

    def __init__(self, single: DrivingEnv, count: int, away_m: float) -> None:
        super().__init__(single, count)
        self._away_m = away_m
        self._notes: list[Records] = []

    def record(self, seeds: list[int], epochs: int) -> Records:
        """Notes (N, 1 + epochs, C) NOTE of episodes with these seeds, at their start and after each epoch."""
        self._notes = []
        self.reset(self._everyone, list(seeds))
        self._note()
        idle = np.zeros(self.count, dtype=np.int64) if self.codes.size else np.zeros((self.count, 2))
        while len(self._notes) <= epochs:
            self.step(idle)
        return np.stack(self._notes[: 1 + epochs], axis=1)

    def _line_up(self, stage: Stage, rows: Rows, *rest: Any) -> None:
        super()._line_up(stage, rows, *rest)
        for name in ("x", "y"):
            stage.episodes.cars[name][rows, 0] -= self._away_m

    def _end_epoch(self, rows: Rows) -> None:
        super()._end_epoch(rows)
        self._note()

    def _note(self) -> None:
        e = self.episodes
        notes = np.zeros((self.count, e.perception.capacity), NOTE)
        note(self._everyone, e.cars, e.ego, e.perception.pictures, notes)
        self._notes.append(notes)
