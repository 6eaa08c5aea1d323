"""The wheel odometer: distance and mean speed over an epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["OdometerSample"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometerSample:
    """What the wheels say about one epoch, positive forward.

    Attributes
    ----------
    distance_m : (B,) path length over the epoch
    speed_mps : (B,) its mean speed
    """

    distance_m: Array
    speed_mps: Array
