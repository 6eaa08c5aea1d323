"""The stages before and after the positions of services: what is offered begins anew, and the mode is reported."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.positioning.codes_kernel import DOPPLER, IMU_ODOMETER, NO_CORRECTIONS, NRTK, RTK

__all__ = ["begin_services", "begin_without_rtk", "label_services"]


@jit
def begin_services(first: int, last: int, epoch: Epoch, labels: Records) -> None:
    """No service has offered a position in this epoch."""
    for v in range(first, last):
        labels[v].offered, epoch.work[v].fixed.turned = 0, False


@jit
def begin_without_rtk(first: int, last: int, epoch: Epoch, labels: Records) -> None:
    """The same where RTK is not among the services: there is no RTK position."""
    for v in range(first, last):
        labels[v].offered = 0
        fixed, levels = epoch.work[v].fixed, epoch.fixed_levels[v]
        fixed.status, fixed.usable, fixed.coded, fixed.lasting = NO_CORRECTIONS, False, False, False
        fixed.satellites, fixed.excluded, fixed.searched, fixed.hdop = 0, 0, 0, math.inf
        fixed.wrong, fixed.failure, fixed.turned = 0.0, 0.0, False
        levels[:, :] = 0.0


@jit
def label_services(first: int, last: int, epoch: Epoch, labels: Records, network: bool, recent_s: float) -> None:
    """Report the service that the position came from, also where dead reckoning has moved it for ``recent_s`` at
    most.

    The position of a service is no RTK position that lasts.
    """
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.vehicles[v], epoch.work[v]
        if w.mode == RTK:
            labels[v].latest = labels[v].offered
            if labels[v].offered > 0:
                epoch.out[v].mode, vehicle.since_rtk = labels[v].offered, par.dt
            elif network:
                epoch.out[v].mode = NRTK
        elif labels[v].latest > 0 and vehicle.since_rtk <= recent_s and (w.mode == DOPPLER or w.mode == IMU_ODOMETER):
            epoch.out[v].mode = labels[v].latest
