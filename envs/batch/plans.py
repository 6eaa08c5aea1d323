"""The routes that a world plans for its vehicles, as the records of kernels, and the paths of the ego along its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.batch.lanes import LaneTable
from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.next_lane_kernel import STEP
from lanebound.envs.batch.route_map import Routes, Step
from lanebound.envs.records import LaneIndex
from lanebound.integrity.core.records import Records

__all__ = ["Plans"]

END = (NONE, NONE)


class Plans:
    """All routes that ``ControlledVehicle.plan_route_to`` of highway-env may give the vehicles of a world.

    Parameters
    ----------
    network, table : the road network, and its lanes
    own : lane and destination of the routes of the ego
    goals : destinations of the others, from any lane

    Attributes
    ----------
    steps : (Q,) STEP, route after route; row 0 is no route
    own : rows at the beginning that belong to routes of the ego
    """

    def __init__(
        self,
        network: RoadNetwork,
        table: LaneTable,
        own: Iterable[tuple[LaneIndex, str]] = (),
        goals: Iterable[str] = (),
    ) -> None:
        self._network, self._table = network, table
        self._rows, self._at = [END], dict[tuple[int, str], int]()
        for index, goal in own:
            self._add(index, goal)
        self.own = len(self._rows)
        for goal in goals:
            for index in table.index:
                self._add(index, goal)
        self.steps: Records = np.array(self._rows, STEP)

    def at(self, lane: int, goal: str) -> int:
        """Row of the first step of the route from a lane to a destination."""
        return self._at[lane, goal]

    def paths(self, routes: Routes) -> NDArray[np.int64]:
        """Row of the path from each lane for what may be left of the ego's routes, (Q, L)."""
        return np.array([routes.rows(self._left(at)) for at in range(self.own)])

    def _add(self, index: LaneIndex, goal: str) -> None:
        key = self._table.row[index], goal
        if key in self._at:
            return
        try:
            nodes: Sequence[str] = self._network.shortest_path(index[1], goal)
        except KeyError:  # highway-env searches on at a node where no road begins
            nodes = []
        roads = [self._table.row[start, end, 0] for start, end in pairwise(nodes)]
        self._at[key] = len(self._rows)
        self._rows += [(self._road(key[0]), index[2]), *((road, NONE) for road in roads), END]

    def _road(self, lane: int) -> int:
        return int(self._table.lanes.table["road"][lane])

    def _left(self, at: int) -> tuple[Step, ...]:
        """The steps from a row on, as highway-env has them."""
        out: list[Any] = []
        while self._rows[at] != END:
            road, side = self._rows[at]
            out.append((*self._table.index[road][:2], None if side == NONE else side))
            at += 1
        return tuple(out)
