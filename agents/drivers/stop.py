"""The simplest reaction to an alert: to stop until it is over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.plan import Plan, carry_out
from lanebound.agents.drivers.plans import CruiseConfig
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field

__all__ = ["StopConfig", "StopOnAlert", "make_stop_on_alert"]


class StopConfig(CruiseConfig):
    """Parameters of a driver that stops."""

    stop_mps2: float = Field(4.0, gt=0, description="braking while an alert is on; as in RSS")


class StopOnAlert(Plan):
    """Cruises, and brakes to a stop while an alert is on."""

    NEEDED: ClassVar[Sequence[str]] = (*Plan.NEEDED, "integrity.alert")
    config: StopConfig

    def acceleration(self, observation: Observation) -> NDArray[np.float64]:
        """As cruising, or braking."""
        free = super().acceleration(observation)
        return np.where(self._alert(observation), np.minimum(free, -self.config.stop_mps2), free)

    def top_speed(self, observation: Observation) -> NDArray[np.float64]:
        """As cruising, or 0."""
        return np.where(self._alert(observation), 0.0, super().top_speed(observation))

    def _alert(self, observation: Observation) -> NDArray[np.bool_]:
        return self.reader.value(observation, "integrity.alert") > 0.5


def make_stop_on_alert(env: DrivingEnv, config: StopConfig | None = None) -> StatelessDriver:
    """The driver that stops while an alert is on."""
    return carry_out(env, StopOnAlert(env, config or StopConfig()))
