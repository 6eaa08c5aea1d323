"""The nominal driver: the best control laws without integrity; and the same with the truth as its observation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader, StatelessDriver
from lanebound.agents.drivers.crossing import YieldConfig, yield_speed
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.mobil import MobilConfig, changes
from lanebound.agents.drivers.plan import Plan, carry_out
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["PASSING", "Nominal", "PassingSteering", "make_nominal", "make_oracle"]

Array = NDArray[np.float64]

PASSING = MobilConfig(way_m=1.0, speed_min_mps=1.0)  # a car that cannot slow down changes lane in bends too


class PassingSteering:
    """A regulator that steers to the neighbouring lane while MOBIL chooses it, and stays there.

    The present speed counts as the wanted one, so that only vehicles ahead and behind decide. Half way over, the new
    lane is the car's own one and free, so that no memory is needed.
    """

    def __init__(self, law: LqrSteering, reader: Reader, config: CruiseConfig, mobil: MobilConfig = PASSING) -> None:
        self.law, self.reader, self.config, self.mobil = law, reader, config, mobil

    def __call__(self, observation: Observation) -> Array:
        """Steering angle [rad], positive right."""
        v = self.reader.value(observation, "ego.speed")
        side = changes(self.reader, observation, v, self.config, self.mobil)
        return self.law(observation, side * self.reader.value(observation, "ego.lane_width"))


END_M = 100.0  # before the end of a lane a car that leaves it is slow, to find a gap; half of a slip lane, chosen
CRAWL_MPS = 5.0  # so slow: a car that stands changes no lane, chosen
ROUTE_MPS2 = 100.0  # gain of the lane that the way to a goal asks for: more than any acceleration
META_MPS2, META_S = 3.0, 0.25
"""Acceleration and response by which meta-actions start: highway-env's control covers 8.6 m in 2.5 s, 20 m in 4.5 s."""


class Nominal(Plan):
    """Linear-quadratic steering, the intelligent driver model, a safe speed, MOBIL, and giving way."""

    NEEDED: ClassVar[Sequence[str]] = (*Plan.NEEDED, "ego.lateral_offset", "road.lane_end", "road.junction")

    def __init__(self, env: DrivingEnv, config: CruiseConfig, mobil: MobilConfig | None = None) -> None:
        super().__init__(env, config)
        self.mobil = MobilConfig() if mobil is None else mobil
        levels = () if isinstance(env.action_space, spaces.Box) else env.world.action_type.target_speeds
        self._targets_mps = np.sort(np.asarray(levels, dtype=np.float64))
        starts = {"accelerate_mps2": META_MPS2, "response_s": META_S} if len(levels) else {}
        self.giving_way = YieldConfig(**{"accelerate_mps2": config.accelerate_mps2, **starts})
        if self.reader.previews_m:
            law = LqrSteering(env, self.reader)
            self.steering = PassingSteering(law, self.reader, config) if _cannot_slow(env) else law

    def wanted_speed(self, observation: Observation) -> Array:
        """The free speed, and that of giving way to crossing traffic."""
        return self.giving(observation, self.free_speed(observation))

    def giving(self, observation: Observation, free_mps: Array) -> Array:
        """A free speed, reduced for giving way [m/s]."""
        top = self._reached(free_mps)
        cap = yield_speed(self.reader, observation, self.giving_way, top, self.widening(observation))
        return np.minimum(free_mps, cap)

    def _reached(self, wanted_mps: Array) -> Array:
        """The speed that is driven where one is wanted: by meta-actions the next target speed below."""
        if not self._targets_mps.size:
            return wanted_mps
        return self._targets_mps[np.maximum(np.searchsorted(self._targets_mps, wanted_mps + 1e-6, side="right") - 1, 0)]

    def free_speed(self, observation: Observation) -> Array:
        """Speed without other vehicles [m/s]; on a lane that ends and is to be left, slow enough to let others pass."""
        free = super().wanted_speed(observation)
        if not self.reader.config.roads:
            return free
        left = self.reader.value(observation, "road.lane_end")
        room = np.where(left < self.reader.scale("road.lane_end"), np.maximum(left - END_M, 0.0), np.inf)
        leaves = self.reader.value(observation, "road.route_shift") != 0.0
        slow = np.maximum(np.sqrt(2.0 * self.config.brake_mps2 * room), CRAWL_MPS)
        return np.where(leaves, np.minimum(free, slow), free)

    def widening(self, observation: Observation) -> Array | float:
        """Widening of each crossing vehicle for uncertain positions [m]."""
        return 0.0

    def bonus(self, observation: Observation) -> tuple[Array | float, Array | float]:
        """Gains of the lanes left and right beside speed [m/s2]."""
        return 0.0, 0.0

    def change(self, observation: Observation) -> NDArray[np.int64]:
        """By MOBIL, with gaps reduced by their margins; with a way to a goal only for that, where gaps are safe."""
        along, _ = self.margins(observation)
        wanted, bonus = self.wanted_speed(observation), self.bonus(observation)
        if self.reader.config.roads:
            shift = self.reader.value(observation, "road.route_shift")
            left, right = (np.where(side * shift > 0.0, ROUTE_MPS2, -ROUTE_MPS2) for side in (-1.0, 1.0))
            bonus = left, right
        return changes(
            self.reader, observation, wanted, self.config, self.mobil, along, bonus, self.own_margin(observation)
        )


def _cannot_slow(env: DrivingEnv) -> bool:
    """Whether steering is the only command, on a road whose lanes may be chosen freely."""
    inner = env.world.action_type
    return isinstance(env.action_space, spaces.Box) and not inner.longitudinal and not env.config.keep_lane


def make_nominal(env: DrivingEnv, config: CruiseConfig | None = None) -> StatelessDriver:
    """The nominal driver."""
    return carry_out(env, Nominal(env, config or CruiseConfig()))


def make_oracle(env: DrivingEnv, config: CruiseConfig | None = None) -> StatelessDriver:
    """The nominal driver where observations show the true state.

    Raises
    ------
    InputError
        They do not.
    """
    shown = env.config.observation.integrity
    if shown != "oracle":
        raise InputError(
            f"observation.integrity must be oracle for agent 'oracle', got {shown}: "
            "set it to oracle (--set observation.integrity=oracle)"
        )
    return make_nominal(env, config)
