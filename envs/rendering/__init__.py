"""Pictures of an environment: the road from above, what the ego believes, and how far that can be trusted.

Importing this package does not import pygame; making a :class:`Viewer` does.
"""

from lanebound.envs.rendering.config import Orientation, RenderingConfig, ThemeName
from lanebound.envs.rendering.frame import Bodies, Frame, Satellites, Status
from lanebound.envs.rendering.trace import Tape, Trace
from lanebound.envs.rendering.viewer import Viewer

__all__ = [
    "Bodies",
    "Frame",
    "Orientation",
    "RenderingConfig",
    "Satellites",
    "Status",
    "Tape",
    "ThemeName",
    "Trace",
    "Viewer",
]
