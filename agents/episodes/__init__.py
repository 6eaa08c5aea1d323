"""Episodes driven by an agent: the loop, the log of every step, and the film."""

from __future__ import annotations

from lanebound.agents.episodes.columns import COLUMNS, Moment
from lanebound.agents.episodes.drive import drive
from lanebound.agents.episodes.log import EpisodeLog
from lanebound.agents.episodes.opening import full_id, open_env

__all__ = ["COLUMNS", "EpisodeLog", "Moment", "drive", "full_id", "open_env"]
