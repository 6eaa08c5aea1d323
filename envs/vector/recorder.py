"""Records what the other vehicles of an engine broadcast, with its errors, in traffic without an ego."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.batch.ego_kernel import IDLE
from lanebound.envs.batch.surrogate_kernel import NOTE, note
from lanebound.envs.core import DrivingEnv
from lanebound.envs.vector.engine import Engine, Rows, Stage
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records

__all__ = ["Recorder"]


class Recorder(Engine):
    """An engine that notes the errors of what its vehicles broadcast.

    Each ego is put ``away_m`` beyond the end of a road, on none of the lanes, where it concerns no other vehicle.

    Parameters
    ----------
    single, count : see :class:`.Engine`
    away_m : from the end of that road
    """

    def __init__(self, single: DrivingEnv, count: int, away_m: float) -> None:
        super().__init__(single, count)
        self._away = self._beyond(away_m)
        self._notes: Records = np.zeros((count, self.episodes.perception.capacity), NOTE)
        self._kept: list[Records] = []

    def record(self, seeds: list[int], epochs: int) -> Records:
        """Notes (N, 1 + epochs, C) NOTE of episodes with these seeds, at their start and after each epoch."""
        self._notes[:], self._kept = np.zeros((), NOTE), []
        self.reset(self._everyone, list(seeds))
        self._note()
        meta = self.codes.size > 0
        idle = np.full(self.count, self.codes.tolist().index(IDLE)) if meta else np.zeros((self.count, 2))
        while len(self._kept) <= epochs:
            self.step(idle)
        return np.stack(self._kept[: 1 + epochs], axis=1)

    def _line_up(self, stage: Stage, rows: Rows, *rest: Any) -> None:
        super()._line_up(stage, rows, *rest)
        cars = stage.episodes.cars
        cars["x"][rows, 0], cars["y"][rows, 0], cars["heading"][rows, 0], cars["lane"][rows, 0] = self._away
        cars["speed"][rows, 0] = 0.0

    def _end_epoch(self, rows: Rows) -> None:
        super()._end_epoch(rows)
        self._note()

    def _note(self) -> None:
        e = self.episodes
        note(self._everyone, e.cars, e.ego, e.perception.pictures, self._notes)
        self._kept.append(self._notes.copy())

    def _beyond(self, away_m: float) -> tuple[float, float, float, int]:
        """Place x, y, heading and lane of an ego beyond the end of a road, of which its lane is the nearest."""
        network, far = self.single.world.road.network, list[tuple[float, float, float, int]]()
        for row, index in enumerate(self.episodes.table.index):
            lane = network.get_lane(index)
            position, heading = lane.position(lane.length + away_m, 0.0), float(lane.heading_at(lane.length))
            if lane.distance(position) > 0.5 * away_m:  # not along a circle
                far.append((float(position[0]), float(position[1]), heading, row))
                if network.get_closest_lane_index(position, heading) == index:
                    return far[-1]
        if not far:
            raise ConfigError("base must be a world with a straight road, got none")
        return far[0]
