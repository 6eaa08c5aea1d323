"""Which carriers are locked and used in RTK, and their cycle slips."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.reflection_odds_kernel import keep_trusted, update_odds
from lanebound.integrity.positioning.rtk_kernel import UNUSED, Carriers, is_strong, leave_out_faded
from lanebound.integrity.positioning.slip_watch_kernel import DopplerMotion, watch_slips

__all__ = ["follow_carriers"]


@jit
def follow_carriers(first: int, last: int, epoch: Epoch) -> None:
    """Release integers of carriers that lost their lock or are too doubtful; repair or release those that slipped."""
    par, satellites = epoch.parameters[0], epoch.tables.satellites
    rules, n = par.rtk, satellites.shape[0]
    variance = np.empty(n)
    for v in range(first, last):
        vehicle, w, signals, marks = epoch.vehicles[v], epoch.work[v], epoch.signals[v], epoch.marks[v]
        ambiguities = epoch.ambiguities[v]
        _find_locked(signals, rules, par.dt, marks, ambiguities)
        if rules.reflections.sets > 0:
            update_odds(signals, satellites, rules.reflections, ambiguities)
            keep_trusted(marks, UNUSED, rules.reflections, ambiguities)
        for s in range(n):
            variance[s] = marks[s].factor * rules.sigma_phase**2
        motion = DopplerMotion(par.dt, w.solved and vehicle.initialised, w.velocity, w.q, vehicle.position)
        carriers, rtk = Carriers(satellites, signals, variance), vehicle.rtk
        rtk.fixes += watch_slips(
            carriers, marks, epoch.observed[v].age, motion, ambiguities, rules, par.slips, rtk.slips, rtk.fixes + 1
        )


@jit(borrows=True)
def _find_locked(signals: Records, rules: Any, dt: float, marks: Records, ambiguities: Records) -> None:
    """Mark carriers with lock and satellites in use; release the integers of the others, and leave out faded ones."""
    for s in range(signals.shape[0]):
        signal, mark = signals[s], marks[s]
        mark.phase_ok = signal.tracked and signal.phase[0] != 0.0 and (rules.bands == 1 or signal.phase[1] != 0.0)
        # A carrier that was lost comes back with other integers.
        if not mark.phase_ok or signal.lock_lost:
            ambiguities[s].held = False
        mark.used = is_strong(signal, rules.sin_mask, rules.cn0_min)
        mark.factor = mark.quality if mark.used else UNUSED
    leave_out_faded(signals, rules, dt, marks, ambiguities)
