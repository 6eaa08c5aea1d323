"""Deliberately bad policies, which check that rewards cannot be gamed: none of them may do well.

A task is sound when standing, crawling, full throttle, weaving, and stopping after enough progress all score worse than
a driver that uses what it observes (suite ``degenerate``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader, Starts, StatelessDriver, States
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.nominal import Nominal
from lanebound.agents.drivers.plan import Plan, carry_out
from lanebound.agents.drivers.plans import FREE_M, CruiseConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.scene import duration_s
from lanebound.integrity.core.config import Field
from lanebound.integrity.core.errors import InputError

__all__ = ["Bank", "Constant", "Weave", "make_bank", "make_constant", "make_weave"]

Array = NDArray[np.float64]


class ConstantConfig(CruiseConfig):
    """Speed of a driver that reacts to nothing."""

    share: float = Field(
        0.5,
        ge=0,
        description="of the speed limit, or of the largest target speed if that is less: 0 stands, above 1 is full "
        "throttle [-]",
    )
    claim: int = Field(0, ge=0, le=2, description="where charges are decided: 0 defer, 1 charge, 2 do not charge")


class Constant(Plan):
    """Follows the middle of the route at a constant speed, whatever bends and vehicles are ahead.

    The speed is a share of the limit, or of the largest target speed of meta-actions where that is less, rounded to a
    target speed, up from half way.
    """

    config: ConstantConfig

    def __init__(self, env: DrivingEnv, config: ConstantConfig) -> None:
        super().__init__(env, config)
        meta = not isinstance(env.action_space, spaces.Box)
        self._levels = np.sort(np.asarray(env.world.action_type.target_speeds, dtype=np.float64)) if meta else None

    def wanted_speed(self, observation: Observation) -> Array:
        """The share of the fastest speed."""
        limit = self.reader.value(observation, "road.speed_limit")
        known = limit < self.reader.scale("road.speed_limit")
        fastest = np.where(known, limit, self.config.speed_mps)
        if self._levels is None:
            return np.asarray(self.config.share * fastest)
        wanted = self.config.share * np.minimum(fastest, self._levels[-1])
        middles = 0.5 * (self._levels[:-1] + self._levels[1:])
        return np.asarray(self._levels[np.searchsorted(middles, wanted * (1.0 + 1e-9), side="right")])

    def claim(self, observation: Observation) -> NDArray[np.int64]:
        """The same of every geo-object."""
        return np.full(self.reader.value(observation, "ego.speed").shape, self.config.claim)

    def acceleration(self, observation: Observation) -> Array:
        """To that share; at 0 it brakes for good."""
        free = super().acceleration(observation)
        return np.where(self.wanted_speed(observation) > 0.0, free, -self.config.brake_max_mps2)

    def lead(self, observation: Observation, margins: bool = True) -> tuple[Array, Array]:
        """No vehicle ahead."""
        speed = self.reader.value(observation, "ego.speed")
        return np.full(speed.shape, FREE_M), speed


class WeaveConfig(CruiseConfig):
    """Width of the weaving."""

    aside_m: float = Field(1.0, gt=0, description="line to the left and right of the middle that is steered to")
    turn_m: float = Field(0.7, gt=0, description="offset at which the other line is taken")


class Weave(Nominal):
    """Nominal, from side to side: in its lane by steering, between lanes by meta-actions.

    The side needs no memory: by steering it is that to which the car points, until the offset is large enough; by
    meta-actions it is the left while there is a lane, else the right.
    """

    config: WeaveConfig

    def __init__(self, env: DrivingEnv, config: WeaveConfig) -> None:
        super().__init__(env, config)
        self._law = LqrSteering(env, self.reader)
        self.steering = self._aside

    def _aside(self, observation: Observation) -> Array:
        c, e = self.config, self.reader.value(observation, "ego.lateral_offset")
        side = np.where(self.reader.value(observation, "ego.heading_sin") >= 0.0, 1.0, -1.0)
        side = np.where(np.abs(e) > c.turn_m, -np.sign(e), side)
        return self._law(observation, c.aside_m * side)

    def change(self, observation: Observation) -> NDArray[np.int64]:
        """Left where there is a lane, else right."""
        return np.where(self.reader.value(observation, "ego.left_exists") > 0.5, -1, 1)


class BankConfig(CruiseConfig):
    """Time after which the car stops."""

    time_share: float = Field(0.5, gt=0, le=1, description="of the episode's longest time that is driven [-]")


class Bank:
    """Drives as nominal for a share of the time, then stops for good.

    The number of decisions so far is the state of :meth:`predict`.
    """

    def __init__(self, env: DrivingEnv, config: BankConfig) -> None:
        self.config, self._reader = config, Reader(env.config.observation)
        self._drive = carry_out(env, Nominal(env, config))
        self._stop = make_constant(env, ConstantConfig(share=0.0))
        self._decisions = config.time_share * duration_s(env.config, env.world) / env.dt_s

    def predict(
        self, observation: Any, state: States = None, episode_start: Starts = None, deterministic: bool = True
    ) -> tuple[Any, States]:
        """The action of nominal, or of a car that stops; and the number of decisions."""
        shape = self._reader.value(observation, "ego.speed").shape
        taken = np.zeros(shape) if state is None else state[0]
        if episode_start is not None:
            taken = np.where(np.asarray(episode_start).reshape(shape), 0.0, taken)
        go, stop = self._drive.act(observation), self._stop.act(observation)
        over = (taken >= self._decisions).reshape(shape + (1,) * (np.ndim(go) - len(shape)))
        return np.where(over, stop, go).astype(go.dtype), (taken + 1.0,)


def make_constant(env: DrivingEnv, config: ConstantConfig | None = None) -> StatelessDriver:
    """The driver at a constant share of the limit."""
    return carry_out(env, Constant(env, config or ConstantConfig()))


def make_bank(env: DrivingEnv, config: BankConfig | None = None) -> Bank:
    """The driver that stops after enough progress."""
    return Bank(env, config or BankConfig())


def make_weave(env: DrivingEnv, config: WeaveConfig | None = None) -> StatelessDriver:
    """The driver that weaves.

    Raises
    ------
    InputError
        Actions command neither steering nor lane changes.
    """
    if not isinstance(env.action_space, spaces.Box) and "LANE_LEFT" not in env.world.action_type.actions.values():
        raise InputError("action must steer or change lanes for agent 'weave', got speeds alone: choose another agent")
    return carry_out(env, Weave(env, config or WeaveConfig()))
