"""The plain driver: keeps lane, speed and distance, and uses its position without regard to integrity.

It reads only entries of blind observations, which makes it the baseline. Other drivers here differ from it in one law.
"""

from __future__ import annotations

from gymnasium import spaces

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.lateral import Array, LqrSteering, StanleySteering
from lanebound.agents.drivers.plan import ContinuousDriver, Plan, carry_out
from lanebound.agents.drivers.plans import CruiseConfig, idm_acceleration
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["IdmPlan", "make_cruise", "make_idm", "make_lqr", "make_stanley"]


def make_cruise(env: DrivingEnv, config: CruiseConfig | None = None) -> StatelessDriver:
    """Pure pursuit, and the intelligent driver model with a safe speed; under meta-actions it never changes lane."""
    return carry_out(env, Plan(env, config or CruiseConfig()))


def make_idm(env: DrivingEnv, config: CruiseConfig | None = None) -> StatelessDriver:
    """The same with the intelligent driver model as published."""
    return carry_out(env, IdmPlan(env, config or CruiseConfig()))


def make_stanley(env: DrivingEnv, config: CruiseConfig | None = None) -> ContinuousDriver:
    """The same with Stanley's law of steering."""
    plan = _steered(env, config)
    plan.steering = StanleySteering(env, plan.reader)
    return ContinuousDriver(env, plan)


def make_lqr(env: DrivingEnv, config: CruiseConfig | None = None) -> ContinuousDriver:
    """The same with a linear-quadratic regulator at the wheel."""
    plan = _steered(env, config)
    plan.steering = LqrSteering(env, plan.reader)
    return ContinuousDriver(env, plan)


class IdmPlan(Plan):
    """Follows by the intelligent driver model alone."""

    def acceleration(self, observation: Observation) -> Array:
        """Equation 2 of Treiber et al. 2000, bounded."""
        c, v = self.config, self.reader.value(observation, "ego.speed")
        free = idm_acceleration(v, self.wanted_speed(observation), *self.lead(observation), c)
        return free.clip(-c.brake_max_mps2, c.accelerate_mps2)


def _steered(env: DrivingEnv, config: CruiseConfig | None) -> Plan:
    if not isinstance(env.action_space, spaces.Box):
        raise InputError("action must be continuous for a law of steering, got meta: choose another agent or action")
    return Plan(env, config or CruiseConfig())
