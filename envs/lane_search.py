"""The lane nearest to a pose of a true vehicle: highway-env's answer, found without a search over its lane objects."""

from __future__ import annotations

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.batch.lanes import LaneTable, lane_table
from lanebound.envs.batch.lanes_kernel import SAMPLED, closest
from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.networks import StreetNetwork

__all__ = ["FastRoadNetwork", "fast_network"]

Array = NDArray[np.float64]


class FastRoadNetwork(RoadNetwork):  # type: ignore[misc]
    """A road network over the lanes of another one, with a faster search for the closest lane.

    Distances are computed in another order of operations. Where two lanes are equally near within rounding, and on
    networks with sampled lanes, the network's own search decides, so that the answer is always the same.
    """

    def __init__(self, network: RoadNetwork, table: LaneTable) -> None:
        super().__init__()
        self.graph, self._network = network.graph, network
        self._table = table
        self._exact = bool((table.lanes.table["kind"] != SAMPLED).all())
        self._nothing = np.zeros(len(table.index))

    def get_closest_lane_index(self, position: Array, heading: float | None = None) -> LaneIndex:
        """Index of the lane closest to a position (2,) and a heading, as highway-env defines it."""
        if self._exact and heading is not None:
            x, y = position.tolist()
            row, clear = closest(self._table.lanes, x, y, float(heading), self._nothing)
            if clear:
                return self._table.index[row]
        found: LaneIndex = self._network.get_closest_lane_index(position, heading)
        return found


def fast_network(network: RoadNetwork, table: LaneTable | None = None) -> RoadNetwork:
    """The same network with the faster search; a network of a class of its own is left as it is."""
    if type(network) not in (RoadNetwork, StreetNetwork):
        return network
    return FastRoadNetwork(network, lane_table(network) if table is None else table)
