"""The other vehicles that broadcast: their true motion, and what each one's own navigation makes of it.

Each has a navigator's instruments of its own, and shares with the ego what is common to all vehicles of an area
(:mod:`lanebound.integrity.sensors.area`): positions by RTK err alike, and outages of the network strike all at once.
A vehicle keeps a slot for as long as it is in the world; the next vehicle in that slot inherits its instruments.
"""

from __future__ import annotations

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.lane import AbstractLane, SineLane, StraightLane
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.motion import Motion
from lanebound.envs.navigation import NavigationConfig, place
from lanebound.envs.perception import Claims, Vehicles
from lanebound.envs.sky import Street
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.navigators.solution import Solution

__all__ = ["Fleet"]

Array = NDArray[np.float64]


class Fleet:
    """Up to ``capacity`` vehicles other than the ego.

    Attributes
    ----------
    vehicles : the vehicles present, in the order of the world
    rows : (n,) their slots
    navigator : of all slots, or None when nobody broadcasts
    solution : what each slot's navigation said last, None before the first epoch
    """

    EGO_KEY = 0

    def __init__(
        self,
        world: AbstractEnv,
        street: Street,
        navigator: Navigator | None,
        config: NavigationConfig,
        streams: Streams,
        capacity: int,
    ) -> None:
        self.world, self.street, self.navigator, self.config, self.streams = world, street, navigator, config, streams
        self.motion = Motion.still(capacity, 1.0 / world.config["simulation_frequency"])
        self.vehicles: list[Vehicle] = []
        self.solution: Solution | None = None
        self._slot: dict[Vehicle, int] = {}
        self._name: dict[Vehicle, int] = {}
        self._named = self.EGO_KEY + 1
        self._free = list(range(capacity))[::-1]
        self._label()
        self.follow()

    def follow(self) -> None:
        """Take the poses of all vehicles after a simulation step; give slots to new ones, free those of the gone."""
        present = [v for v in self.world.road.vehicles if v is not self.world.vehicle]
        if present != self.vehicles:
            self._reseat(present)
        self._position_m = np.array([v.position for v in self.vehicles], dtype=np.float64).reshape(-1, 2)
        self._heading_rad = np.array([v.heading for v in self.vehicles], dtype=np.float64)
        if self.vehicles:
            self.motion.advance(self.rows, self._position_m, self._heading_rad)

    def _reseat(self, present: list[Vehicle]) -> None:
        for vehicle in [v for v in self._slot if v not in present]:
            self._free.append(self._slot.pop(vehicle))
            del self._name[vehicle]
        fresh = [v for v in present if v not in self._slot][: len(self._free)]
        for vehicle in fresh:
            self._slot[vehicle], self._name[vehicle] = self._free.pop(), self._named
            self._named += 1
            ahead = np.array([np.cos(vehicle.heading), np.sin(vehicle.heading)])
            before = vehicle.position - self.motion.step_s * vehicle.speed * ahead  # advanced from there with the rest
            self.motion.enter(self._slot[vehicle], before, vehicle.heading, vehicle.speed)
        self.vehicles = [v for v in present if v in self._slot]
        self._label()
        if fresh and self.navigator is not None:
            rows = np.array([self._slot[v] for v in fresh], dtype=np.int64)
            noise = self.streams.normal("start", 3)[rows]
            place(self.navigator, self.config, self.motion.position_m[rows], self.motion.heading_rad[rows], noise, rows)

    def _label(self) -> None:
        """Slots, keys and sizes of the vehicles, and of the ego after them."""
        everyone = [*self.vehicles, self.world.vehicle]
        self._slots = np.array([*(self._slot[v] for v in self.vehicles), self.ego_slot], dtype=np.int64)
        self._keys = np.array([*(self._name[v] for v in self.vehicles), self.EGO_KEY], dtype=np.int64)
        self._length_m, self._width_m = np.array([(v.LENGTH, v.WIDTH) for v in everyone], dtype=np.float64).T.copy()
        self.rows = self._slots[:-1].copy()

    def rewind(self, steps: int) -> tuple[Array, Array]:
        """Put all vehicles ``steps`` simulation steps back, as if they had come straight on at their speed.

        Returns where they are put and the step that leads back, (n, 2) each; their navigators start there.
        """
        now = np.array([v.position for v in self.vehicles], dtype=np.float64).reshape(-1, 2)
        heading = np.array([v.heading for v in self.vehicles], dtype=np.float64)
        speed = np.array([v.speed for v in self.vehicles], dtype=np.float64)
        chord = self.motion.step_s * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
        begin = now - steps * chord
        for k, row in enumerate(self.rows):
            self.motion.enter(int(row), begin[k], float(heading[k]), float(speed[k]))
        self.motion.mark()
        if self.navigator is not None and self.rows.size:
            noise = self.streams.normal("start", 3)[self.rows]
            place(self.navigator, self.config, begin, heading, noise, self.rows)
        return begin, chord

    def navigate(self, time_s: float, dt_s: float) -> None:
        """One navigation epoch of every slot."""
        if self.navigator is None:
            return
        arc, lane = np.zeros(self.motion.heading_rad.size), np.zeros(self.motion.heading_rad.size, dtype=np.int64)
        if self.vehicles:
            places = [self.street.where(v.lane_index, along(v.lane, v.position)) for v in self.vehicles]
            arc[self.rows], lane[self.rows] = zip(*places, strict=True)
        with serial():
            self.solution = self.navigator.step(self.motion.epoch(time_s, dt_s, arc, lane))

    def claims(self) -> Claims:
        """What each slot would broadcast of itself, and a silent last row for the ego."""
        if self.solution is None:
            return Claims.silent(self.ego_slot + 1)
        return Claims.of(self.solution, silent=1)

    def present(self) -> Vehicles:
        """Who is really there, as :meth:`follow` saw them last, and the ego in the last slot."""
        ego, n = self.world.vehicle, len(self.vehicles)
        position, heading = np.empty((n + 1, 2)), np.empty(n + 1)
        position[:n], position[n] = self._position_m, ego.position
        heading[:n], heading[n] = self._heading_rad, ego.heading
        speed = np.array([*(v.speed for v in self.vehicles), ego.speed], dtype=np.float64)
        return Vehicles(self._slots, self._keys, position, heading, speed, self._length_m, self._width_m)

    @property
    def ego_slot(self) -> int:
        """The slot after all others."""
        return int(self.motion.heading_rad.size)


def along(lane: AbstractLane, position_m: Array) -> float:
    """Longitudinal coordinate of a point on a lane, without numpy where the lane's axis is straight."""
    if type(lane) is StraightLane or type(lane) is SineLane:
        (x, y), (x0, y0), (ux, uy) = position_m.tolist(), lane.start.tolist(), lane.direction.tolist()
        return float((x - x0) * ux + (y - y0) * uy)
    return float(lane.local_coordinates(position_m)[0])
