"""Observation entry ``ego.stopping_distance``: how far the car drives until it stands, braking gently."""

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.observation import Entry, Observed, register_entry

DECELERATION_MPS2 = 3.0


def stopping_distance_m(observed: Observed) -> NDArray[np.float64]:
    """The distance v^2 / (2 a) of N environments, (N,) [m]."""
    return observed.belief["speed_mps"] ** 2 / (2.0 * DECELERATION_MPS2)


STOPPING_DISTANCE = Entry(
    name="stopping_distance",
    group="ego",
    unit="m",
    scale=50.0,
    low=0.0,
    high=1.0,
    meaning="distance until the car stands at 3 m/s2, by the speed of the odometer",
    source=stopping_distance_m,
)
register_entry(STOPPING_DISTANCE)
