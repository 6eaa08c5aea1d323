"""Signal reception along the lanes of a network, and the map of its forecast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex
from lanebound.envs.sky.corridors import Edge, edges_of, lane_points
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["LaneMap", "Street"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LaneMap:
    """Order of the stations of all edges in one row.

    Attributes
    ----------
    spacing_m : distance between stations along a lane
    offset_m : arc of the start of each edge
    reach_m : largest longitudinal position of a lane with stations
    count : number of stations
    """

    spacing_m: float
    offset_m: dict[Edge, float]
    reach_m: dict[LaneIndex, float]
    count: int

    @classmethod
    def of(cls, network: RoadNetwork, extent_m: float, spacing_m: float) -> LaneMap:
        """Build the map of a network whose lanes have stations from their start up to ``extent_m``."""
        offset: dict[Edge, float] = {}
        reach: dict[LaneIndex, float] = {}
        at = 0.0
        for edge, lanes in edges_of(network):
            offset[edge] = at
            own = {(*edge, i): min(float(lane.length), extent_m) for i, lane in enumerate(lanes)}
            reach |= own
            at += spacing_m * _stations(max(own.values()), spacing_m)
        return cls(spacing_m, offset, reach, round(at / spacing_m))

    def stations(self, edge: Edge, lanes: int) -> int:
        """Number of stations along an edge with a number of lanes."""
        return _stations(max(self.reach_m[(*edge, i)] for i in range(lanes)), self.spacing_m)

    def antennas(self, network: RoadNetwork, height_m: float, widest: int = 0) -> Array:
        """Antenna positions ENU above the centre of each lane, (N, L, 3) [m]; missing lanes repeat the last lane.

        L is the largest number of lanes, at least ``widest``.
        """
        rows = []
        widest = max(widest, *(len(lanes) for _, lanes in edges_of(network)))
        for edge, lanes in edges_of(network):
            s = self.spacing_m * np.arange(self.stations(edge, len(lanes)))
            tracks = [lane_points(lane, np.minimum(s, lane.length)) for lane in lanes]
            rows.append(np.stack(tracks + tracks[-1:] * (widest - len(tracks)), 1))
        en = np.concatenate(rows)
        return np.concatenate([en, np.full((*en.shape[:2], 1), height_m)], -1)


def _stations(reach_m: float, spacing_m: float) -> int:
    return int(np.ceil(reach_m / spacing_m)) + 1


@dataclass(frozen=True)
class Street:
    """The sky of a network: :class:`~lanebound.integrity.sky.visibility.SkyMask` with highway-env's lane indices.

    Attributes
    ----------
    mask : reception by station and lane, as it is: for instruments and pictures
    forecast : prediction from a map of the city, for planning
    city : the obstacles behind the mask, for drawing
    lanes : how lane indices map to stations
    """

    mask: SkyMask
    forecast: SkyForecast
    city: City
    lanes: LaneMap

    def __deepcopy__(self, memo: dict[int, Any]) -> Street:
        """Return the street itself, which is immutable and large."""
        return self

    def where(self, lane_index: tuple[str, str, int | None], longitudinal_m: float) -> tuple[float, int]:
        """Convert a place on a highway-env lane to arc [m] and lane for ``SkyMask.look`` and ``Truth``.

        Places before the start, after the end and beyond the stations are mapped to the nearest station.

        Raises
        ------
        InputError
            The network has no such lane.
        """
        start, end, lane = lane_index[0], lane_index[1], lane_index[2] or 0
        try:
            reach = self.lanes.reach_m[start, end, lane]
        except KeyError:
            raise InputError(
                f"lane_index must be a lane of this street, got {lane_index}: build the street of that network"
            ) from None
        return self.lanes.offset_m[start, end] + min(max(longitudinal_m, 0.0), reach), lane
