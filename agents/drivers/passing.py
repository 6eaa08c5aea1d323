"""Steering past slower vehicles, for cars that cannot slow down; leading axes are a batch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.mobil import MobilConfig, changes
from lanebound.agents.drivers.plans import CruiseConfig

__all__ = ["PASSING", "PassingSteering"]

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
