"""Common parts of the worlds: rates, ego vehicle, rewards, and the end of episodes."""

from __future__ import annotations

from math import cos, pi
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import lmap, wrap_to_pi
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.closures import Closure, barriers
from lanebound.envs.worlds.drivers import LeadVehicle
from lanebound.envs.worlds.followers import PlatoonDriver
from lanebound.envs.worlds.kinds import Refusal, Starter, Support
from lanebound.envs.worlds.lanes import CurveLane
from lanebound.envs.worlds.networks import Section, StreetNetwork
from lanebound.envs.worlds.roads import StreetRoad
from lanebound.envs.worlds.seating import put_on_lane
from lanebound.integrity.core.errors import InputError

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.integrity.core.records import Records

__all__ = ["TARGET_SPEEDS_MPS", "Seat", "World"]

Array = NDArray[np.float64]

# Target speeds of meta-actions; evenly spaced, as MDPVehicle requires. Steps of 2 m/s would brake too late for a lead
# vehicle.
TARGET_SPEEDS_MPS = [0.0, 2.8, 5.6, 8.4, 11.2, 14.0]
CONTINUOUS: dict[str, Any] = {
    "type": "ContinuousAction",
    "acceleration_range": [-6.0, 6.0],  # [m/s2]
    "steering_range": [-0.4, 0.4],  # [rad]; 12 m radius
    "speed_range": [0.0, 20.0],  # [m/s]
}
META: dict[str, Any] = {"type": "DiscreteMetaAction", "target_speeds": TARGET_SPEEDS_MPS}


OF_ENGINE = ("step", "_simulate", "_populate", "_reward", "_rewards", "_is_terminated", "_is_truncated")
"""Methods that the engine has compiled as they are in :class:`World`."""
OF_HIGHWAY_ENV = ("crossing", "motorway")
"""Kinds of traffic that need roads of highway-env."""


class Seat(NamedTuple):
    """Initial state of a vehicle in an episode: lane, longitudinal position, speed, and parameters of its driver.

    Attributes
    ----------
    target_mps, exponent : desired speed and acceleration exponent of IDM drivers
    """

    lane_index: LaneIndex
    along_m: float
    speed_mps: float
    target_mps: float = 0.0
    exponent: float = 0.0


class World(AbstractEnv):  # type: ignore[misc]
    """A highway-env scenario on a road of this package.

    A subclass creates the road (``_network``) and draws the initial states of an episode (``draw_seats``). ``OTHERS``
    is the class of the other vehicles, ``TRAFFIC`` the traffic of the vector engine that moves them (``course``:
    LeadVehicle, ``city``: CityDriver, ``platoon``: PlatoonDriver, ``network``: IDMVehicle), ``most_vehicles`` their
    largest number with the ego,
    ``ENDS_M`` the distance from the end of the road at which an episode ends (None for roads without an end).
    ``closure`` is the lane that closes in the episode, if any (``draw_closure``), ``tolled`` the tolled road of each
    geo-object of the network (``draw_tolls``).

    Action
        As in highway-env, set by ``config["action"]``: ``ContinuousAction`` (acceleration within 6 m/s2, steering
        within 0.4 rad) at 5 Hz, or ``DiscreteMetaAction`` (speeds from 0 to 14 m/s in steps of 2.8) at 2 Hz.
    Observation
        As in highway-env, set by ``config["observation"]``.
    Reward
        Weighted sum of progress, centring and collision, scaled to [0, 1]; see :meth:`_rewards`.
    Episode end
        Terminated by a collision, when the centre of the vehicle leaves the road, or by driving against the direction
        of the lane; truncated after ``duration``.
    Configuration, besides highway-env's keys
        ``simulation_frequency`` 20 Hz; ``lane_width`` [m]: 3.25 in towns, 4 is easy and 3 difficult for cars of 2 m;
        ``duration`` [s]; ``progress_reward``, ``centring_reward``, ``collision_reward``: weights of the terms.
    """

    OTHERS: ClassVar[type[Vehicle]] = LeadVehicle
    TRAFFIC: ClassVar[str] = "course"
    closure: Closure | None = None
    tolled: tuple[tuple[str, str], ...] = ()
    ENDS_M: ClassVar[float | None] = 20.0

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        config: dict[str, Any] = super().default_config()
        return config | {
            "simulation_frequency": 20,
            "policy_frequency": 5,
            "action": dict(CONTINUOUS),
            "neighbour_vehicles_connected_lanes": True,
            "lane_width": 3.25,
            "duration": 60.0,
            "offroad_terminal": True,
            "progress_reward": 0.6,
            "centring_reward": 0.4,
            "collision_reward": -1.0,
            "screen_width": 600,
            "screen_height": 600,
            "centering_position": [0.5, 0.5],
        }

    @property
    def sections(self) -> tuple[Section, ...]:
        """Surroundings of the road given by the world: edge from, edge to, start, end [m], kind of section."""
        return ()

    def _network(self) -> StreetNetwork:
        """The road network."""
        raise NotImplementedError

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw the initial states of an episode, the ego first, and the speed profile of the others, if any.

        A profile has a speed for each simulation step, see :func:`~.drivers.speed_profile`; LeadVehicle needs one. With
        several (K, S) each of the others has its own. Of PlatoonDriver the first K have profiles.
        """
        raise NotImplementedError

    def draw_closure(self, rng: np.random.Generator) -> Closure | None:
        """Draw the lane that closes in an episode, before its seats; all closures of a world are of one length."""
        return None

    def draw_tolls(self, rng: np.random.Generator) -> tuple[tuple[str, str], ...]:
        """Draw the tolled road of each geo-object of an episode, before its seats."""
        return ()

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """Largest number of vehicles in an episode, including the ego."""
        return 1

    def _populate(self) -> None:
        """Place the ego and the others."""
        (ego, *others), speeds = drawn_seats(self, self.np_random)
        self._place_ego(ego.lane_index, ego.along_m, ego.speed_mps)
        rows: Any = () if speeds is None else np.atleast_2d(speeds)
        dt_s = 1.0 / self.config["simulation_frequency"]
        for k, seat in enumerate(others):
            driver: Any = self.OTHERS.make_on_lane(self.road, seat.lane_index, seat.along_m, seat.speed_mps)
            if isinstance(driver, IDMVehicle):
                driver.target_speed, driver.DELTA = seat.target_mps, seat.exponent
            if isinstance(driver, PlatoonDriver):
                driver.share = min(dt_s / driver.LAG_S, 1.0)
            if k < len(rows) or (len(rows) and isinstance(driver, LeadVehicle)):
                driver.follow(rows[min(k, len(rows) - 1)])
            self.road.vehicles.append(driver)

    def _reset(self) -> None:
        self.road = StreetRoad(
            network=self._network(),
            np_random=self.np_random,
            record_history=self.config["show_trajectories"],
            neighbour_vehicles_connected_lanes=self.config["neighbour_vehicles_connected_lanes"],
        )
        self.closure, self.tolled = self.draw_closure(self.np_random), self.draw_tolls(self.np_random)
        for place in () if self.closure is None else barriers(self.road.network, self.closure):
            self.road.objects.append(Obstacle(self.road, *place))
        self._populate()

    def _place_ego(self, index: LaneIndex, longitudinal_m: float, speed_mps: float) -> None:
        """Create the ego in the middle of a lane; with meta-actions it tracks the nearest target speed."""
        lane = self.road.network.get_lane(index)
        vehicle = self.action_type.vehicle_class(
            self.road, lane.position(longitudinal_m, 0.0), heading=lane.heading_at(longitudinal_m), speed=speed_mps
        )
        self.controlled_vehicles = [vehicle]
        self.road.vehicles.append(vehicle)

    def _along(self) -> tuple[float, float, float]:
        """Distance along the ego's lane [m], to the right of it [m], and angle to it [rad]."""
        lane, position = self.vehicle.lane, self.vehicle.position
        if isinstance(lane, CurveLane):
            s, r, direction = lane.local_pose(position)
        else:
            s, r = lane.local_coordinates(position)
            direction = lane.heading_at(s)
        return s, r, float(wrap_to_pi(self.vehicle.heading - direction))

    def _reward(self, action: Any) -> float:
        """Weighted sum of the terms, scaled to [0, 1]."""
        weights = {name: self.config[f"{name}_reward"] for name in ("progress", "centring", "collision")}
        terms = self._rewards(action)
        total = 0.0
        for name, weight in weights.items():  # sum() compensates rounding from Python 3.12 on, kernels do not
            total += weight * terms[f"{name}_reward"]
        best = weights["progress"] + weights["centring"]
        return float(np.clip(lmap(total, [weights["collision"], best], [0.0, 1.0]), 0.0, 1.0))

    def _rewards(self, action: Any) -> dict[str, float]:
        """Terms in [0, 1]: speed along the lane over its limit, closeness to its centre while moving, and collision.

        Reversing and spinning are no progress, and a vehicle at rest gets no reward for its position.
        """
        _, lateral, angle = self._along()
        lane, vehicle = self.vehicle.lane, self.vehicle
        progress = min(max(vehicle.speed * cos(angle) / lane.speed_limit, 0.0), 1.0)
        share = 2.0 * lateral / lane.width
        nearness = max(1.0 - share * share, 0.0)
        return {
            "progress_reward": progress,
            "centring_reward": nearness * min(4.0 * progress, 1.0),
            "collision_reward": float(vehicle.crashed),
        }

    def _is_terminated(self) -> bool:
        """Whether there is a collision, the centre is off the road, or the vehicle drives against its lane."""
        off_road = self.config["offroad_terminal"] and not self.vehicle.on_road
        return bool(self.vehicle.crashed or off_road or abs(self._along()[2]) > 0.5 * pi)

    def _is_truncated(self) -> bool:
        """Whether the duration has passed (half a step of tolerance), or the end of the road is reached."""
        late = bool(self.time >= self.config["duration"] - 0.5 / self.config["policy_frequency"])
        return late or (self.ENDS_M is not None and bool(self._along()[0] > self.vehicle.lane.length - self.ENDS_M))

    # Support for the vector engine

    @classmethod
    def support(cls) -> Support:
        """Support for the vector engine: the same initial states, compiled traffic, and the same ends and reward."""
        return Support(
            traffic=cls.TRAFFIC,
            vehicles=lambda world: cls.most_vehicles(world.config),
            starter=_seated,
            ends=cls._ends,
            profile_steps=cls._profile_steps,
            profiles=cls._profiles,
            refusals=cls._refusals,
            drivers=cls.OTHERS,
        )

    @staticmethod
    def _ends(world: AbstractEnv) -> dict[str, float]:
        """Fields of the record WORLD of the engine."""
        from lanebound.envs.vector.world_kernel import OF_ROADS

        c = world.config
        return {
            "duration_s": c["duration"], "tolerance_s": 0.5 / c["policy_frequency"],
            "off_road_ends": c["offroad_terminal"], "against_ends": True,
            "end_m": -1.0 if world.ENDS_M is None else world.ENDS_M, "reward": OF_ROADS,
            "collision": c["collision_reward"], "first": c["progress_reward"], "second": c["centring_reward"],
        }  # fmt: skip

    @staticmethod
    def _profile_steps(world: AbstractEnv) -> int:
        """Length of the speed profile of the other vehicles."""
        if not hasattr(world.OTHERS, "follow") or world.most_vehicles(world.config) < 2:
            return 1
        return int(np.ceil(world.config["duration"] / (1.0 / world.config["simulation_frequency"]))) + 1

    @staticmethod
    def _profiles(world: AbstractEnv) -> int:
        """Number of speed profiles of the other vehicles."""
        return 1

    @staticmethod
    def _refusals(world: AbstractEnv) -> list[tuple[str, str, object]]:
        """Options that the engine does not support, and rules of a subclass that it does not know."""
        kind, name = type(world), "neighbour_vehicles_connected_lanes"
        found: list[Refusal] = []
        if world.TRAFFIC in ("city", "platoon") and not world.config[name]:
            found.append((f"world.{name}", "True", False))
        if world.TRAFFIC in OF_HIGHWAY_ENV:
            found.append(("TRAFFIC of the world", "course, city or network", world.TRAFFIC))
        of_world = "that of World, without a support of your own,"
        for method in OF_ENGINE:
            if getattr(kind, method) is not getattr(World, method):
                found.append((f"{kind.__name__}.{method}", of_world, "a method of its own"))
        return found


def drawn_seats(world: World, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
    """What :meth:`World.draw_seats` returns.

    Raises
    ------
    InputError
        There is none, there are more than ``most_vehicles``, one is on no lane, or lead vehicles have no speeds.
    """
    seats, speeds = world.draw_seats(rng)
    name, most = type(world).__name__, world.most_vehicles(world.config)
    if not seats:
        raise InputError(f"{name}.draw_seats must return the seat of the ego first, got no seats: add it")
    if len(seats) > most:
        raise InputError(f"{name}.most_vehicles must be {len(seats)} at least, got {most}: correct it in the world")
    for seat in seats:
        start, end, lane = seat.lane_index
        if lane not in range(len(world.road.network.graph.get(start, {}).get(end, ()))):
            raise InputError(f"seats of {name} must be on lanes of its network, got {seat.lane_index}: correct it")
    if speeds is None and len(seats) > 1 and issubclass(world.OTHERS, LeadVehicle):
        raise InputError(
            f"{name}.draw_seats must return a speed profile for {world.OTHERS.__name__}, got None: return "
            "(seats, speed_profile(rng, ...)), or set OTHERS and TRAFFIC to other drivers"
        )
    return seats, speeds


def _seated(world: AbstractEnv, table: LaneTable) -> Starter:
    """Starter that writes the initial states drawn by a world to the records of the engine."""
    network, delay = world.road.network, getattr(world.OTHERS, "LANE_CHANGE_DELAY", 1.0)
    lag_s, brake_mps2 = getattr(world.OTHERS, "LAG_S", 0.0), getattr(world.OTHERS, "brake_mps2", 0.0)

    def start(rng: np.random.Generator, cars: Records, drivers: Records, profile: Array) -> int:
        world.closure, world.tolled = world.draw_closure(rng), world.draw_tolls(rng)
        seats, speeds = drawn_seats(world, rng)
        if speeds is not None:
            profile[:] = speeds
        for car, driver, seat in zip(cars, drivers, seats, strict=False):  # cars beyond the seats are empty places
            lane, rest = network.get_lane(seat.lane_index), (seat.target_mps, seat.exponent, delay)
            put_on_lane(car, driver, table, lane, seat.along_m, seat.speed_mps, *rest)
            driver["lag_s"], driver["brake_mps2"] = lag_s, brake_mps2
        return len(seats)

    return start
