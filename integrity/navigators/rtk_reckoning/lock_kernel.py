"""Stage 3: which carriers are locked and used in RTK, and their cycle slips."""

from __future__ import annotations

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.reflection_odds_kernel import keep_trusted, update_odds
from lanebound.integrity.positioning.rtk_kernel import UNUSED, Carriers, leave_out_faded, select
from lanebound.integrity.positioning.slip_watch_kernel import DopplerMotion, watch_slips

__all__ = ["follow_carriers"]


@jit
def follow_carriers(first: int, last: int, epoch: Epoch) -> None:
    """Release integers of carriers that lost their lock or are too doubtful; repair or release those that slipped."""
    par, state, measured, work = epoch.parameters[0], epoch.state, epoch.measured, epoch.work
    satellites, rules = epoch.tables.satellites, par.rtk
    n = satellites.shape[0]
    variance = np.empty(n)
    for v in range(first, last):
        vehicle, w, los = state.vehicles[v], work.vehicles[v], measured.los[measured.sight[v]]
        tracked, phase, lost, ambiguities = (
            measured.tracked[v],
            measured.phase[v],
            measured.lock_lost[v],
            state.ambiguities[v],
        )
        phase_ok, factor = work.phase_ok[v], work.factor[v]
        for s in range(n):
            locked = tracked[s] and phase[s, 0] != 0.0 and (rules.bands == 1 or phase[s, 1] != 0.0)
            if not locked or lost[s]:
                ambiguities[s].held = False
            phase_ok[s] = locked
        cn0, used = measured.cn0[v], work.used[v]
        select(los, tracked, cn0, work.quality[v], rules.sin_mask, rules.cn0_min, factor, used)
        leave_out_faded(cn0, tracked, rules, par.dt, factor, used, ambiguities)
        if rules.reflections.sets > 0:
            update_odds(los, cn0, tracked, satellites, rules.reflections, ambiguities)
            keep_trusted(used, factor, UNUSED, rules.reflections, ambiguities)
        for s in range(n):
            variance[s] = factor[s] * rules.sigma_phase**2
        motion = DopplerMotion(par.dt, w.solved and vehicle.initialised, w.velocity, w.q, vehicle.position)
        carriers = Carriers(los, satellites, phase, variance)
        rtk = vehicle.rtk
        rtk.fixes += watch_slips(
            carriers, phase_ok, measured.age[v], motion, ambiguities, rules, par.slips, rtk.slips, rtk.fixes + 1
        )
