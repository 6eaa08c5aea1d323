"""Codes of :class:`~lanebound.integrity.positioning.rtk_status.RtkStatus` as kernels and records carry them."""

from __future__ import annotations

__all__ = ["FAULT", "FIXED", "NOT_CONVERGED", "NO_CORRECTIONS", "RATIO_FAILED", "SEARCH_FAILED", "TOO_FEW"]

FIXED, NO_CORRECTIONS, TOO_FEW, NOT_CONVERGED, RATIO_FAILED, FAULT, SEARCH_FAILED = range(7)
