"""The w test of single rows, signed; the navigator takes the largest of it by the compiled tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.detection import Adjustment
from lanebound.integrity.monitoring.detection_kernel import RANK_TOLERANCE

__all__ = ["w_statistics"]


def w_statistics(adjustment: Adjustment) -> NDArray[np.float64]:
    """``w = c'We / sqrt(c'W Q_e W c)`` of each row (..., m), N(0, 1); 0 if unchecked (S1 eq 14)."""
    redundancy = np.diagonal(adjustment.reliability, axis1=-2, axis2=-1)
    testable = redundancy > RANK_TOLERANCE * np.diagonal(adjustment.weight, axis1=-2, axis2=-1)
    return np.where(testable, adjustment.score / np.sqrt(np.where(testable, redundancy, 1.0)), 0.0)
