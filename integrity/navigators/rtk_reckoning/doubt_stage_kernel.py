"""Stages of the heading monitor: the paths of two histories, and RTK positions that decide between them."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.heading_doubt_kernel import NONE, follow_paths, judge_by_path, shift_of_lever
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import BACKUP, Epoch

__all__ = ["follow_histories", "judge_histories"]


@jit(borrows=True)
def follow_histories(first: int, last: int, epoch: Epoch) -> None:
    """Advance the paths by both headings while gyro and Doppler contradict each other."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if vehicle.doubt.stage == NONE:
            continue
        taken = vehicle.position[0] - w.before_e, vehicle.position[1] - w.before_n
        run = 0.0 if w.resting else par.dt * epoch.observed[v].speed
        follow_paths(taken, run, w.middle, w.reckoned, w.turned, par.lever, vehicle.doubt, vehicle.growth)
        if w.backup_run != 0.0:  # carriers moved the position; the backup solution took another path
            backup, run = vehicle.growth[BACKUP], w.backup_run
            off_e, off_n = taken[0] - run * math.sin(w.middle), taken[1] - run * math.cos(w.middle)
            backup.doppler_e, backup.doppler_n = backup.doppler_e + off_e, backup.doppler_n + off_n
            backup.gyro_e, backup.gyro_n = backup.gyro_e + off_e, backup.gyro_n + off_n


@jit(borrows=True)
def judge_histories(first: int, last: int, epoch: Epoch) -> None:
    """Let RTK positions that are accepted, one epoch after the other, decide which heading was right."""
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if vehicle.doubt.stage == NONE:
            continue
        if not w.accepted:
            vehicle.doubt.seen = False
            continue
        east, north = shift_of_lever(w.reckoned, w.turned, par.lever)
        path = vehicle.position[0] - w.before_e + east, vehicle.position[1] - w.before_n + north
        judge_by_path((w.fixed.position[0], w.fixed.position[1]), path, vehicle.heading, vehicle.doubt)
