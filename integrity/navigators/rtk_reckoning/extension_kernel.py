"""The first stage of an epoch, and what plug-in modes and stages call.

A plug-in stage is ``stage(first, last, epoch, own)`` with ``own`` of :class:`~.records_kernel.Own`, compiled by
:func:`~lanebound.integrity.core.accel.jit` or plain Python.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.alerts_kernel import NONE
from lanebound.integrity.monitoring.jump_kernel import begin_epoch
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.codes_kernel import UNDECIDED

__all__ = ["begin", "exclude_satellite", "raise_alert", "raise_level", "refuse_doppler", "refuse_fix"]


@jit(borrows=True)
def begin(first: int, last: int, epoch: Epoch) -> None:
    """Advance the clocks. Nothing is estimated yet, and no level is known."""
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        epoch.levels[v, :, :] = math.inf
        begin_epoch(epoch.parameters[0].dt, vehicle.jump)
        vehicle.since_rtk += epoch.parameters[0].dt
        vehicle.since_calibration += epoch.parameters[0].dt
        vehicle.backup.age += epoch.parameters[0].dt
        w.mode, w.integrates, w.run, w.backup_run, w.excluded, w.cause = UNDECIDED, False, 0.0, 0.0, 0, NONE


@jit
def exclude_satellite(epoch: Epoch, v: int, s: int) -> None:
    """Exclude satellite s from this epoch of vehicle v; before anything is estimated (Point.MEASURED)."""
    if epoch.signals[v, s].tracked:
        epoch.signals[v, s].tracked = False
        epoch.work[v].excluded += 1


@jit
def refuse_doppler(w: Any) -> None:
    """The Doppler velocity does not move the position in this epoch (Point.ESTIMATED)."""
    w.doppler_moves = False


@jit
def refuse_fix(w: Any) -> None:
    """The RTK position is not used in this epoch (Point.ESTIMATED)."""
    w.fixed.usable = False


@jit
def raise_alert(w: Any, code: int) -> None:
    """Ask for an alert in this epoch, whatever the levels are, with a code of AlertReason; the first code stays.

    The alert follows ``alert.raise_after_s`` as any other.
    """
    if w.cause == NONE:
        w.cause = code


@jit
def raise_level(epoch: Epoch, v: int, case: int, axis: int, level: float) -> None:
    """Raise the protection level of vehicle v, of one case along (0) or across track (1), to ``level`` [m] at least.

    A NaN counts as no level, ``inf``. Only at Point.BOUNDED: earlier stages come before the levels are computed. It
    holds for this epoch; dead reckoning after RTK starts from the level before. So raise it as long as it must hold.
    """
    if not level <= epoch.levels[v, case, axis]:
        epoch.levels[v, case, axis] = level if level == level else math.inf
