"""The stages before and after the positions of services: what is offered begins anew, and the mode is reported."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.records_kernel import ServiceLabels
from lanebound.integrity.positioning.codes_kernel import DOPPLER, IMU_ODOMETER, NO_CORRECTIONS, NRTK, RTK

__all__ = ["begin_services", "begin_without_rtk", "label_services"]


@jit
def begin_services(first: int, last: int, epoch: Epoch, labels: ServiceLabels) -> None:
    """No service has offered a position in this epoch."""
    for v in range(first, last):
        labels.offered[v], epoch.work.vehicles[v].fixed.turned = 0, False


@jit
def begin_without_rtk(first: int, last: int, epoch: Epoch, labels: ServiceLabels) -> None:
    """The same where RTK is not among the services: there is no RTK position."""
    for v in range(first, last):
        labels.offered[v] = 0
        fixed, levels = epoch.work.vehicles[v].fixed, epoch.work.fixed_levels[v]
        fixed.status, fixed.usable, fixed.coded, fixed.lasting = NO_CORRECTIONS, False, False, False
        fixed.satellites, fixed.excluded, fixed.searched, fixed.hdop = 0, 0, 0, math.inf
        fixed.wrong, fixed.failure, fixed.turned = 0.0, 0.0, False
        levels[:, :] = 0.0


@jit
def label_services(first: int, last: int, epoch: Epoch, labels: ServiceLabels, network: bool, recent_s: float) -> None:
    """Report the service that the position came from, also where dead reckoning has moved it for ``recent_s`` at
    most.

    The position of a service is no RTK position that lasts.
    """
    par = epoch.parameters[0]
    for v in range(first, last):
        vehicle, w = epoch.state.vehicles[v], epoch.work.vehicles[v]
        if w.mode == RTK:
            labels.latest[v] = labels.offered[v]
            if labels.offered[v] > 0:
                epoch.out.mode[v], vehicle.since_rtk = labels.offered[v], par.dt
            elif network:
                epoch.out.mode[v] = NRTK
        elif labels.latest[v] > 0 and vehicle.since_rtk <= recent_s and (w.mode == DOPPLER or w.mode == IMU_ODOMETER):
            epoch.out.mode[v] = labels.latest[v]
