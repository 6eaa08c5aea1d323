"""Episodes driven by an agent: the loop, the log of every step, the film, and what it all comes to."""

from __future__ import annotations

from lanebound.agents.episodes.columns import COLUMNS, Moment
from lanebound.agents.episodes.drive import drive
from lanebound.agents.episodes.log import EpisodeLog
from lanebound.agents.episodes.opening import full_id, open_env
from lanebound.agents.episodes.summary import Summary, summarise

__all__ = ["COLUMNS", "EpisodeLog", "Moment", "Summary", "drive", "full_id", "open_env", "summarise"]
