"""Monitor ``twice_normal`` of code positions: the normal level of deviations that are twice as large as stated."""

import numpy as np

from lanebound.integrity.monitoring.family.kinds import register_monitor
from lanebound.integrity.monitoring.family.levels import LevelWork
from lanebound.integrity.monitoring.significance import two_sided_factor


def level(work: LevelWork) -> np.ndarray:
    """``HPL = 2 k d_major`` (E, R) [m]."""
    return 2.0 * two_sided_factor(work.risks) * work.fit.major_m[:, None]


register_monitor(
    "twice_normal",
    "normal errors of twice the stated deviations",
    "an example",
    "P(|error along the major axis| > HPL) <= risk of normal errors of twice the stated deviations",
    level=level,
    test="global",
)
