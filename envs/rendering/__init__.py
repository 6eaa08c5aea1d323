"""Pictures of an environment: the road from above, true and estimated positions, and protection levels.

A display is opened only by :meth:`Viewer.show`.
"""

from lanebound.envs.rendering.config import Orientation, RenderingConfig, ThemeName
from lanebound.envs.rendering.frame import Bodies, EpisodeCost, Frame, Satellites, Status
from lanebound.envs.rendering.trace import Tape, Trace
from lanebound.envs.rendering.viewer import Viewer

__all__ = [
    "Bodies",
    "EpisodeCost",
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
