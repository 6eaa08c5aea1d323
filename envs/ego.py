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


class BelievedVehicle(MDPVehicle):  # type: ignore[misc]
    """The car where its navigation says it is; never stepped, only placed."""

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
        Vehicle.act(self, self.cockpit.limit(dict(believed.action)))

    def step(self, dt: float) -> None:
        """Move, and tell the cockpit."""
        super().step(dt)
        if self.cockpit is not None:
            self.cockpit.moved()


class DirectEgo(Vehicle):  # type: ignore[misc]
    """The physical car under continuous actions: the policy commands its steering and acceleration.

    One base only: a class of several could not take over a car (CPython compares the layouts).
    """

    BASE: type[Vehicle] = Vehicle
    cockpit: Cockpit | None = None

    def act(self, action: dict[str, float] | None = None) -> None:
        """Apply the command to the real car."""
        if self.cockpit is not None:
            self.cockpit.look()
            action = self.cockpit.limit(dict(action or self.action))
        self.BASE.act(self, action)

    def step(self, dt: float) -> None:
        """Move, and tell the cockpit."""
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
