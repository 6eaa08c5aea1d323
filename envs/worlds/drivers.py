"""The other vehicles: a lead vehicle in stop-and-go traffic, city drivers, drivers at an intersection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray
from pydantic import field_validator

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.idm_parameters_kernel import (
    CALM,
    LINE_BRAKE_MPS2,
    LINE_M,
    LINE_S,
    REACTION_S,
    START_MPS2,
)
from lanebound.envs.worlds.networks import StreetNetwork, advance
from lanebound.integrity.core.config import Config, Field

__all__ = ["CityDriver", "IntersectionDriver", "LeadVehicle", "SpeedProfileConfig", "follow_all", "follow_profile",
           "slow_for_bends", "speed_profile"]  # fmt: skip

Array = NDArray[np.float64]
FELT_S = 1.0  # lag of the vehicles of a platoon, as of late drivers
HARD_MPS2 = 8.0  # their braking at most; emergency braking on a dry road
FREE_MPS = 50.0 / 3.6  # which they want on a free road


class SpeedProfileConfig(Config):
    """Speed of a lead vehicle in town: acceleration, cruise, braking and standstill, in random phases.

    Ranges are those of uniform distributions from which the phases are drawn.
    """

    cruise_mps: tuple[float, float] = Field((5.0, 13.9), description="speed of a cruise; at most 50 km/h [m/s]")
    cruise_s: tuple[float, float] = Field((3.0, 15.0), description="length of a cruise [s]")
    stop_probability: float = Field(0.45, ge=0, le=1, description="that a cruise ends in a stop [-]")
    hard_probability: float = Field(0.35, ge=0, le=1, description="that a deceleration is hard braking [-]")
    stand_s: tuple[float, float] = Field((2.0, 18.0), description="length of a standstill [s]")
    accelerate_mps2: tuple[float, float] = Field((0.8, 1.7), description="speeding up in town [m/s2]")
    brake_mps2: tuple[float, float] = Field((1.0, 2.5), description="braking in comfort [m/s2]")
    hard_brake_mps2: tuple[float, float] = Field((2.5, 6.0), description="hard braking [m/s2]")
    jerk_mps3: float = Field(2.5, gt=0, description="of changes of acceleration in comfort [m/s3]")
    hard_jerk_mps3: float = Field(12.0, gt=0, description="when hard braking begins [m/s3]")

    @field_validator("cruise_mps", "cruise_s", "stand_s", "accelerate_mps2", "brake_mps2", "hard_brake_mps2")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        low, high = value
        if not 0.0 < low <= high:
            raise ValueError(f"must be two numbers with 0 < low <= high, got {low} and {high}: correct the range")
        return value


def speed_profile(
    rng: np.random.Generator, duration_s: float, dt_s: float, config: SpeedProfileConfig | None = None
) -> Array:
    """Draw speeds of a lead vehicle at 0, dt, 2 dt, ... until the duration has passed.  -> (n + 1,) [m/s].

    The first phase is a cruise. The acceleration follows that of the phase within the jerk limit, and decreases near
    the target speed of the phase to avoid overshoot; the speed at standstill is exactly 0.
    """
    c = config or SpeedProfileConfig()
    count = int(np.ceil(duration_s / dt_s)) + 1
    target = rng.uniform(*c.cruise_mps)
    speeds, acceleration = [target] * (int(rng.uniform(*c.cruise_s) / dt_s) + 1), 0.0
    while len(speeds) < count:
        stop = bool(speeds[-1] > 0.0 and rng.random() < c.stop_probability)
        target = 0.0 if stop else rng.uniform(*c.cruise_mps)
        hard = bool(rng.random() < c.hard_probability) and target < speeds[-1]
        rate = rng.uniform(*(c.hard_brake_mps2 if hard else c.brake_mps2 if target < speeds[-1] else c.accelerate_mps2))
        jerk = c.hard_jerk_mps3 if hard else c.jerk_mps3
        while speeds[-1] != target and len(speeds) < count:
            speed, acceleration = _towards(speeds[-1], acceleration, target, rate, jerk, dt_s)
            speeds.append(speed)
        acceleration = 0.0
        speeds += [target] * int(rng.uniform(*(c.stand_s if stop else c.cruise_s)) / dt_s)
    return np.array(speeds[:count])


def _towards(
    speed: float, acceleration: float, target: float, rate: float, jerk: float, dt: float
) -> tuple[float, float]:
    """One step of speed and acceleration to a target; ``a^2 / (2 j)`` is the change of speed until ``a`` is 0."""
    sign = 1.0 if target > speed else -1.0
    left = abs(target - speed)
    pace = max(sign * acceleration, 0.0)
    wished = min(rate, np.sqrt(2.0 * jerk * left))
    pace = float(max(min(wished, pace + jerk * dt), jerk * dt))
    if pace * dt >= left:
        return target, sign * pace
    return speed + sign * pace * dt, sign * pace


def follow_all(speeds: Array, gaps_m: Sequence[float], dt_s: float) -> Array:
    """Speeds of the vehicles of a platoon, the last one first, behind one with ``speeds`` (S,).  -> (K, S) [m/s].

    Each follows the one ahead by IDM with the parameters :data:`CALM`; what it decides takes effect with a lag, ``da/dt
    = (max(a_IDM, -b) - a) / FELT_S``, as the followers of :mod:`.followers` react. Where the vehicle ahead brakes hard,
    those behind it brake later.

    Parameters
    ----------
    gaps_m : (K - 1,) between bumpers at the start, the last vehicle first
    """
    rows = [speeds]
    for gap in reversed(gaps_m):
        ahead, speed, felt, own = rows[-1], float(rows[-1][0]), 0.0, [float(rows[-1][0])]
        for k in range(1, len(speeds)):
            wanted = CALM.gap_m - LeadVehicle.LENGTH + speed * CALM.headway_s
            wanted += speed * (speed - ahead[k - 1]) / CALM.twice_root
            decided = CALM.comfort * (1.0 - (speed / FREE_MPS) ** 4 - (max(wanted, 0.0) / max(gap, 0.1)) ** 2)
            felt += (max(decided, -HARD_MPS2) - felt) * min(dt_s / FELT_S, 1.0)
            felt = max(felt, -speed / dt_s)
            gap += (0.5 * (ahead[k - 1] + ahead[k]) - speed - 0.5 * felt * dt_s) * dt_s
            speed = max(speed + felt * dt_s, 0.0)
            own.append(speed)
        rows.append(np.array(own))
    return np.array(rows[::-1])


def slow_for_bends(speeds: Array, network: StreetNetwork, index: LaneIndex, along_m: float, dt_s: float) -> Array:
    """Speeds of a profile (S,) as a vehicle drives them from a place on: slower in bends, as :class:`CityDriver` is.

    After a bend it speeds up with at most the comfortable acceleration :data:`CALM`.
    """
    out = [min(float(speeds[0]), network.get_lane(index).advised_speed(along_m))]
    for wanted in speeds[1:].tolist():
        speed = out[-1]
        there, s = advance(network, index, along_m, speed * REACTION_S)
        most = min(CALM.comfort, (network.get_lane(there).advised_speed(s) - speed) / REACTION_S)
        out.append(max(min(wanted, speed + most * dt_s), 0.0))
        index, along_m = advance(network, index, along_m, 0.5 * (speed + out[-1]) * dt_s)
    return np.array(out)


class LeadVehicle(ControlledVehicle):  # type: ignore[misc]
    """A vehicle that keeps its lane and drives a speed profile; it ignores all other vehicles."""

    def follow(self, speeds_mps: Array) -> None:
        """Set the speeds of the simulation steps from now on; the last one is held."""
        self.profile_mps: Array = speeds_mps
        self.steps_driven = 0
        self.speed = float(speeds_mps[0])

    def step(self, dt: float) -> None:
        """Move with the acceleration to the next speed of the profile; a crashed vehicle brakes as in highway-env."""
        follow_profile(self, dt)
        super().step(dt)


def follow_profile(vehicle: Vehicle, dt: float) -> None:
    """Command the acceleration to the next speed of the profile of a vehicle, if it has one."""
    profile = getattr(vehicle, "profile_mps", None)
    if profile is not None:
        vehicle.steps_driven = min(vehicle.steps_driven + 1, len(profile) - 1)
        vehicle.action["acceleration"] = (float(profile[vehicle.steps_driven]) - vehicle.speed) / dt


class CityDriver(IDMVehicle):  # type: ignore[misc]
    """An IDM driver with the parameters :data:`CALM` that slows down for bends where the lane advises a speed."""

    DISTANCE_WANTED = CALM.gap_m
    TIME_WANTED = CALM.headway_s
    COMFORT_ACC_MAX = CALM.comfort
    COMFORT_ACC_MIN = -CALM.deceleration
    LANE_CHANGE_DELAY = CALM.delay_s
    LANE_CHANGE_MIN_ACC_GAIN = CALM.gain
    REACTION_S = REACTION_S
    STOPS = True

    def acceleration(
        self, ego_vehicle: Vehicle | None, front_vehicle: Vehicle | None = None, rear_vehicle: Vehicle | None = None
    ) -> float:
        """The acceleration of IDM, limited by the advised speed at the place after the reaction time."""
        free = float(super().acceleration(ego_vehicle, front_vehicle, rear_vehicle))
        advised_speed = getattr(self.lane, "advised_speed", None)
        if ego_vehicle is not self or advised_speed is None:
            return free
        s = self.lane.local_coordinates(self.position)[0]
        advised = advised_speed(s + max(self.speed, 0.0) * self.REACTION_S)
        return min(free, float((advised - self.speed) / self.REACTION_S))

    def step(self, dt: float) -> None:
        """Move; braking ends at standstill, because IDM alone would reverse."""
        _stop_at_rest(self, dt)
        super().step(dt)


class IntersectionDriver(IDMVehicle):  # type: ignore[misc]
    """An IDM driver that never reverses, and waits before the crossing until it may enter.

    A class of its own, because highway-env's intersection changes its constants. highway-env's own drivers reverse
    where the gap ahead is shorter than the desired one. At a crossing they then back into those behind them. In
    ``intersection-v2`` they also follow vehicles that come towards them: the exit of an arm ends at the node where
    its approach begins, so the approach counts as the lane that goes on from the exit. Beside a vehicle that waits at
    the crossing, one that leaves it then stops for good, and all others behind it. They also follow vehicles that
    cross any of the ways that go on from their approach.

    Attributes
    ----------
    movement : approach and exit of its way through the crossing, set by :class:`.crossing.CrossingRoad`
    may_enter : whether it goes through, set by that road
    """

    STOPS = True
    MOST_MPS2 = START_MPS2
    movement: tuple[str, str] | None = None
    may_enter: bool = False

    def to_line_m(self) -> float:
        """Distance from its bumper to the crossing; not positive once it is beyond."""
        if not self.lane_index[1].startswith("ir"):
            return 0.0
        return float(self.lane.length - self.lane.local_coordinates(self.position)[0] - 0.5 * self.LENGTH)

    def stops_in_time(self) -> bool:
        """Whether it can still stop before the crossing."""
        return bool(self.to_line_m() - LINE_M >= 0.5 * self.speed**2 / LINE_BRAKE_MPS2)

    def acceleration(
        self, ego_vehicle: Vehicle | None, front_vehicle: Vehicle | None = None, rear_vehicle: Vehicle | None = None
    ) -> float:
        """The acceleration of IDM behind a vehicle that drives ahead, bounded, and a stop where it may not enter.

        Neither a vehicle on the approach of the arm into which it leaves is ahead, nor another driver whose way only
        crosses its own.
        """
        both = ego_vehicle is not None and front_vehicle is not None
        if both and (_comes_towards(ego_vehicle, front_vehicle) or _crosses(ego_vehicle, front_vehicle)):
            front_vehicle = None
        free = min(float(super().acceleration(ego_vehicle, front_vehicle, rear_vehicle)), START_MPS2)
        line = self.to_line_m()
        if ego_vehicle is not self or self.may_enter or line <= 0.0:
            return free
        wanted = np.sqrt(2.0 * LINE_BRAKE_MPS2 * max(line - LINE_M, 0.0))
        return min(free, float((wanted - self.speed) / LINE_S))

    def step(self, dt: float) -> None:
        """Move; braking ends at standstill."""
        _stop_at_rest(self, dt)
        super().step(dt)


def _comes_towards(vehicle: Vehicle, other: Vehicle) -> bool:
    """Whether a vehicle on an exit of the crossing meets one on the approach of the same arm, head on.

    One that still turns into the exit may also face it for a while, and is followed: its lane is no approach.
    """
    node = vehicle.lane_index[1]
    approaching = node.startswith("o") and other.lane_index is not None and other.lane_index[0] == node
    return bool(approaching and np.cos(vehicle.heading - other.heading) < 0.0)


def _crosses(vehicle: Vehicle, other: Vehicle) -> bool:
    """Whether another driver inside the crossing comes from another approach and leaves by another exit."""
    own, theirs = getattr(vehicle, "movement", None), getattr(other, "movement", None)
    if own is None or theirs is None or not other.lane_index[0].startswith("ir"):
        return False
    return bool(own[0] != theirs[0] and own[1] != theirs[1])


def _stop_at_rest(vehicle: IDMVehicle, dt: float) -> None:
    """Bound the braking of a vehicle that has not crashed, so that its speed is 0 at least after a step."""
    if not vehicle.crashed:
        vehicle.action["acceleration"] = max(vehicle.action["acceleration"], -vehicle.speed / dt)
