"""The ego's own sensor: measurements of the vehicles in sight, kept while they are out of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.perception.config import SensorConfig
from lanebound.envs.perception.tracks_kernel import AGE, N_COLUMNS, XY, measure
from lanebound.envs.perception.vehicles import Vehicles
from lanebound.envs.records import EgoBelief
from lanebound.integrity.core.streams import Streams

__all__ = ["Sensor"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class Sensor:
    """Measurements of the vehicles in sight, kept for each of C slots.

    A measurement is put on the ego's believed pose and from then on moves with the ego's odometry, so that a jump of
    the ego's solution moves ego and track alike.
    """

    def __init__(self, config: SensorConfig, capacity: int, dt_s: float, streams: Streams) -> None:
        self._figures = np.array(
            [
                config.range_m,
                math.radians(0.5 * config.field_of_view_deg),
                config.range_sigma_m,
                math.radians(config.bearing_sigma_deg),
                config.speed_sigma_mps,
                math.radians(config.heading_sigma_deg),
                config.bound_sigmas,
            ]
        )
        self._dt_s = dt_s
        self._streams = streams
        self._tracks = np.zeros((capacity, N_COLUMNS))
        self._tracks[:, AGE] = np.inf
        self._position_m = np.zeros(2)

    def forget(self, slots: Rows) -> None:
        """Drop what was seen of these slots: other vehicles take them over."""
        self._tracks[slots, AGE] = np.inf

    def look(self, ego: EgoBelief, me: int, vehicles: Vehicles) -> Array:
        """What was seen last of each slot, (C, 7), placed on the ego's belief now; never seen: age inf.

        The array is the sensor's own: the next look changes it.

        Parameters
        ----------
        me : row of the ego in ``vehicles``
        """
        travelled_m = ego.speed_mps * self._dt_s
        east, south = math.cos(ego.heading_rad) * travelled_m, math.sin(ego.heading_rad) * travelled_m
        self._tracks[:, XY] += ego.position_m - self._position_m - (east, south)
        self._tracks[:, AGE] += self._dt_s
        self._position_m = ego.position_m.copy()
        measure(
            self._figures,
            np.array([ego.position_m[0], ego.position_m[1], ego.heading_rad, ego.speed_mps]),
            me,
            np.ascontiguousarray(vehicles.slot),
            np.ascontiguousarray(vehicles.position_m),
            np.ascontiguousarray(vehicles.heading_rad),
            np.ascontiguousarray(vehicles.speed_mps),
            np.ascontiguousarray(vehicles.length_m),
            np.ascontiguousarray(vehicles.width_m),
            self._streams.normal("sensor", self._tracks.shape[0], 4)[0],
            self._tracks,
        )
        return self._tracks
