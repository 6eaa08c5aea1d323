"""Sizes of the tables of satellite systems, for the records of kernels."""

from __future__ import annotations

__all__ = ["N_SYSTEMS"]

N_SYSTEMS = 5
"""Members of :class:`~lanebound.integrity.sky.systems.System`."""
