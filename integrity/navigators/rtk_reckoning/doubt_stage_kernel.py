"""Stages of the heading monitor: the paths of two histories, and RTK positions that decide between them."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.heading_doubt_kernel import NONE, follow_paths, judge_by_path
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import reference_point
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch

__all__ = ["follow_histories", "judge_histories"]


@jit(borrows=True)
def follow_histories(first: int, last: int, epoch: Epoch) -> None:
    """Advance the paths by both headings while gyro and Doppler contradict each other."""
    state, dt = epoch.state, epoch.parameters[0].dt
    for v in range(first, last):
        vehicle, w = state.vehicles[v], epoch.work.vehicles[v]
        if vehicle.doubt.stage == NONE:
            continue
        east, north = vehicle.position[0] - w.before_e, vehicle.position[1] - w.before_n
        run = 0.0 if w.resting else dt * epoch.measured.speed[v]
        follow_paths(east, north, run, w.middle, w.reckoned, vehicle.doubt, state.growth[v])


@jit(borrows=True)
def judge_histories(first: int, last: int, epoch: Epoch) -> None:
    """Let RTK positions that are accepted, one epoch after the other, decide which heading was right."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.state.vehicles[v], epoch.work.vehicles[v]
        if vehicle.doubt.stage == NONE or not w.accepted:
            continue
        east, north = reference_point(w.fixed, par.lever, w.sin_h, w.cos_h)
        east, north = east - vehicle.position[0], north - vehicle.position[1]
        judge_by_path(east, north, w.fixed.lasting, vehicle.heading, vehicle.doubt)
