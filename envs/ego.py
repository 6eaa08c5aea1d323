"""The ego car: a physical vehicle whose driver acts on a believed one.

highway-env's low-level control, lane indices and routes read the vehicle's own pose, which is the truth. Here the
physical vehicle keeps the truth and the dynamics; what it intends and commands comes from a believed vehicle, placed
on a perceived road where navigation says that the car is.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.actuators import HOLD
from lanebound.envs.pursuit import pursuit_rad
from lanebound.envs.records import LaneIndex

__all__ = ["BelievedVehicle", "BicycleEgo", "Cockpit", "DirectEgo", "MetaEgo", "take_over"]

Array = NDArray[np.float64]


class Cockpit(Protocol):
    """What the physical ego asks of whoever sits in it."""

    believed: BelievedVehicle

    def look(self) -> None:
        """Bring the belief up to date; called before anything is decided."""

    def moved(self) -> None:
        """The car has moved by one simulation step; called before the others have."""

    def limit(self, action: dict[str, float]) -> dict[str, float]:
        """What the actuators make of a command."""


ROUTE_M = 2.0  # half a lane of highway-env's: by so much a lane of the route may be further off than another


class BelievedVehicle(MDPVehicle):  # type: ignore[misc]
    """The car where its navigation says it is; never stepped, only placed.

    Attributes
    ----------
    pursues : whether it steers as wheels of a limited rate allow, not by highway-env's own law
    """

    lane_index: LaneIndex
    pursues: bool = False

    def steering_control(self, target_lane_index: LaneIndex) -> float:
        """Steering angle that leads to the middle of a lane."""
        if self.pursues:
            return pursuit_rad(self.road.network, target_lane_index, self.route, self)
        return float(super().steering_control(target_lane_index))

    def on_state_update(self) -> None:
        """Find the lane: highway-env's nearest, but that of a planned route where others cross or part from it."""
        planned = {self.lane_index[:2], self.target_lane_index[:2], *(step[:2] for step in self.route or ())}
        super().on_state_update()
        if self.route and self.lane_index[:2] not in planned:
            self.lane_index = self._lane_beside(planned)
            self.lane = self.road.network.get_lane(self.lane_index)

    def _lane_beside(self, planned: set[tuple[str, str]]) -> LaneIndex:
        """The nearest lane, where one that is not planned counts as ``ROUTE_M`` further off."""
        away: dict[LaneIndex, float] = {}
        for start, ends in self.road.network.graph.items():
            for end, lanes in ends.items():
                extra = 0.0 if (start, end) in planned else ROUTE_M
                for i, lane in enumerate(lanes):
                    away[start, end, i] = lane.distance_with_heading(self.position, self.heading) + extra
        return min(away, key=away.__getitem__)

    def place(self, position_m: Array, heading_rad: float, speed_mps: float) -> None:
        """Move to an estimate and find its lane."""
        self.position, self.heading, self.speed = position_m, heading_rad, speed_mps
        self.on_state_update()

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
    """Where the actuators hold the brake, let it work against the wheels' true motion: highway-env's cars have none.

    Without it a car whose odometer shows 0 would creep on for ever at the speed that is too small to be measured.
    """
    bound = vehicle.action.pop(HOLD, None)
    if bound is not None:
        vehicle.action["acceleration"] = min(max(-vehicle.speed / dt_s, -bound), bound)


def _delegated(name: str) -> Any:
    """A property kept by the believed vehicle as soon as there is one."""

    def get(self: MetaEgo) -> Any:
        return self.__dict__[name] if self.cockpit is None else getattr(self.cockpit.believed, name)

    def put(self: MetaEgo, value: Any) -> None:
        if self.cockpit is None:
            self.__dict__[name] = value
        else:
            setattr(self.cockpit.believed, name, value)

    return property(get, put, doc=f"``{name}`` of the believed vehicle")


class MetaEgo(MDPVehicle):  # type: ignore[misc]
    """The physical car under meta-actions: lane, speed and route are intents of the believed vehicle."""

    cockpit: Cockpit | None = None
    target_lane_index = _delegated("target_lane_index")
    target_speed = _delegated("target_speed")
    speed_index = _delegated("speed_index")
    route = _delegated("route")

    def act(self, action: dict[str, float] | str | None = None) -> None:
        """Let the believed vehicle decide and steer, and apply its command to the real car."""
        if self.cockpit is None:
            super().act(action)
            return
        self.cockpit.look()
        believed = self.cockpit.believed
        believed.act(action)
        if action is None:  # a decision alone moves nothing: this is called again, without one, in each step
            Vehicle.act(self, self.cockpit.limit(dict(believed.action)))

    def step(self, dt: float) -> None:
        """Move, and tell the cockpit."""
        stand(self, dt)
        super().step(dt)
        if self.cockpit is not None:
            self.cockpit.moved()


class DirectEgo(Vehicle):  # type: ignore[misc]
    """The physical car under continuous actions: the policy commands its steering and acceleration.

    One base only: a class of several could not take over a car (CPython compares the layouts).
    """

    BASE: type[Vehicle] = Vehicle
    cockpit: Cockpit | None = None
    command: dict[str, float] | None = None

    def act(self, action: dict[str, float] | None = None) -> None:
        """Take a command, or apply the last one to the real car: the actuators follow it step by step."""
        if self.cockpit is None:
            self.BASE.act(self, action)
            return
        self.cockpit.look()
        if action is not None:
            self.command = dict(action)
        else:
            self.BASE.act(self, self.cockpit.limit(dict(self.command or self.action)))

    def step(self, dt: float) -> None:
        """Move, and tell the cockpit."""
        stand(self, dt)
        self.BASE.step(self, dt)
        if self.cockpit is not None:
            self.cockpit.moved()

    def predict_trajectory_constant_speed(self, times: Array) -> tuple[list[Array], list[float]]:
        """As every vehicle: others predict the real car, and no copy of it has a cockpit."""
        cockpit, self.cockpit = self.cockpit, None
        try:
            found: tuple[list[Array], list[float]] = self.BASE.predict_trajectory_constant_speed(self, times)
        finally:
            self.cockpit = cockpit
        return found


class BicycleEgo(BicycleVehicle):  # type: ignore[misc]
    """The same with tyre slip."""

    BASE: type[Vehicle] = BicycleVehicle
    cockpit: Cockpit | None = None
    command: dict[str, float] | None = None
    act = DirectEgo.act
    step = DirectEgo.step
    predict_trajectory_constant_speed = DirectEgo.predict_trajectory_constant_speed


EGOS: dict[type[Vehicle], type[Vehicle]] = {MDPVehicle: MetaEgo, Vehicle: DirectEgo, BicycleVehicle: BicycleEgo}


def take_over(vehicle: Vehicle, cockpit: Cockpit) -> None:
    """Put ``cockpit`` into the car that a world has made: its class changes, its state stays.

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
    vehicle.cockpit = cockpit
