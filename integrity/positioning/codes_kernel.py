"""Codes that kernels and tables share: positioning modes, and outcomes of an RTK epoch."""

from __future__ import annotations

__all__ = [
    "CODE", "DGPS", "DOPPLER", "FAULT", "FIXED", "IMU_ODOMETER", "NONE", "NOT_CONVERGED", "NO_CORRECTIONS", "NRTK",
    "PPP", "RATIO_FAILED", "RTK", "SBAS_DFMC", "SBAS_L1", "SEARCH_FAILED", "SPP", "TOO_FEW", "UNDECIDED",
]  # fmt: skip

UNDECIDED = -1  # no mode has moved the position in this epoch yet
NONE, RTK, DOPPLER, IMU_ODOMETER, CODE = 0, 1, 2, 3, 4  # Mode
SPP, DGPS, SBAS_L1, SBAS_DFMC, PPP, NRTK = 5, 6, 7, 8, 9, 10  # Mode, positioning services
FIXED, NO_CORRECTIONS, TOO_FEW, NOT_CONVERGED, RATIO_FAILED, FAULT, SEARCH_FAILED = 0, 1, 2, 3, 4, 5, 6  # RtkStatus
