"""Signal reception along the lanes of a network, and its forecast for a planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import ArrayLike, NDArray

from lanebound.envs.batch.sky_ahead_kernel import NO_LANE
from lanebound.envs.records import LaneIndex
from lanebound.envs.sky.corridors import Edge, edges_of, lane_points
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

__all__ = ["NO_LANE", "LaneMap", "Street"]

Array = NDArray[np.float64]
Route = Sequence[tuple[str, str, int | None]]


@dataclass(frozen=True)
class LaneMap:
    """Order of the stations of all edges in one row, and connections of the lanes.

    Attributes
    ----------
    spacing_m : distance between stations along a lane
    offset_m : arc of the start of each edge
    length_m : length of each lane
    reach_m : largest longitudinal position of a lane with stations
    beside : left and right neighbours of each lane, None for none
    following : for each lane, by the end node of the next edge: the next lane
    """

    spacing_m: float
    offset_m: dict[Edge, float]
    length_m: dict[LaneIndex, float]
    reach_m: dict[LaneIndex, float]
    beside: dict[LaneIndex, tuple[LaneIndex | None, LaneIndex | None]]
    following: dict[LaneIndex, dict[str, LaneIndex]]

    @classmethod
    def of(cls, network: RoadNetwork, extent_m: float, spacing_m: float) -> LaneMap:
        """Build the map of a network whose lanes have stations from their start up to ``extent_m``."""
        offset: dict[Edge, float] = {}
        length: dict[LaneIndex, float] = {}
        beside: dict[LaneIndex, tuple[LaneIndex | None, LaneIndex | None]] = {}
        at = 0.0
        for edge, lanes in edges_of(network):
            offset[edge] = at
            ids: list[LaneIndex] = [(*edge, i) for i in range(len(lanes))]
            for i, lane in enumerate(lanes):
                length[ids[i]] = float(lane.length)
                beside[ids[i]] = (ids[i - 1] if i > 0 else None, ids[i + 1] if i + 1 < len(ids) else None)
            at += spacing_m * _stations(max(min(length[i], extent_m) for i in ids), spacing_m)
        reach = {index: min(value, extent_m) for index, value in length.items()}
        return cls(spacing_m, offset, length, reach, beside, _following(network))

    def stations(self, edge: Edge, lanes: int) -> int:
        """Number of stations along an edge with a number of lanes."""
        return _stations(max(self.reach_m[(*edge, i)] for i in range(lanes)), self.spacing_m)

    def antennas(self, network: RoadNetwork, height_m: float) -> Array:
        """Antenna positions ENU above the centre of each lane, (N, L, 3) [m]; missing lanes repeat the last lane."""
        rows = []
        widest = max(len(lanes) for _, lanes in edges_of(network))
        for edge, lanes in edges_of(network):
            s = self.spacing_m * np.arange(self.stations(edge, len(lanes)))
            tracks = [lane_points(lane, np.minimum(s, lane.length)) for lane in lanes]
            rows.append(np.stack(tracks + tracks[-1:] * (widest - len(tracks)), 1))
        en = np.concatenate(rows)
        return np.concatenate([en, np.full((*en.shape[:2], 1), height_m)], -1)


def _stations(reach_m: float, spacing_m: float) -> int:
    return int(np.ceil(reach_m / spacing_m)) + 1


def _following(network: RoadNetwork) -> dict[LaneIndex, dict[str, LaneIndex]]:
    """Next lanes by highway-env's rule: the same lane if the next edge has as many lanes, otherwise the nearest one."""
    out: dict[LaneIndex, dict[str, LaneIndex]] = {}
    for (start, end), lanes in edges_of(network):
        for i, lane in enumerate(lanes):
            last = lane.position(lane.length, 0.0)
            out[start, end, i] = {}
            for beyond, others in network.graph.get(end, {}).items():
                away = [float(np.linalg.norm(other.position(0.0, 0.0) - last)) for other in others]
                if away:
                    out[start, end, i][beyond] = (
                        end,
                        beyond,
                        i if len(others) == len(lanes) else int(np.argmin(away)),
                    )
    return out


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

    def ahead(
        self, lane_index: LaneIndex, longitudinal_m: float, distance_m: float, route: Route | None = None
    ) -> tuple[LaneIndex, float]:
        """Find the lane and longitudinal position ``distance_m`` further along the route.

        A route is highway-env's list of lane indices. Without an entry, or after its end, the first edge onward is
        taken; at the end of the last lane, its end.
        """
        place = longitudinal_m + distance_m
        onward = {} if route is None else {step[0]: step for step in route}
        while place > self.lanes.length_m[lane_index]:
            options = self.lanes.following[lane_index]
            if not options:
                return lane_index, self.lanes.length_m[lane_index]
            place -= self.lanes.length_m[lane_index]
            step = onward.get(lane_index[1])
            lane_index = (options.get(step[1]) if step else None) or next(iter(options.values()))
        return lane_index, place

    def predicted_beside(
        self,
        lane_index: LaneIndex,
        longitudinal_m: float,
        distances_m: ArrayLike,
        sky: SkyView,
        route: Route | None = None,
    ) -> NDArray[np.int64]:
        """Predict the number of satellites in line of sight at distances ahead along the route.  (D,) [m] -> (D, 3).

        The columns are the lane to the left, the lane of the route and the lane to the right; -1 for no lane. The
        places on the neighbouring lanes are at the same share of the length.
        """
        places: list[tuple[float, int]] = []
        there: list[bool] = []
        for d in np.asarray(distances_m, dtype=np.float64):
            own, place = self.ahead(lane_index, longitudinal_m, float(d), route)
            left, right = self.lanes.beside[own]
            share = place / self.lanes.length_m[own]
            for lane in (left, own, right):
                there.append(lane is not None)
                places.append(self.where(lane or own, share * self.lanes.length_m[lane or own]))
        arcs, ids = np.array([p[0] for p in places]), np.array([p[1] for p in places], dtype=np.int64)
        return np.where(there, self.forecast.count(arcs, ids, sky), int(NO_LANE)).reshape(-1, 3)
