"""What a driver charges: by the links that its margin across leaves possible.

A link is possible that is the nearest one, or nearer than the margin. Where only the tolled link is possible it is
charged, where it is not possible it is not. While both are the claim waits: the position may come nearer to one, or the
margin, where it is a level, may become smaller. When the geo-object has been passed, what is not sure is not charged,
as an overcharge is the graver mistake. With a margin of 0 the claim is that of most positions, when all are known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.envs.batch.toll_kernel import CHARGE, DEFER, SPARE

__all__ = ["claim"]


def claim(reader: Reader, observation: Observation, margin_m: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """The claim of an observation (...), for a margin (...) [m]; 0: by the nearest link of most positions."""

    def value(name: str) -> NDArray[np.float64]:
        return reader.value(observation, f"road.toll_{name}")

    margin = np.asarray(margin_m, dtype=np.float64)
    inside, tolled, free = value("inside") > 0.5, value("distance"), value("free_distance")
    charged = np.where(margin > 0.0, inside & (free > np.maximum(margin, tolled)), ~inside & (value("share") > 0.5))
    spared = ~inside | ((margin > 0.0) & (tolled > np.maximum(margin, free)))
    claimed = np.where(charged, CHARGE, np.where(spared, SPARE, DEFER))
    return np.where(value("open") > 0.5, claimed, DEFER)
