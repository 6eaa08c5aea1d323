"""Number ``usual_cn0_dbhz`` of ``info`` and of logs: what the monitor ``interference`` compares C/N0 with."""

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.episodes.columns import Column, register_column
from lanebound.envs.info import InfoEntry, register_info
from lanebound.envs.observation import Observed

NAME, UNIT, MEANING = "usual_cn0_dbhz", "dB-Hz", "usual C/N0 of a tracked satellite; 0 without the monitor"


def usual_cn0_dbhz(observed: Observed) -> NDArray[np.float64]:
    """The state of the monitor of N environments, (N,)."""
    state = observed.states.get("stage interference")
    return np.zeros(observed.belief.shape) if state is None else state["usual"]


register_info(InfoEntry(NAME, f"{MEANING} [{UNIT}]", usual_cn0_dbhz))
register_column(Column(NAME, "float", UNIT, MEANING, lambda moment: moment.info[NAME]))
