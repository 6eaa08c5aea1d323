"""A plan of driving, and its two executions: by steering and acceleration, or by meta-actions.

A plan computes speed, gap, line and lane from an observation. Drivers override single ones of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader, StatelessDriver
from lanebound.agents.drivers.charging import claim
from lanebound.agents.drivers.lateral import PursuitSteering, Steering
from lanebound.agents.drivers.plans import (
    CruiseConfig,
    closure_gap,
    following_acceleration,
    nearest_ahead,
    route_speed,
    safe_speed,
)
from lanebound.agents.drivers.shares import share_of
from lanebound.envs.core import DrivingEnv
from lanebound.envs.worlds.tolling import ClaimAction
from lanebound.integrity.core.errors import InputError

__all__ = ["ClaimDriver", "ContinuousDriver", "MetaDriver", "Plan", "carry_out"]

Array = NDArray[np.float64]
LEVEL_SHARE = 0.75  # of a level of speed in each decision, with which a car slows by meta-actions; by 2 m/s: 3 m/s2
LAG_S = 0.3  # half of the time constant of highway-env's speed control
STANDS_MPS = 1.0  # below which a vehicle ahead stands


class Plan:
    """Follows the middle of the route at its speed, with a safe gap.

    Parameters
    ----------
    env : only the index of its observations and the figures of its actions are read
    config : of the driver
    steering : law of steering; None: pure pursuit

    Raises
    ------
    InputError
        The observation lacks an entry that the plan needs.
    """

    NEEDED: ClassVar[Sequence[str]] = ("ego.speed", "road.speed_limit")

    def __init__(self, env: DrivingEnv, config: CruiseConfig, steering: Steering | None = None) -> None:
        self.config, self.reader = config, Reader(env.config.observation)
        self.reader.require(self.NEEDED)
        self.steering: Steering = PursuitSteering(env, self.reader, config) if steering is None else steering

    def margins(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """Reduction of the gap to each vehicle, and widening of the ego's lane on each side for it [m]."""
        return 0.0, 0.0

    def wanted_speed(self, observation: Observation) -> Array:
        """Speed on a free road [m/s]."""
        return route_speed(self.reader, observation, self.config)

    def own_margin(self, observation: Observation) -> Array | float:
        """Reduction of the gap to what the map places, such as a closed lane [m]."""
        return 0.0

    def lead(self, observation: Observation, margins: bool = True) -> tuple[Array, Array]:
        """Gap that counts to the next vehicle ahead [m], and its speed [m/s]; a closed lane is a standing one."""
        found = self.margins(observation) if margins else (0.0, 0.0)
        s, lead = nearest_ahead(self.reader, observation, *found, self.config)
        if not self.reader.config.closure:
            return s, lead
        closed = closure_gap(self.reader, observation, 0, self.own_margin(observation) if margins else 0.0)
        return np.minimum(s, closed), np.where(closed < s, 0.0, lead)

    def acceleration(self, observation: Observation) -> Array:
        """Acceleration to command [m/s2]."""
        v, wanted = self.reader.value(observation, "ego.speed"), self.wanted_speed(observation)
        return following_acceleration(v, wanted, *self.lead(observation), self.config)

    def top_speed(self, observation: Observation) -> Array:
        """Largest speed behind the vehicle ahead [m/s], by which meta-actions are chosen."""
        c = self.config
        s, lead = self.lead(observation)
        headway = np.maximum(s - c.standstill_m, 0.0) / c.time_gap_s
        return np.minimum(self.wanted_speed(observation), np.minimum(safe_speed(s, lead, c), headway))

    def link_margin(self, observation: Observation) -> Array | float:
        """Distance across from which a link is excluded that is not the nearest one [m]."""
        return 0.0

    def claim(self, observation: Observation) -> NDArray[np.int64]:
        """Claim about the open geo-object: see :func:`~.charging.claim`."""
        return claim(self.reader, observation, self.link_margin(observation))

    def change(self, observation: Observation) -> NDArray[np.int64]:
        """Lane to change to: -1 left, 0 none, 1 right."""
        return np.zeros(self.reader.value(observation, "ego.speed").shape, dtype=np.int64)


def carry_out(env: DrivingEnv, plan: Plan) -> StatelessDriver:
    """The driver of a plan for the actions of an environment."""
    if isinstance(env.world.action_type, ClaimAction):
        return ClaimDriver(env, plan)
    return ContinuousDriver(env, plan) if isinstance(env.action_space, spaces.Box) else MetaDriver(env, plan)


class ContinuousDriver(StatelessDriver):
    """Steers and accelerates; changes no lane.

    Raises
    ------
    InputError
        The observation shows no preview of the route.
    """

    def __init__(self, env: DrivingEnv, plan: Plan) -> None:
        self.plan, self._actuators = plan, env.world.action_type
        if not plan.reader.previews_m:
            raise InputError("observation.preview_m must name a distance for this agent, got none: add one")

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Acceleration and steering as shares of their ranges, whichever of them the environment takes."""
        inner = self._actuators
        parts = []
        if inner.longitudinal:
            parts.append(share_of(self.plan.acceleration(observation), inner.acceleration_range))
        if inner.lateral:
            parts.append(share_of(self.plan.steering(observation), inner.steering_range))
        return np.stack(parts, axis=-1).astype(np.float32)


class MetaDriver(StatelessDriver):
    """Changes lane, or commands faster, slower or idle."""

    def __init__(self, env: DrivingEnv, plan: Plan) -> None:
        self.plan = plan
        plan.reader.require(["ego.target_speed"])
        inner = env.world.action_type
        self._codes = {label: code for code, label in inner.actions.items()}
        self._levels = np.sort(np.asarray(inner.target_speeds, dtype=np.float64))
        self._slows_s = env.dt_s + LAG_S
        self._slows_mps2 = min(LEVEL_SHARE * np.diff(self._levels).min() / env.dt_s, plan.config.brake_max_mps2)

    def act(self, observation: Observation) -> NDArray[np.int64]:
        """The code of an action."""
        plan, levels, codes = self.plan, self._levels, self._codes
        wanted = np.minimum(plan.top_speed(observation), self._before_standing(observation))
        now = np.argmin(np.abs(levels - plan.reader.value(observation, "ego.target_speed")[..., None]), axis=-1)
        goal = np.maximum(np.searchsorted(levels, wanted + 1e-3 * levels[-1], side="right") - 1, 0)
        slower = np.where(goal < now, codes["SLOWER"], np.full(now.shape, codes["IDLE"]))
        action = np.where(goal > now, codes["FASTER"], slower)
        if "LANE_LEFT" in codes:
            side = np.where(goal < now, 0, plan.change(observation))  # braking has priority
            action = np.where(side < 0, codes["LANE_LEFT"], np.where(side > 0, codes["LANE_RIGHT"], action))
        return np.asarray(action)

    def _before_standing(self, observation: Observation) -> NDArray[np.float64]:
        """Largest speed behind a vehicle that stands, from which this one still stops by levels of speed [m/s].

        ``v t + v^2 / 2b``: speed falls by a level in each decision, with the lag of highway-env's control.
        """
        s, lead = self.plan.lead(observation)
        room = np.maximum(s - self.plan.config.standstill_m, 0.0)
        delay = self._slows_mps2 * self._slows_s
        return np.where(lead < STANDS_MPS, np.sqrt(delay**2 + 2.0 * self._slows_mps2 * room) - delay, np.inf)


class ClaimDriver(StatelessDriver):
    """Decides what is charged; the car drives by itself."""

    def __init__(self, env: DrivingEnv, plan: Plan) -> None:
        self.plan = plan

    def act(self, observation: Observation) -> NDArray[np.int64]:
        """The code of a claim."""
        return self.plan.claim(observation)
