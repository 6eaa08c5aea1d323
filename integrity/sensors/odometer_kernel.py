"""Wheel pulses of vehicles over one epoch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["ODOMETER_RULES", "WHEELS", "OdometerOutputs", "OdometerRows", "measure"]

Array = NDArray[np.float64]

ODOMETER_RULES = record(
    dt="length of an epoch [s]",
    decay="of the noise over an epoch [-]",
    innovation="of the noise in an epoch, 1 sigma [m/s]",
    pulse="distance of a pulse [m]",
    slip="per acceleration [s^2/m]",
    dropout="slower than this no pulse is detected [m/s]",
)

WHEELS = record(
    scale="[-]",
    noise_mps="correlated noise of the speed [m/s]",
    carry_m="distance not yet counted in pulses [m]",
    last_distance_m="last message [m]",
    last_true_mps="true speed of the last epoch, NaN before the first [m/s]",
)
"""What lasts of an odometer from epoch to epoch."""


class OdometerRows(NamedTuple):
    """Odometers of B vehicles: rules (1,) of ODOMETER_RULES, wheels (B,) of WHEELS, normals (B, 1) of the epoch."""

    rules: Records
    wheels: Records
    normals: Array


class OdometerOutputs(NamedTuple):
    """distance, speed (B,), as in :class:`~lanebound.integrity.sensors.odometer.OdometerSample`."""

    distance: Array
    speed: Array


@jit(borrows=True)
def roll(rules, wheels, fault_scale, distance_m):  # type: ignore[no-untyped-def]
    """Distance counted in whole pulses [m]; what is left over is carried to the next epoch."""
    speed, before = distance_m / rules.dt, wheels.last_true_mps
    rolled = 0.0
    if abs(speed) >= rules.dropout:
        if math.isnan(before):
            before = speed
        slip = rules.slip * (abs(speed) - abs(before)) / rules.dt
        rolled = wheels.scale * fault_scale * (1.0 + slip) * distance_m + wheels.noise_mps * rules.dt
    total = wheels.carry_m + rolled
    counted = math.trunc(total / rules.pulse) * rules.pulse
    wheels.carry_m = total - counted
    return counted


@jit(borrows=True)
def measure(first, last, odometer, truth_m, fault_scale, frozen, out):  # type: ignore[no-untyped-def]
    """Vehicles ``first`` to ``last - 1``: true distances, factor and freezing by faults (B,); frozen ones repeat."""
    rules = odometer.rules[0]
    for v in range(first, last):
        wheels = odometer.wheels[v]
        wheels.noise_mps = rules.decay * wheels.noise_mps + rules.innovation * odometer.normals[v, 0]
        counted = roll(rules, wheels, fault_scale[v], truth_m[v])
        wheels.last_true_mps = truth_m[v] / rules.dt
        if not frozen[v]:
            wheels.last_distance_m = counted
        out.distance[v] = wheels.last_distance_m
        out.speed[v] = out.distance[v] / rules.dt
