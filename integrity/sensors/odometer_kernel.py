"""Wheel pulses of vehicles over one epoch."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["ODOMETER_RULES", "WHEELS", "measure", "measure_rows"]

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


@jit
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
def measure(rules, wheels, z, truth_m, moved, out):  # type: ignore[no-untyped-def]
    """Measure a vehicle by the draw z: distance and speed of ``out`` (OBSERVED_VEHICLE); ``wheels`` (WHEELS) advance.

    ``moved`` (VEHICLE_EFFECTS) has the factor and the freezing by faults; a frozen odometer repeats its last message.
    """
    wheels.noise_mps = rules.decay * wheels.noise_mps + rules.innovation * z
    counted = roll(rules, wheels, moved.odometer_scale, truth_m)
    wheels.last_true_mps = truth_m / rules.dt
    if not moved.odometer_frozen:
        wheels.last_distance_m = counted
    out.distance = wheels.last_distance_m
    out.speed = out.distance / rules.dt


@jit
def measure_rows(rules, wheels, z, truths, moved, out):  # type: ignore[no-untyped-def]
    """:func:`measure` for B vehicles: rules (1,), z (B, 1)."""
    for v in range(out.shape[0]):
        measure(rules[0], wheels[v], z[v, 0], truths[v].distance, moved[v], out[v])
