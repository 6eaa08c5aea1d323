"""The loop of a single environment from the true world to the belief of the ego, and from the belief to commands.

After each simulation step the belief follows before any decision: :meth:`BeliefLoop.sense`, :meth:`BeliefLoop.locate`
and :meth:`BeliefLoop.perceive`. The only true values that they read are the poses of the vehicles, from which sensor
data are simulated. The formulas are those of :mod:`lanebound.envs.batch`, at one row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.batch import ego_kernel
from lanebound.envs.batch.belief_kernel import locate
from lanebound.envs.batch.infos import info_of
from lanebound.envs.batch.lanes_kernel import NONE, closest
from lanebound.envs.batch.next_lane_kernel import ROUTE_M
from lanebound.envs.config import EnvConfig
from lanebound.envs.ego import HOLD, BelievedVehicle, MetaEgo, take_over
from lanebound.envs.lane_search import fast_network
from lanebound.envs.navigation import Source
from lanebound.envs.records import EgoBelief, LaneIndex, Traffic
from lanebound.envs.scene import EpisodeContext
from lanebound.envs.seats import Seats
from lanebound.envs.worlds import world_kind
from lanebound.envs.worlds.closures import announce
from lanebound.envs.worlds.tolling import ClaimAction, levy
from lanebound.envs.worlds.wander import Wander
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.navigator import Measurements
from lanebound.integrity.navigators.solution import Solution

__all__ = ["BeliefLoop", "WorldStep"]


class WorldStep(NamedTuple):
    """What the wrapped world says of a policy step: its end rules, and its own reward."""

    terminated: bool
    truncated: bool
    reward: float


class BeliefLoop:
    """Sensing, belief and commands of the ego during one episode.

    Attributes
    ----------
    believed : the vehicle that meta-actions control, on its own perceived road over the shared network
    episodes : belief, perception and scores as records, of one row but for a fleet
    rows : 0, 1, ..., those rows
    """

    def __init__(self, world: AbstractEnv, config: EnvConfig, context: EpisodeContext) -> None:
        self.world, self.config, self.context = world, config, context
        self.episodes, self.street = context.episodes, context.street
        world.road.network = fast_network(world.road.network, self.episodes.table)
        self.step_s, self.epoch_s = (float(self.episodes.rules[name][0]) for name in ("step_s", "epoch_s"))
        self.steps_per_epoch = config.navigation.steps_per_epoch(config.simulation_hz)
        self._steps, self.rows = 0, np.arange(len(self.episodes.cars))
        self.actuated = config.actuators is not None
        self._onward: dict[tuple[LaneIndex, tuple[Any, ...]], int] = {}
        ego = world.vehicle
        self.believed = BelievedVehicle.of(ego, self._perceived_road())
        # From here highway-env calls back: World.step runs self.simulate in place of its own _simulate; Road.act and
        # Road.step move the ego by DirectEgo or MetaEgo, by which its class is replaced.
        take_over(ego, self)
        world._simulate = self.simulate
        wander = Wander(config.wander, context.seed, self.step_s)
        self.seats = Seats(world, self.episodes, int(context.starts.fleet_seed[0]), wander)
        self.seats.read(full=True)
        if (closure := getattr(world, "closure", None)) is not None:
            record, radio = self.episodes.ego["closure"][0], config.perception.v2v
            announce(record, self.episodes.table, world.road.network, closure, radio, context.seed)
        levy(self.episodes.ego["toll"], 0, self.episodes.table, getattr(world, "tolled", ()))
        there = np.ones((self.rows.size, self.seats.capacity), dtype=np.bool_)
        self.episodes.begin(self.rows, context.seeds, context.starts, there)
        if self.meta:
            self._body["target_speed_mps"] = self.episodes.ego["belief"]["target_speed_mps"] = (
                self.believed.target_speed
            )
        self._place()

    def _perceived_road(self) -> Road:
        """A road over the same network, with a generator of its own, and no vehicle on it but the believed one."""
        road = self.world.road
        return Road(
            network=road.network,
            np_random=np.random.default_rng(0),  # next_lane takes one and draws nothing
            neighbour_vehicles_connected_lanes=road.neighbour_vehicles_connected_lanes,
        )

    @property
    def ego(self) -> Vehicle:
        """The physical car, for scoring."""
        return self.world.vehicle

    @property
    def cars(self) -> list[Vehicle]:
        """The physical car of each row of ``episodes``."""
        return [self.ego]

    @property
    def meta(self) -> bool:
        """Whether the ego is under meta-actions."""
        return isinstance(self.ego, MetaEgo)

    @property
    def route(self) -> list[Any] | None:
        """The planned route; None to follow the lane."""
        route: list[Any] | None = self.believed.route
        return route

    @property
    def measurements(self) -> Measurements | None:
        """Measurements of all navigating vehicles at the last epoch, the ego first; None without any."""
        return None if self.episodes.navigation is None else self.episodes.navigation.measurements

    @property
    def solution(self) -> Solution | None:
        """Of all navigating vehicles at the last epoch, the ego first, then by slot; None before and without any."""
        return None if self.episodes.navigation is None else self.episodes.navigation.solution

    @property
    def time_s(self) -> float:
        """Since the start [s]."""
        return self._steps * self.step_s

    @property
    def _ends_epoch(self) -> bool:
        """Whether the last simulation step ended an epoch."""
        return self._steps % self.steps_per_epoch == 0

    @property
    def _body(self) -> Records:
        """(1,) BELIEF by which the car moves in its lane: of the camera where there is one."""
        return self.episodes.ego["belief" if self.config.lane_sensor is None else "eye"]

    # A policy step

    def step_world(self, command: Any) -> list[WorldStep]:
        """A policy step of the wrapped world, simulated by :meth:`simulate`; how it ends for each of ``cars``."""
        if isinstance(self.world.action_type, ClaimAction):
            self.episodes.ego["command"]["claim"] = command
        _, reward, terminated, truncated, _ = self.world.step(command)
        return [WorldStep(bool(terminated), bool(truncated), float(reward))]

    def simulate(self, command: Any = None) -> None:
        """Drive all simulation steps of a policy step; the belief follows each but the last."""
        for frame in range(self.config.simulation_hz // self.config.policy_hz):
            if frame > 0:
                self.sense()
                self.locate()
                self.perceive()
                self.world._automatic_rendering()  # highway-env's hook for pictures between decisions
            elif command is not None:  # a world may have passed it on itself
                self.command(command)
            self.drive()

    def command(self, command: Any) -> None:
        """Pass a command on."""
        self.world.action_type.act(command)

    def drive(self) -> None:
        """Move all vehicles by a simulation step; the ego carries out what follows from its belief."""
        self.world.road.act()
        self.world.road.step(self.step_s)
        self.world.steps += 1
        self._steps += 1

    def sense(self) -> None:
        """Take the true poses of the vehicles. Between epochs, extrapolate the belief; where one ends, measure it."""
        self.seats.follow((self._steps - 1) % self.steps_per_epoch)
        self.seats.read(full=self._ends_epoch)
        self.episodes.carry_on(self.rows, self._ends_epoch)
        if self._ends_epoch:
            self.episodes.sense(self.rows)

    def locate(self) -> None:
        """Solve an epoch that ends by the measurements alone, and place the believed vehicle."""
        if self._ends_epoch:
            self.episodes.locate(self.rows)
        self._place()

    def perceive(self) -> None:
        """Perceive the traffic at the end of an epoch."""
        if self._ends_epoch:
            self.episodes.perceive(self.rows, np.full(self.rows.size, self.time_s))

    # From belief to commands

    def _place(self) -> None:
        """Move the believed vehicle to the estimate; lanes of a planned route count where others cross or part."""
        belief, table = self._body, self.episodes.table
        b = belief[0]
        if self.config.lane_sensor is None and self.config.navigation.source is Source.PERFECT:
            self.believed.copy_from(self.ego)
            return
        index = table.index[b["lane"]]
        if self.config.lane_sensor is None and self.believed.route and index[:2] != self.believed.lane_index[:2]:
            planned = self.believed.planned
            if index[:2] not in planned:
                extra = np.array([0.0 if other[:2] in planned else ROUTE_M for other in table.index])
                row, _ = closest(table.lanes, b["x_m"], b["y_m"], b["heading_rad"], extra)
                belief["lane"], index = row, table.index[row]
        self.believed.place(np.array([b["x_m"], b["y_m"]]), float(b["heading_rad"]), float(b["speed_mps"]), index)

    def intend(self) -> dict[str, float]:
        """Steering and acceleration that carry meta-actions out from the believed pose."""
        e, car = self.episodes, self.believed
        lanes, belief, rows = e.table.lanes, self._body, e.table.row
        target = rows[car.target_lane_index]
        if ego_kernel.past_end(lanes, target, car.position[0], car.position[1]):
            car.follow_road()
            target = rows[car.target_lane_index]
        belief["target_lane"], belief["target_speed_mps"] = target, car.target_speed
        length = float(car.LENGTH)
        steering, acceleration = ego_kernel.intend(belief[0], lanes, self._lane_onward(), e.rules[0], length)
        return {"steering": steering, "acceleration": acceleration}

    def _lane_onward(self) -> int:
        """The lane beyond the end of the target lane, ``NONE`` without one."""
        car = self.believed
        key = car.target_lane_index, tuple(car.route or ())
        found = self._onward.get(key)
        if found is None:
            network = car.road.network
            lane = network.get_lane(key[0])
            end = lane.position(lane.length, 0.0)
            onward = network.next_lane(key[0], list(key[1]), end, np.random.default_rng(0))
            found = self._onward[key] = NONE if onward == key[0] else self.episodes.table.row[onward]
        return found

    def limit(self, action: dict[str, float], row: int = 0) -> dict[str, float]:
        """A command as the actuators carry it out, with the brake that holds a standing car under ``HOLD``."""
        e = self.episodes
        steering, hold = ego_kernel.actuate(
            e.ego["belief"][row], e.ego["command"][row], float(action["steering"]), float(action["acceleration"]),
            float(self.ego.LENGTH), e.rules[0],
        )  # fmt: skip
        out = {**action, "steering": steering}
        if hold > 0.0:
            out[HOLD] = hold
        return out

    # Scores and observations

    def score_and_observe(self, ends: Sequence[WorldStep], start: bool = False) -> None:
        """Score the policy step that ends now for each of ``cars``, and fill the observations of now."""
        e, row = self.episodes, self.episodes.table.row
        self.seats.read(full=True)
        self._intents()
        believed = (e.table.index[lane] for lane in e.ego["belief"]["lane"])
        for index in {self.believed.lane_index, *(car.lane_index for car in self.cars), *believed}:
            e.path_of[0, row[index]] = e.routes.row(row[index], self.route)
        kind = world_kind(self.config.base)
        goal = None if kind is None else kind.arrived
        arrived = goal is None or goal(self.world)
        for n, (car, end) in enumerate(zip(self.cars, ends, strict=True)):
            over = end.terminated or (goal is not None and arrived)
            e.ego["facts"][n] = bool(car.on_road), over, end.truncated, arrived, end.reward
        e.score_and_observe(self.rows, start)

    @property
    def info(self) -> dict[str, Any]:
        """What the last policy step has come to."""
        return self.info_of(0)

    def info_of(self, row: int) -> dict[str, Any]:
        """What it has come to for one of ``cars``."""
        own = {name: float(values[row]) for name, values in self.episodes.own_info.items()}
        return info_of(self.episodes.ego["outcome"], row) | own

    def _intents(self) -> None:
        """Targets of meta-actions, into the records."""
        if self.meta:
            belief = self._body
            belief["target_lane"] = self.episodes.table.row[self.believed.target_lane_index]
            belief["target_speed_mps"] = self.believed.target_speed

    # Read-outs

    def belief(self) -> EgoBelief:
        """The belief of the ego about itself."""
        e = self.episodes
        self._intents()
        locate(e.ego["belief"][0], e.table.lanes, e.path_of[0], e.rules[0])
        return EgoBelief.of(e.ego["belief"], 0, e.table)

    @property
    def traffic(self) -> Traffic:
        """Whom the ego perceives, nearest first."""
        pictures = self.episodes.perception.pictures
        return Traffic.of(pictures.perceived[0, : int(pictures.picture["seen"][0])])
