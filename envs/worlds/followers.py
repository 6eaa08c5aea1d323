"""Drivers behind the ego at the start of an episode, who react late: who stops at once on a motorway may be hit.

Each keeps its lane and drives as IDMVehicle of highway-env does, but what it decides takes effect with a lag and with
no more than some braking, ``da/dt = (max(a_IDM, -b) - a) / reaction_s``: to a leader that brakes it responds after
about that time. The first follower is on the ego's lane, the others on any lane, each behind the one before by its
length and a time gap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from pydantic import Field, model_validator

from lanebound.envs.worlds.drivers import FELT_S, CityDriver, LeadVehicle, follow_profile
from lanebound.envs.worlds.idm_parameters_kernel import STAYS
from lanebound.envs.worlds.seating import put_on_lane
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.streams import named_generator

if TYPE_CHECKING:
    from lanebound.envs.batch.lanes import LaneTable
    from lanebound.integrity.core.records import Records

__all__ = ["MOTORWAYS", "LateDriver", "PlatoonDriver", "TrafficConfig", "add_followers", "seat_followers"]

MOTORWAYS = ("highway-v0", "highway-fast-v0")
"""Worlds that have room behind the ego; elsewhere it begins at the start of a road, or has followers already."""
STREAM = "followers"
TARGET_SHARE = 0.9, 1.0  # of the limit that followers want, chosen: they do not fall far behind the ego


class TrafficConfig(Config):
    """Followers; none by default."""

    behind: int = Field(0, ge=0, le=4, description="vehicles behind the ego at the start, in Highway alone")
    gap_s: tuple[float, float] = Field(
        (0.8, 1.6), description="range of their time gaps; chosen, from short to the 1.5 s of IDM"
    )
    reaction_s: float = Field(
        1.0, gt=0, le=5, description="time constant of their reactions; chosen, brake lights take 0.7 to 1.5 s"
    )
    brake_mps2: float = Field(4.0, gt=0, le=6, description="their braking at most; as cost.brake_min_mps2")

    @model_validator(mode="after")
    def _gaps_ascend(self) -> TrafficConfig:
        low, high = self.gap_s
        if not 0.3 <= low <= high <= 10.0:
            raise ConfigError(
                f"gap_s must be two numbers from 0.3 to 10, the lower one first, got {list(self.gap_s)}: correct them"
            )
        return self


class LateDriver(IDMVehicle):  # type: ignore[misc]
    """An IDM driver whose acceleration follows what it decides with a lag.

    Attributes
    ----------
    share : of the difference that a simulation step takes up
    brake_mps2 : braking at most
    felt_mps2 : acceleration that has taken effect
    """

    share: float = 1.0
    brake_mps2: float = 6.0
    felt_mps2: float = 0.0

    def act(self, action: Any = None) -> None:
        """Decide as IDMVehicle does; the acceleration takes effect with the lag."""
        super().act(action)
        if not self.crashed:
            decided = max(float(self.action["acceleration"]), -self.brake_mps2)
            self.felt_mps2 += (decided - self.felt_mps2) * self.share
            self.action["acceleration"] = self.felt_mps2


class PlatoonDriver(LateDriver, CityDriver):
    """A city driver that reacts late, or drives a profile of speeds, as the first of a platoon does."""

    LAG_S = FELT_S
    brake_mps2 = 4.5  # chosen: enough behind the leader of Platoon, often not behind a car that brakes with 6 m/s2
    follow = LeadVehicle.follow

    def step(self, dt: float) -> None:
        """Move."""
        follow_profile(self, dt)
        super().step(dt)


class _Follower(NamedTuple):
    """Number of its lane, station on it [m], wanted speed [m/s], and exponent of its acceleration."""

    side: int
    along_m: float
    target_mps: float
    exponent: float


def _drawn(
    config: TrafficConfig, seed: int, ego: tuple[int, float, float], lanes: int, limit: float
) -> list[_Follower]:
    """Draw the followers of an episode; ego: number of its lane, station [m] and speed [m/s], which all begin with."""
    rng, (own, along, speed) = named_generator(seed, STREAM), ego
    found = []
    for k in range(config.behind):
        side = int(rng.integers(lanes))
        along -= Vehicle.LENGTH + float(rng.uniform(*config.gap_s)) * speed
        target, exponent = float(rng.uniform(*TARGET_SHARE)) * limit, float(rng.uniform(*IDMVehicle.DELTA_RANGE))
        found.append(_Follower(side if k else own, along, target, exponent))
    return found


def add_followers(world: AbstractEnv, config: TrafficConfig, seed: int) -> None:
    """Add the followers to a motorway of a single environment at the start of an episode."""
    if not config.behind:
        return
    ego, dt_s = world.vehicle, 1.0 / world.config["simulation_frequency"]
    lane = ego.lane
    start, end, own = ego.lane_index
    at = own, float(lane.local_coordinates(ego.position)[0]), float(ego.speed)
    row = world.road.network.graph[start][end]
    for one in _drawn(config, seed, at, len(row), lane.speed_limit):
        there = row[one.side]
        driver = LateDriver(
            world.road, there.position(one.along_m, 0.0), there.heading_at(one.along_m), at[2],
            target_speed=one.target_mps, enable_lane_change=False,
        )  # fmt: skip
        driver.DELTA, driver.brake_mps2 = one.exponent, config.brake_mps2
        driver.share = min(dt_s / config.reaction_s, 1.0)
        world.road.vehicles.append(driver)


def seat_followers(
    config: TrafficConfig, seed: int, cars: Records, drivers: Records, count: int, table: LaneTable, network: Any
) -> int:
    """Put the followers behind ``count`` vehicles (V,) CAR and DRIVER of the engine; returns the number after that."""
    if not config.behind:
        return count
    own = table.lanes.table[int(cars["lane"][0])]
    at = int(own["side"]), float(cars["x"][0] - own["x_m"]), float(cars["speed"][0])
    start, end, _ = table.index[int(cars["lane"][0])]
    followers = _drawn(config, seed, at, int(own["count"]), float(own["speed_limit_mps"]))
    for i, one in enumerate(followers, count):
        lane = network.get_lane((start, end, one.side))
        put_on_lane(cars[i], drivers[i], table, lane, one.along_m, at[2], one.target_mps, one.exponent)
        drivers["lag_s"][i], drivers["brake_mps2"][i] = config.reaction_s, config.brake_mps2
        drivers["timer"][i] = STAYS
    return count + len(followers)
