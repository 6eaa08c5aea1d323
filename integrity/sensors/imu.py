"""The inertial sensor: increments of angle and velocity over an epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ImuSample"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ImuSample:
    """Increments over one epoch in body axes (forward, right, down).

    Attributes
    ----------
    delta_theta_rad : (B, 3) integrated angular rate
    delta_v_mps : (B, 3) integrated specific force
    """

    delta_theta_rad: Array
    delta_v_mps: Array
