"""Rows of a least-squares problem: one for each satellite, ``y = -e x + clock`` with a clock for each group."""

from __future__ import annotations

from lanebound.integrity.core.records import record

__all__ = ["ROW"]

ROW = record(
    e=("f8", (3,), "unit vector to the satellite, East North Up"),
    group=("i8", "its clock"),
    system=("i8", "its constellation"),
    variance="of y [m^2], or [m^2/s^2] of a velocity",
    y="measurement [m], [m/s]",
    used=("?", "the row is in the solution"),
)
"""A row; those that are not used have no weight, whatever they hold."""
