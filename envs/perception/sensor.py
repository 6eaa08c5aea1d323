"""The ego's own sensor: which vehicles it sees past the others, and how well it measures them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.perception.config import SensorConfig
from lanebound.envs.perception.tracks import AGE, HEADING, N_COLUMNS, PL_AT, PL_CT, SPEED, XY, direction
from lanebound.envs.perception.vehicles import Vehicles
from lanebound.envs.records import EgoBelief
from lanebound.integrity.streams import Streams

__all__ = ["Sensor", "in_sight"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
STAMP = AGE  # a track that is kept holds the time of its measurement in that column


def in_sight(targets: Rows, vehicles: Vehicles, me: int) -> NDArray[np.bool_]:
    """Whether the line from the middle of vehicle ``me`` to that of each target crosses no third vehicle.

    Exact: a line and a rectangle are apart when their shadows on an axis of the rectangle, or on the normal of the
    line, are.

    Parameters
    ----------
    targets : (T,) rows of ``vehicles``

    Returns
    -------
    (T,) bool
    """
    line = vehicles.position_m[targets] - vehicles.position_m[me]
    start = vehicles.position_m[me] - vehicles.position_m
    ahead = direction(vehicles.heading_rad)
    right = ahead[:, ::-1] * np.array([-1.0, 1.0])
    run_x, run_y = line @ ahead.T, line @ right.T
    twist = line @ (start[:, ::-1] * np.array([-2.0, 2.0])).T
    reach_x, reach_y = np.abs(run_x), np.abs(run_y)
    length, width = vehicles.length_m, vehicles.width_m
    crosses = np.abs(run_x + 2.0 * (start * ahead).sum(axis=1)) <= reach_x + length
    crosses &= np.abs(run_y + 2.0 * (start * right).sum(axis=1)) <= reach_y + width
    crosses &= np.abs(twist) <= reach_y * length + reach_x * width
    crosses[:, me] = False
    crosses[np.arange(targets.size), targets] = False
    seen: NDArray[np.bool_] = ~crosses.any(axis=1)
    return seen


class Sensor:
    """Measurements of the vehicles in sight, kept for each of C slots.

    A measurement is put on the ego's believed pose and from then on moves with the ego's odometry, so that a jump of
    the ego's solution moves ego and track alike.
    """

    def __init__(self, config: SensorConfig, capacity: int, dt_s: float, streams: Streams) -> None:
        self._config = config
        self._bound_sigmas = config.bound_sigmas
        self._dt_s = dt_s
        self._streams = streams
        self._seen = np.full((capacity, N_COLUMNS), -np.inf)
        self._travelled_m = np.zeros(2)

    def forget(self, slots: Rows) -> None:
        """Drop what was seen of these slots: other vehicles take them over."""
        self._seen[slots] = -np.inf

    def look(self, time_s: float, ego: EgoBelief, me: int, vehicles: Vehicles) -> Array:
        """What was seen last of each slot, (C, 7), placed on the ego's belief now; never seen: age inf.

        Parameters
        ----------
        me : row of the ego in ``vehicles``
        """
        self._travelled_m += ego.speed_mps * self._dt_s * direction(ego.heading_rad)
        here = ego.position_m - self._travelled_m
        noise = self._streams.normal("sensor", self._seen.shape[0], 4)[0]
        rows, distance_m, bearing_rad = self._visible(vehicles, me)
        slots = vehicles.slot[rows]
        measured = self._measure(ego, vehicles, me, rows, distance_m, bearing_rad, noise[slots])
        measured[:, XY] -= here
        measured[:, STAMP] = time_s
        self._seen[slots] = measured
        tracks = self._seen.copy()
        tracks[:, XY] += here
        tracks[:, AGE] = time_s - tracks[:, STAMP]
        return tracks

    def _visible(self, vehicles: Vehicles, me: int) -> tuple[Rows, Array, Array]:
        """Rows of the vehicles seen, their true distance, and their true bearing from the ego's heading."""
        gap = vehicles.position_m - vehicles.position_m[me]
        distance = np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2)
        bearing = np.arctan2(gap[:, 1], gap[:, 0]) - vehicles.heading_rad[me]
        off_axis = np.abs(np.remainder(bearing + math.pi, 2.0 * math.pi) - math.pi)
        within = (distance <= self._config.range_m) & (off_axis <= math.radians(0.5 * self._config.field_of_view_deg))
        within[me] = False
        rows = np.flatnonzero(within)
        rows = rows[in_sight(rows, vehicles, me)]
        return rows, distance[rows], bearing[rows]

    def _measure(
        self,
        ego: EgoBelief,
        vehicles: Vehicles,
        me: int,
        rows: Rows,
        distance_m: Array,
        bearing_rad: Array,
        noise: Array,
    ) -> Array:
        """What the sensor makes of the vehicles seen, with ``noise`` (T, 4), on the ego's believed pose, (T, 7).

        Along and across the measured heading, which the line of sight leaves by psi, the errors of distance (sigma_r)
        and bearing (sigma_b) give ``sigma_at^2 = (sigma_r cos psi)^2 + (r sigma_b sin psi)^2``, and sigma_ct with
        cos and sin exchanged. The ego's error of its own speed enters by the cosine of the angle between the headings.
        """
        config, k = self._config, self._bound_sigmas
        sigma_b = math.radians(config.bearing_sigma_deg)
        r = distance_m + config.range_sigma_m * noise[:, 0]
        line = ego.heading_rad + bearing_rad + sigma_b * noise[:, 1]
        turned = vehicles.heading_rad[rows] - vehicles.heading_rad[me]
        wrong_mps = ego.speed_mps - vehicles.speed_mps[me]
        heading = ego.heading_rad + turned + math.radians(config.heading_sigma_deg) * noise[:, 3]
        psi, across = line - heading, r * sigma_b
        cos2, sin2 = np.cos(psi) ** 2, np.sin(psi) ** 2
        track = np.empty((rows.size, N_COLUMNS))
        track[:, XY] = ego.position_m + r[:, None] * direction(line)
        track[:, HEADING] = heading
        track[:, SPEED] = vehicles.speed_mps[rows] + wrong_mps * np.cos(turned) + config.speed_sigma_mps * noise[:, 2]
        track[:, PL_AT] = k * np.sqrt(config.range_sigma_m**2 * cos2 + across**2 * sin2)
        track[:, PL_CT] = k * np.sqrt(config.range_sigma_m**2 * sin2 + across**2 * cos2)
        return track
