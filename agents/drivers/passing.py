"""Steering round whoever is slower, for cars that cannot slow down; leading axes are a batch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.mobil import MobilConfig, changes
from lanebound.agents.drivers.plans import CruiseConfig

__all__ = ["PASSING", "PassingSteering"]

Array = NDArray[np.float64]
PASSING = MobilConfig(way_m=1.0, speed_min_mps=1.0)  # a car that cannot slow down waits for no straight


class PassingSteering:
    """A regulator that is led to the neighbouring lane while MOBIL says so, and stays where it has come to.

    The speed being what it is, it is the wanted one: nothing but who is ahead and behind speaks for a lane. Half way
    over the car's lane is the new one, in which nobody is in the way, so that it needs no memory.
    """

    def __init__(self, law: LqrSteering, reader: Reader, config: CruiseConfig, mobil: MobilConfig = PASSING) -> None:
        self.law, self.reader, self.config, self.mobil = law, reader, config, mobil

    def __call__(self, observation: Observation) -> Array:
        """Steering angle [rad], positive right."""
        v = self.reader.value(observation, "ego.speed")
        side = changes(self.reader, observation, v, self.config, self.mobil)
        return self.law(observation, side * self.reader.value(observation, "ego.lane_width"))
