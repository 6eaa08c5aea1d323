"""The vehicles of a single environment in the records: their poses, and the slots that the others take and leave.

A slot is a row of all arrays that have a row for each vehicle beside the ego: navigators, messages, tracks. A vehicle
has one slot from its entry into the world to its exit; the next vehicle in that slot has the same instruments.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.batch.episodes import Episodes, empty_cars
from lanebound.envs.batch.fleet import order_of
from lanebound.envs.batch.lanes_kernel import NONE
from lanebound.envs.batch.navigation import FLEET_STARTS, fleet_generator
from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.wander import Wander

__all__ = ["Seats"]


class Seats:
    """The vehicles of a world as the first row of ``episodes.cars``; each row of a fleet has another ego.

    Attributes
    ----------
    capacity : number of slots
    vehicles : the ego, then the others in the order of the world
    slot : of each vehicle that has one
    wander : the lines of the others in their lanes
    """

    def __init__(self, world: AbstractEnv, episodes: Episodes, fleet_seed: int, wander: Wander) -> None:
        self.world, self.episodes, self.wander = world, episodes, wander
        self.capacity = episodes.perception.capacity
        self.vehicles: list[Vehicle] = []
        self.slot: dict[Vehicle, int] = {}
        self._free = list(range(self.capacity))[::-1]
        self._generator = fleet_generator(fleet_seed)
        others = self._others()
        if others:  # what their starts have drawn
            self._generator.standard_normal((FLEET_STARTS, self.capacity, 3))
        self._named = 1 + len(others)  # those that are there have the names 1, 2, ...
        self._seat(others)
        self._order = order_of(len(self.vehicles) if len(episodes.cars) > 1 else 0)

    def _others(self) -> list[Vehicle]:
        ego = self.world.vehicle
        return [v for v in self.world.road.vehicles if v is not ego]

    def _seat(self, others: list[Vehicle]) -> list[Vehicle]:
        """Free the slots of vehicles that left, and assign slots to new ones; returns the new ones."""
        known = set(self.vehicles)
        for vehicle in others:
            if vehicle not in known:
                self.wander.enter(vehicle)
        there = set(others)
        for vehicle in [v for v in self.slot if v not in there]:
            self._free.append(self.slot.pop(vehicle))
        fresh = [v for v in others if v not in self.slot][: len(self._free)]
        for vehicle in fresh:
            self.slot[vehicle] = self._free.pop()
        self.vehicles = [self.world.vehicle, *others]
        self._make_room(len(self.vehicles))
        cars, n = self.episodes.cars[0], len(self.vehicles)
        self.episodes.ego["vehicles"], cars["slot"] = n, -1
        cars["slot"][1:n] = [self.slot.get(v, -1) for v in others]
        cars["length"][:n] = [v.LENGTH for v in self.vehicles]
        cars["width"][:n] = [v.WIDTH for v in self.vehicles]
        return fresh

    def _make_room(self, count: int) -> None:
        """Make the rows longer when there are more vehicles than columns."""
        if count > self.episodes.cars.shape[1]:
            self.episodes.replace_cars(empty_cars(1, 2 * count))

    def follow(self, passed: int) -> None:
        """Update the slots after vehicles appeared or left; ``passed``: steps of the epoch before this one."""
        others = self._others()
        if others == self.vehicles[1:]:
            return
        fresh = self._seat(others)
        perception, navigation = self.episodes.perception, self.episodes.navigation
        for vehicle in fresh:
            perception.enter(0, self.slot[vehicle], self._named, vehicle.LENGTH, vehicle.WIDTH)
            self._named += 1
        if fresh and navigation is not None and navigation.vehicles > 1:
            slots = np.array([self.slot[v] for v in fresh], dtype=np.int64)
            position = np.array([v.position for v in fresh], dtype=np.float64)
            heading, speed = np.array([(v.heading, v.speed) for v in fresh], dtype=np.float64).T
            noise = self._generator.standard_normal((self.capacity, 3))[slots]
            navigation.enter(0, slots, position, heading, speed, passed, noise)

    def read(self, full: bool) -> None:
        """Take the poses of the vehicles; ``full``: speeds, lanes and crashes as well."""
        cars, vehicles = self.episodes.cars[0], self.vehicles
        navigation = self.episodes.navigation
        if not full and (navigation is None or navigation.vehicles == 1):
            vehicles = vehicles[:1]
        n = len(vehicles)
        cars["x"][:n], cars["y"][:n] = np.array([v.position for v in vehicles], dtype=np.float64).T
        cars["heading"][:n] = [v.heading for v in vehicles]
        cars["speed"][0] = vehicles[0].speed
        row = self.episodes.table.row
        cars["lane"][0] = row[vehicles[0].lane_index]
        if full:
            cars["speed"][:n] = [v.speed for v in vehicles]
            cars["lane"][:n] = [row[v.lane_index] for v in vehicles]
            cars["crashed"][:n] = [v.crashed for v in vehicles]
            if self.episodes.table.has_crossings:
                cars["onward"][:n] = [_onward(v, row) for v in vehicles]
        every = self.episodes.cars
        if len(every) > 1:
            every[1:], every["slot"][1:] = cars[self._order[1:]], cars["slot"]


def _onward(vehicle: Vehicle, row: Mapping[LaneIndex, int]) -> int:
    """The lane that the route of a vehicle goes on to from the end of its lane; NONE without one."""
    _, end, side = vehicle.lane_index
    for start, to, chosen in getattr(vehicle, "route", None) or ():
        if start == end:
            wanted = side if chosen is None else chosen
            return row.get((start, to, wanted), row.get((start, to, 0), NONE))
    return NONE
