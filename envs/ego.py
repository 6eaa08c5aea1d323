"""The ego car: a physical vehicle that is controlled through a believed one.

highway-env's low-level control, lane indices and routes read the vehicle's own pose, which is the truth. Here the
physical vehicle has the true state and the dynamics; intents and commands come from a believed vehicle at the estimated
pose on a perceived road.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.records import LaneIndex

__all__ = ["HOLD", "BelievedVehicle", "BicycleEgo", "DirectEgo", "Loop", "MetaEgo", "take_over"]

Array = NDArray[np.float64]
HOLD = "hold"  # in a command: the brake works, with so many m/s2 at most


class Loop(Protocol):
    """Interface that the physical ego calls."""

    believed: BelievedVehicle
    actuated: bool

    def intend(self) -> dict[str, float]:
        """Steering and acceleration that carry meta-actions out from the believed pose."""

    def limit(self, action: dict[str, float]) -> dict[str, float]:
        """A command as the actuators carry it out."""


class BelievedVehicle(MDPVehicle):  # type: ignore[misc]
    """The car at its estimated pose; it is placed and never stepped."""

    lane_index: LaneIndex

    @property
    def planned(self) -> set[tuple[str, str]]:
        """Roads of its lane, of its target lane, and of its route."""
        return {self.lane_index[:2], self.target_lane_index[:2], *(step[:2] for step in self.route or ())}

    def place(self, position_m: Array, heading_rad: float, speed_mps: float, lane_index: LaneIndex) -> None:
        """Move to an estimate on a lane."""
        self.position, self.heading, self.speed = position_m, heading_rad, speed_mps
        if lane_index != self.lane_index:
            self.lane_index, self.lane = lane_index, self.road.network.get_lane(lane_index)

    def copy_from(self, vehicle: Vehicle) -> None:
        """Move to the true pose of ``vehicle``, bit for bit, its lane included."""
        self.position, self.heading, self.speed = vehicle.position.copy(), vehicle.heading, vehicle.speed
        self.lane_index, self.lane = vehicle.lane_index, vehicle.lane

    @classmethod
    def of(cls, vehicle: Vehicle, road: Road) -> BelievedVehicle:
        """The believed twin of a car on a perceived road, with a copy of its intent."""
        twin = cls(road, vehicle.position.copy(), vehicle.heading, vehicle.speed)
        twin.copy_from(vehicle)
        twin.target_lane_index = vehicle.lane_index
        if isinstance(vehicle, MDPVehicle):
            twin.target_speeds = vehicle.target_speeds
            for name in INTENT:
                setattr(twin, name, getattr(vehicle, name))
            twin.route = None if vehicle.route is None else list(vehicle.route)  # next_lane pops from it
        return twin


INTENT = ("target_lane_index", "target_speed", "speed_index", "route")


def stand(vehicle: Vehicle, dt_s: float) -> None:
    """Where the actuators hold the brake, it works against the wheels' true motion: highway-env's cars have none.

    Without it a car whose odometer shows 0 would creep on for ever at the speed that is too small to be measured.
    """
    bound = vehicle.action.pop(HOLD, None)
    if bound is not None:
        vehicle.action["acceleration"] = min(max(-vehicle.speed / dt_s, -bound), bound)


def _delegated(name: str) -> Any:
    """A property of the believed vehicle as soon as there is one."""

    def get(self: MetaEgo) -> Any:
        return self.__dict__[name] if self.loop is None else getattr(self.loop.believed, name)

    def put(self: MetaEgo, value: Any) -> None:
        if self.loop is None:
            self.__dict__[name] = value
        else:
            setattr(self.loop.believed, name, value)

    return property(get, put, doc=f"``{name}`` of the believed vehicle")


class MetaEgo(MDPVehicle):  # type: ignore[misc]
    """The physical car under meta-actions: lane, speed and route are intents of the believed vehicle."""

    loop: Loop | None = None
    target_lane_index = _delegated("target_lane_index")
    target_speed = _delegated("target_speed")
    speed_index = _delegated("speed_index")
    route = _delegated("route")

    def act(self, action: dict[str, float] | str | None = None) -> None:
        """Take a decision for the believed vehicle, or apply the command that follows from it to the real car."""
        if self.loop is None:
            super().act(action)
            return
        believed = self.loop.believed
        if action is not None:  # a decision alone moves nothing: this is called again, without one, in each step
            believed.act(action)
        elif self.loop.actuated:
            Vehicle.act(self, self.loop.limit(self.loop.intend()))
        else:  # without actuators highway-env's own control, to the bit
            believed.act()
            Vehicle.act(self, self.loop.limit(dict(believed.action)))

    def step(self, dt: float) -> None:
        """Move, held by the brake where it is on."""
        stand(self, dt)
        super().step(dt)


class DirectEgo(Vehicle):  # type: ignore[misc]
    """The physical car under continuous actions: the policy commands its steering and acceleration.

    One base only: a class of several could not take over a car (CPython compares the layouts).
    """

    BASE: type[Vehicle] = Vehicle
    loop: Loop | None = None
    command: dict[str, float] | None = None

    def act(self, action: dict[str, float] | None = None) -> None:
        """Take a command, or apply the last one to the real car: the actuators follow it step by step."""
        if self.loop is None:
            self.BASE.act(self, action)
            return
        if action is not None:
            self.command = dict(action)
        else:
            self.BASE.act(self, self.loop.limit(dict(self.command or self.action)))

    def step(self, dt: float) -> None:
        """Move, held by the brake where it is on."""
        stand(self, dt)
        self.BASE.step(self, dt)

    def predict_trajectory_constant_speed(self, times: Array) -> tuple[list[Array], list[float]]:
        """As every vehicle: others predict the real car, and copies of it have no loop."""
        loop, self.loop = self.loop, None
        try:
            found: tuple[list[Array], list[float]] = self.BASE.predict_trajectory_constant_speed(self, times)
        finally:
            self.loop = loop
        return found


class BicycleEgo(BicycleVehicle):  # type: ignore[misc]
    """The same with tyre slip."""

    BASE: type[Vehicle] = BicycleVehicle
    loop: Loop | None = None
    command: dict[str, float] | None = None
    act = DirectEgo.act
    step = DirectEgo.step
    predict_trajectory_constant_speed = DirectEgo.predict_trajectory_constant_speed


EGOS: dict[type[Vehicle], type[Vehicle]] = {MDPVehicle: MetaEgo, Vehicle: DirectEgo, BicycleVehicle: BicycleEgo}


def take_over(vehicle: Vehicle, loop: Loop) -> None:
    """Connect the car that a world has made with ``loop``: its class changes, its state stays.

    Raises
    ------
    TypeError
        For a vehicle that is neither under meta-actions nor under continuous ones.
    """
    try:
        kind = EGOS[type(vehicle)]
    except KeyError:
        raise TypeError(f"the ego must be one of {[k.__name__ for k in EGOS]}, got {type(vehicle).__name__}") from None
    vehicle.__class__ = kind
    vehicle.loop = loop
