"""How episodes start: the draws of the environments' own worlds, in their order, into the engine's arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.lanes import lane_rows
from lanebound.envs.vector.lanes_kernel import Lanes
from lanebound.envs.vector.start_kernel import line_up
from lanebound.envs.worlds.car_following import END_M, CarFollowingWorld
from lanebound.envs.worlds.drivers import CityDriver, LeadVehicle, SpeedProfileConfig, speed_profile
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld, draw_seats

__all__ = ["Starter", "most_vehicles", "profile_steps", "starter_of"]

Array = NDArray[np.float64]
Starter = Callable[[np.random.Generator, Array, NDArray[np.int64], Array], None]
"""Fills cars (CAR, V), whole (WHOLE, V) and profile (S,) of one environment from its world's generator."""


def profile_steps(world: AbstractEnv) -> int:
    """Length of a lead's profile of speeds, 1 where there is none."""
    if not isinstance(world, CarFollowingWorld):
        return 1
    return int(np.ceil(world.config["duration"] / (1.0 / world.config["simulation_frequency"]))) + 1


def most_vehicles(world: AbstractEnv) -> int:
    """How many vehicles an episode may have, the ego included."""
    if isinstance(world, UrbanCanyonWorld):
        return 1 + int(world.config["vehicles_count"])
    return len(world.road.vehicles)


def starter_of(world: AbstractEnv, lanes: Lanes) -> Starter:
    """The start of a world's episodes; ``world`` is asked for its configuration and its lanes alone."""
    if isinstance(world, CarFollowingWorld):
        return _Following(world)
    if isinstance(world, UrbanCanyonWorld):
        return _City(world)
    if "vehicles_density" in world.config:
        return _Motorway(world.config, lanes)
    return _Alone(world)


class _Motorway:
    """highway-env's ``HighwayEnv``."""

    def __init__(self, config: Mapping[str, Any], lanes: Lanes) -> None:
        lane = config["initial_lane_id"]
        self._lanes, self._ego_lane = lanes, -1 if lane is None else int(lane)
        self._spacings = float(config["ego_spacing"]), 1.0 / config["vehicles_density"]

    def __call__(self, rng: np.random.Generator, cars: Array, whole: NDArray[np.int64], profile: Array) -> None:
        line_up(rng, cars, whole, self._lanes.table, self._ego_lane, *self._spacings)


class _Following:
    """:class:`~lanebound.envs.worlds.car_following.CarFollowingWorld`."""

    def __init__(self, world: CarFollowingWorld) -> None:
        self._config = world.config
        self._lane = world.road.network.get_lane(("start", "end", 0))
        self._law = SpeedProfileConfig.load(world.config["lead"], "lead")
        self._latest = max(self._lane.length - END_M - self._lane.speed_limit * world.config["duration"], 20.0)

    def __call__(self, rng: np.random.Generator, cars: Array, whole: NDArray[np.int64], profile: Array) -> None:
        c = self._config
        profile[:] = speed_profile(rng, c["duration"], 1.0 / c["simulation_frequency"], self._law)
        speed = float(profile[0])
        gap = c["standstill_gap"] + float(rng.uniform(*c["time_gap"])) * speed
        start = float(rng.uniform(10.0, self._latest))
        _put(cars, whole, 0, self._lane, 0, start, speed)
        _put(cars, whole, 1, self._lane, 0, start + gap + LeadVehicle.LENGTH, speed)


class _Alone:
    """:class:`~lanebound.envs.worlds.lane_keeping.LaneKeepingWorld`."""

    def __init__(self, world: AbstractEnv) -> None:
        self._config, self._network = world.config, world.road.network

    def __call__(self, rng: np.random.Generator, cars: Array, whole: NDArray[np.int64], profile: Array) -> None:
        row = int(rng.integers(self._config["lanes_count"]))
        lane = self._network.get_lane(("start", "end", row))
        latest = lane.length - END_M - lane.speed_limit * self._config["duration"]
        start = float(rng.uniform(10.0, max(latest, 20.0)))
        _put(cars, whole, 0, lane, row, start, min(self._config["initial_speed"], lane.advised_speed(start)))


class _City:
    """:class:`~lanebound.envs.worlds.urban_canyon.UrbanCanyonWorld`."""

    def __init__(self, world: UrbanCanyonWorld) -> None:
        self._config, self._network = world.config, world.road.network
        self._rows = lane_rows(self._network)

    def __call__(self, rng: np.random.Generator, cars: Array, whole: NDArray[np.int64], profile: Array) -> None:
        cars[:], whole[:] = 0.0, 0
        cars[k.COS] = 1.0
        for i, seat in enumerate(draw_seats(rng, self._network, self._config)):
            lane = self._network.get_lane(seat.lane_index)
            position = lane.position(seat.along_m, 0.0)
            nearest = self._network.get_closest_lane_index(position, lane.heading_at(seat.along_m))
            _put(cars, whole, i, lane, self._rows.index(nearest), seat.along_m, seat.speed_mps)
            cars[k.TARGET_SPEED, i], cars[k.DELTA, i] = seat.target_mps, seat.exponent
            cars[k.TIMER, i] = (np.sum(position) * np.pi) % CityDriver.LANE_CHANGE_DELAY


def _put(cars: Array, whole: NDArray[np.int64], i: int, lane: Any, row: int, s: float, speed: float) -> None:
    """A vehicle in the middle of a lane, at its direction."""
    cars[:, i], whole[:, i] = 0.0, 0
    x, y = lane.position(s, 0.0)
    heading = float(lane.heading_at(s))
    cars[[k.X, k.Y, k.HEADING, k.SPEED, k.TARGET_SPEED], i] = x, y, heading, speed, speed
    cars[[k.COS, k.SIN], i] = np.cos(heading), np.sin(heading)
    whole[[k.LANE, k.TARGET], i], whole[k.ORDER, i], whole[k.PRESENT, i] = row, i, 1
