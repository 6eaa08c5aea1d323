"""CRAIM: RAIM of carriers with fixed integers, which also bears the risk that an integer is wrong (S3 III-A).

The carriers of an epoch are rows as codes are, of centimetres. They are tested by separations and excluded, and the
level is the root of the sum over their hypotheses at the risk that the fix leaves: ``risk - P(wrong integers)``. There
is a level only where there is a fix of less risk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import solve_codes
from lanebound.integrity.monitoring.family.levels import LevelWork
from lanebound.integrity.monitoring.family.memory import Remembered
from lanebound.integrity.monitoring.family.rejection import local_threshold, separation_tests
from lanebound.integrity.monitoring.family.separations import root_level

__all__ = ["fixed_carriers"]


def fixed_carriers(work: LevelWork) -> Remembered:
    """Position and level by fixed carriers; inf without a fix that leaves some of the risk."""
    rows, config = _rows_of(work.epochs), work.config
    left = separation_tests(rows, config)
    fit = solve_codes(left)
    limit = local_threshold(fit.used.sum(-1), config.false_alarm)
    tested = fit.solved & (fit.df > 0)
    alarm = tested & (np.abs(fit.normalised).max(-1) > limit)
    level = root_level(left, fit, config, work.risks, work.epochs.fix_risk)
    level = np.where(tested[:, None], level, np.inf)
    position = np.where(tested[:, None], fit.x_m, work.fit.x_m)
    return Remembered(position, level, np.asarray(alarm), np.ones(tested.size, bool), left.used, rows.used & ~left.used)


def _rows_of(e: CodeEpochs) -> CodeEpochs:
    """The fixed carriers in the place of the codes."""
    if e.fixed_m is None or e.fixed_sigma_m is None or e.fixed_kept is None or e.fix_risk is None:
        raise InputError("fixed_m must be known for CRAIM, got None: the epochs must hold carriers with fixed integers")
    kept = e.fixed_kept
    return replace(e, y_m=np.where(kept, e.fixed_m, 0.0), sigma_m=np.where(kept, e.fixed_sigma_m, 1.0), used=kept)
