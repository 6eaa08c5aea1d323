"""The fault ``wrong_fix``: integers that fit almost as well as the right ones are held in their place."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import fill_rows, find_members
from lanebound.integrity.positioning.codes_kernel import NO_CORRECTIONS
from lanebound.integrity.positioning.rows_kernel import ROW
from lanebound.integrity.positioning.rtk_kernel import Carriers
from lanebound.integrity.positioning.wrong_fix_kernel import next_best_integers

__all__ = ["make_integers_wrong"]


@jit
def make_integers_wrong(first: int, last: int, epoch: Epoch) -> None:
    """Add to ``integer_error`` the wrong candidate that a fault names by ``next_best``: its rank and azimuth."""
    par, satellites = epoch.parameters[0], epoch.tables.satellites
    n = satellites.shape[0]
    rows, factor, wrong = np.zeros(n, ROW), np.empty(n), np.empty((n, 2), dtype=np.int64)
    for v in range(first, last):
        candidate, signals, marks = epoch.observed[v].next_best, epoch.signals[v], epoch.marks[v]
        if not candidate[0] > 0.0 or epoch.work[v].fixed.status == NO_CORRECTIONS:
            continue
        for s in range(n):
            factor[s] = marks[s].factor
        carriers = Carriers(satellites, signals, factor)
        fill_rows(carriers, marks, rows)
        _, positioned = find_members(epoch.ambiguities[v], marks, satellites, par.rtk, rows)
        if positioned and next_best_integers(carriers, rows, int(candidate[0]), candidate[1], par.rtk, wrong):
            for s in range(n):
                for b in range(2):
                    signals[s].integer_error[b] += wrong[s, b]
