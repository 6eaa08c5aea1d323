"""The platoon of :class:`~.ids.platoon.Platoon` with several agents, as a parallel environment of PettingZoo."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lanebound.envs.belief_loop import BeliefLoop
from lanebound.envs.config import ActionKind
from lanebound.envs.core import OPTIONS
from lanebound.envs.fleet import FleetLoop
from lanebound.envs.ids.platoon import Platoon
from lanebound.envs.observation import Observer
from lanebound.envs.scene import set_scene
from lanebound.envs.world import checked_command
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.records import Records
from lanebound.integrity.sensors.faults import Fault

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise InputError(
        "lanebound.envs.multiagent needs the extra multiagent: pip install 'lanebound[multiagent]'"
    ) from error

__all__ = ["PlatoonAgents", "parallel_env"]

BRAKE = np.array([-1.0, 0.0], dtype=np.float32)  # the command of a car whose agent has left
FIRST = 1  # place of the first car, whose row is 1 as well: it is never the ego of Platoon


def parallel_env(
    config: Mapping[str, Any] | None = None, agents: Iterable[int] | None = None, render_mode: str | None = None
) -> PlatoonAgents:
    """The platoon with several agents; arguments as for :class:`PlatoonAgents`."""
    return PlatoonAgents(config, agents, render_mode)


class _Cars(Platoon):
    """The platoon whose step takes commands by row; ``agents``: rows of those that are commanded."""

    def __init__(self, config: Mapping[str, Any] | None, render_mode: str | None) -> None:
        super().__init__(config, render_mode)
        c, others = self.config, self.world.most_vehicles(self.world.config) - 1
        self.agents: list[int] = []
        for name, bad, allowed, given in (
            ("action", c.action is not ActionKind.CONTINUOUS, "'continuous'", c.action.value),
            ("perception.others", c.perception.others != "full", "'full', as agents navigate,", c.perception.others),
            ("slots", c.slots < others, f"{others} or more, as many as others there are,", c.slots),
        ):
            if bad:
                raise ConfigError(f"{name} must be {allowed} with several agents, got {given!r}: leave it out")

    def _begin(self, seed: int, faults: tuple[Fault, ...] | None) -> BeliefLoop:
        """Put cars that can be commanded in the places of the drivers that agents replace."""
        world, vehicles = self.world, self.world.road.vehicles
        speeds = {FIRST: vehicles[FIRST].profile_mps} if FIRST in self.agents else {}
        for row in self.agents:
            if (old := vehicles[row]) is not world.vehicle:
                vehicles[row] = world.action_type.vehicle_class(world.road, old.position, old.heading, old.speed)
        context = set_scene(world, self.config, seed, faults, fleet=True)
        return FleetLoop(world, self.config, context, self.agents, speeds)

    def step_all(self, commands: Mapping[int, Any]) -> Records:
        """Carry out the commands of all agents.  -> OUTCOME of each row"""
        loop = self._loop()
        self.advance(loop, commands)
        self._show(loop.info)
        return loop.episodes.ego["outcome"]

    def seen_by(self, row: int, observer: Observer) -> tuple[Any, dict[str, Any]]:
        """The observation and the info of a row."""
        return self._observe(row, observer), self._loop().info_of(row)


class PlatoonAgents(ParallelEnv):  # type: ignore[misc]
    """The platoon of ``lanebound/Platoon-v0`` in which several vehicles or all are agents.

    The agents are ``vehicle_1``, the first of the platoon, ``vehicle_2`` and so on. Each has its own navigator, belief,
    perception of the others by radio, alert, reward and cost (``infos[agent]["cost"]``); spaces, observations, rewards,
    costs and infos are those of ``lanebound/Platoon-v0`` with that vehicle as the ego. What an agent believes of itself
    is what it broadcasts. Of the action of ``vehicle_1`` the steering counts alone: it drives at the commanded speeds,
    with changes that follow a time constant of 0.25 s, by its own odometer.

    An agent leaves (``terminations``) where an episode of Platoon ends: with a crash, off the road, against its lane.
    Its car brakes, and stays. All others leave when time is up (``truncations``).

    Parameters
    ----------
    config : merged deeply over the configuration of ``lanebound/Platoon-v0``; commands are continuous
    agents : places of the agents, 1 for the first, the ego of Platoon among them (``world.place``, the middle); None:
        all. The other vehicles drive by the law of Platoon's traffic: with the ego alone as agent all numbers are those
        of Platoon, where it perceives by radio
    render_mode : as for ``lanebound/Platoon-v0``, whose ego is shown

    Raises
    ------
    ConfigError
        A configuration that several agents cannot have.
    InputError
        Places that do not exist.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["human", "rgb_array"], "name": "lanebound_platoon_v0"}

    def __init__(
        self, config: Mapping[str, Any] | None = None, agents: Iterable[int] | None = None,
        render_mode: str | None = None,
    ) -> None:  # fmt: skip
        self._cars, self.render_mode = _Cars(config, render_mode), render_mode
        world, made = self._cars.world, self._cars.config
        places, ego = range(1, world.most_vehicles(world.config) + 1), world.place
        chosen = sorted({*places} if agents is None else {*agents})
        if ego not in chosen or not {*chosen} <= {*places}:
            raise InputError(
                f"agents must be places from 1 to {places[-1]}, {ego} among them, got {chosen}: correct them"
            )
        self._rows = {f"vehicle_{place}": 0 if place == ego else place - (place > ego) for place in chosen}
        self._cars.agents = sorted(self._rows.values())
        self.possible_agents, self.agents = list(self._rows), list[str]()
        self._observers = {agent: Observer(made.observation) for agent in self._rows}
        self.observation_spaces = {agent: observer.space for agent, observer in self._observers.items()}
        self.action_spaces = {agent: deepcopy(self._cars.action_space) for agent in self._rows}

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        """The space of the observations of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """The space of the actions of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
        """Begin an episode; ``options``: ``faults``, of vehicle 0, the ego of Platoon, or another one.

        Other options are ignored, as PettingZoo's test of its interface demands.
        """
        given = {name: value for name, value in (options or {}).items() if name in OPTIONS}
        self._cars.reset(seed=seed, options=given)
        self.agents = list(self.possible_agents)
        for observer in self._observers.values():
            observer.reset()
        return self._seen()

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Carry out the commands of all agents that are there until the next decision.

        Raises
        ------
        InputError
            Before the first reset, without the command of an agent, or with one outside its space.
        """
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise InputError(f"actions must have one of each agent, got none of {', '.join(missing)}: add it")
        commands = dict.fromkeys(self._rows.values(), BRAKE)
        commands |= {self._rows[a]: checked_command(self.action_spaces[a], actions[a]) for a in self.agents}
        outcome, rows = self._cars.step_all(commands), {agent: self._rows[agent] for agent in self.agents}
        observations, infos = self._seen()
        rewards = {agent: float(outcome["reward"][row]) for agent, row in rows.items()}
        terminated = {agent: bool(outcome["terminated"][row] > 0.0) for agent, row in rows.items()}
        truncated = {agent: bool(outcome["truncated"][row] > 0.0) for agent, row in rows.items()}
        self.agents = [agent for agent in self.agents if not (terminated[agent] or truncated[agent])]
        return observations, rewards, terminated, truncated, infos

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of now around the ego of Platoon."""
        return self._cars.render()

    def close(self) -> None:
        """Close the window, if any."""
        self._cars.close()

    def _seen(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Observations and infos of the agents that are there."""
        seen = {agent: self._cars.seen_by(self._rows[agent], self._observers[agent]) for agent in self.agents}
        return {agent: one for agent, (one, _) in seen.items()}, {agent: info for agent, (_, info) in seen.items()}
