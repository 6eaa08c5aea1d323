"""A world in which each car drives on its own belief: one of several agents, or by the law of the world's traffic."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.belief_loop import BeliefLoop, WorldStep
from lanebound.envs.config import EnvConfig
from lanebound.envs.ego import take_over
from lanebound.envs.scene import EpisodeContext

__all__ = ["FleetLoop"]

LEAD_S = 0.25  # time constant with which a car takes up its commanded speed; chosen


class _Seat(NamedTuple):
    """What the physical car of another row than the first calls."""

    limit: Callable[[dict[str, float]], dict[str, float]]


class FleetLoop(BeliefLoop):
    """The loop of all cars of a world, each the ego of a row of ``episodes``: the world's own ego, then the others.

    Commands are continuous, by row.

    Parameters
    ----------
    context : made for a fleet
    agents : rows of the cars that are commanded, the first one among them; the others drive as the world's traffic
    speeds_mps : (S,) by row, commanded speeds at the ends of simulation steps, which replace commanded accelerations
    """

    def __init__(
        self,
        world: AbstractEnv,
        config: EnvConfig,
        context: EpisodeContext,
        agents: list[int],
        speeds_mps: Mapping[int, NDArray[Any]],
    ) -> None:
        others = [vehicle for vehicle in world.road.vehicles if vehicle is not world.vehicle]
        for row in agents:
            if row > 0:
                take_over(others[row - 1], _Seat(partial(self._limit_of, row)))  # type: ignore[arg-type]
        self._speeds_mps = speeds_mps
        super().__init__(world, config, context)
        for values in self.episodes.own_info.values():  # the one fault of an episode
            values[:] = values[0]

    @property
    def cars(self) -> list[Vehicle]:
        """All cars."""
        return self.seats.vehicles

    def step_world(self, command: Mapping[int, Any]) -> list[WorldStep]:
        """A policy step of the wrapped world; its end rules and reward for each car as its ego."""
        super().step_world(command)
        world, ends, first = self.world, list[WorldStep](), self.ego
        for car in self.cars:
            world.vehicle = car
            over = bool(world._is_terminated()), bool(world._is_truncated())
            ends.append(WorldStep(*over, float(world._reward(None))))
        world.vehicle = first
        return ends

    def command(self, command: Mapping[int, Any]) -> None:
        """Pass the commands of the agents on."""
        inner, cars = self.world.action_type, self.cars
        for row, one in command.items():
            inner.controlled_vehicle = cars[row]
            inner.act(one)
        inner.controlled_vehicle = None

    def _limit_of(self, row: int, action: dict[str, float]) -> dict[str, float]:
        """A command of a car as its actuators carry it out."""
        speeds = self._speeds_mps.get(row)
        if speeds is not None:
            low, high = self.world.action_type.acceleration_range
            wanted = float(speeds[min(self._steps + 1, len(speeds) - 1)])
            speed = float(self.episodes.ego["belief"]["speed_mps"][row])
            action = {**action, "acceleration": min(max((wanted - speed) / LEAD_S, low), high)}
        return self.limit(action, row)
