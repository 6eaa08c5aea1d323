"""Wheel pulses of one vehicle over one epoch."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

# columns of ``par``
DECAY, INNOVATION_MPS, PULSE_M, SLIP_S2_PER_M, DROPOUT_MPS = range(5)


@jit
def roll(par, dt, scale, before_mps, noise_mps, carry_m, distance_m):  # type: ignore[no-untyped-def]
    """Distance counted in whole pulses [m], and the distance left over for the next epoch [m]."""
    speed = distance_m / dt
    rolled = 0.0
    if abs(speed) >= par[DROPOUT_MPS]:
        if math.isnan(before_mps):
            before_mps = speed
        slip = par[SLIP_S2_PER_M] * (abs(speed) - abs(before_mps)) / dt
        rolled = scale * (1.0 + slip) * distance_m + noise_mps * dt
    total = carry_m + rolled
    counted = math.trunc(total / par[PULSE_M]) * par[PULSE_M]
    return counted, total - counted


@jit
def measure(  # type: ignore[no-untyped-def]
    par, dt, z, scale, fault_scale, frozen, noise_mps, carry_m, last_distance_m, last_true_mps, truth_m, distance, speed
):
    """All vehicles, (B,) each: noise, carry and last message advance in place; a frozen odometer repeats itself."""
    for v in range(truth_m.shape[0]):
        noise_mps[v] = par[DECAY] * noise_mps[v] + par[INNOVATION_MPS] * z[v]
        counted, carry_m[v] = roll(
            par, dt, scale[v] * fault_scale[v], last_true_mps[v], noise_mps[v], carry_m[v], truth_m[v]
        )
        last_true_mps[v] = truth_m[v] / dt
        if not frozen[v]:
            last_distance_m[v] = counted
        distance[v] = last_distance_m[v]
        speed[v] = distance[v] / dt
