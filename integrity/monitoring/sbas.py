"""Factors and tables of SBAS protection levels (RTCA DO-229D, appendices A and J).

SBAS has no fault modes of its own: the ground segment bounds every error by a normal law, and the level is a factor
times the standard deviation (S3, section on SBAS).
"""

from __future__ import annotations

from enum import Enum

import numpy as np

__all__ = [
    "GIVE_M2",
    "UDRE_M2",
    "Operation",
]

UDRE_M2 = np.array(
    [0.052, 0.0924, 0.1444, 0.283, 0.4678, 0.8315, 1.2992, 1.8709, 2.5465, 3.326, 5.1968, 20.787, 230.9661, 2078.695]
)
"""Variance of fast and long-term corrections for UDREI 0 to 13 (DO-229D table A-6); 14 is "not monitored", 15 "do not
use"."""
GIVE_M2 = np.array(
    [0.0084, 0.0333, 0.0749, 0.1331, 0.2079, 0.2994, 0.4075, 0.5322, 0.6735, 0.8315, 1.1974, 1.8709, 3.326, 20.787,
     187.0826]
)  # fmt: skip
"""Variance of the vertical ionospheric delay for GIVEI 0 to 14 (DO-229D table A-17); 15 is "not monitored"."""


class Operation(Enum):
    """Phase of flight: the factors K_H and K_V (DO-229D J.1)."""

    EN_ROUTE = (6.18, 5.33)
    PRECISION_APPROACH = (6.0, 5.33)
