"""Recorded skies, made up."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.recorded.sky_recording import SkyRecording
from lanebound.integrity.sky.visibility import SignalPath

LENGTH_M = 400.0


def wall_on_the_left() -> SkyRecording:
    """From 100 to 300 m nothing is received from the left; signals from the right come 25 m late below 30 degrees."""
    arc, azimuth, elevation = (
        v.ravel()
        for v in np.meshgrid(np.arange(2.5, LENGTH_M, 5.0), np.radians(np.arange(5.0, 360.0, 10.0)),
                             np.radians([15.0, 45.0, 75.0]))
    )  # fmt: skip
    beside, right = (arc > 100.0) & (arc < 300.0), np.sin(azimuth) > 0.0
    path = np.where(beside & ~right, SignalPath.BLOCKED, SignalPath.LOS)
    path = np.where(beside & right & (elevation < np.radians(30.0)), SignalPath.REFLECTED, path).astype(np.uint8)
    excess = np.where(path == SignalPath.REFLECTED, 25.0, 0.0)
    name = np.full(arc.size, "G01")
    return SkyRecording(name, arc, azimuth, elevation, path, excess, np.full(arc.size, 45.0), LENGTH_M)
