"""The reference link of one vehicle over one epoch."""

from __future__ import annotations

import math

from lanebound.integrity.accel import jit

# columns of ``par``
LATENCY_S, INTERVAL_S, ONSET_PROBABILITY, MEDIAN_S, LOG_SD, MAX_S = range(6)
ROUNDING = 1e-9  # share of an epoch or interval that floating-point division may be short of a whole number


@jit
def outage_epochs(par, dt, z):  # type: ignore[no-untyped-def]
    """Length of an outage in whole epochs, at least one: ``min(median exp(sd z), max)``."""
    length_s = min(par[MEDIAN_S] * math.exp(par[LOG_SD] * z), par[MAX_S])
    return max(math.ceil(length_s / dt - ROUNDING), 1)


@jit
def advance(par, dt, u, z, lost, epoch, due, newest, outage_left, age):  # type: ignore[no-untyped-def]
    """All vehicles, (B,) each: the state advances in place, ``age`` is filled; empty ``u``, ``z`` mean no outages."""
    for v in range(epoch.shape[0]):
        epoch[v] += 1
        if u.shape[0] > 0 and outage_left[v] == 0 and u[v] < par[ONSET_PROBABILITY]:
            outage_left[v] = outage_epochs(par, dt, z[v])
        up = outage_left[v] == 0
        if not up:
            outage_left[v] -= 1
        arrived = math.floor((epoch[v] * dt - par[LATENCY_S]) / par[INTERVAL_S] + ROUNDING)
        if arrived > due[v]:
            due[v] = arrived
            if up and not lost[v]:
                newest[v] = arrived
        age[v] = epoch[v] * dt - newest[v] * par[INTERVAL_S] if newest[v] >= 0 else math.inf
