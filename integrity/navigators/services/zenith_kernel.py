"""Zenith delay of the troposphere as a state of PPP: a scalar filter beside the position of each epoch.

Least squares of an epoch with position, clocks and zenith delay as unknowns give the delay and its variance R. The
filter predicts a Gauss-Markov process and takes the epoch with ``K = P / (P + R)``, R raised for errors that last.
Ranges are corrected by ``m(el) z``, and their variance holds ``m^2 P``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.records_kernel import ServiceRows, ServiceTables

__all__ = ["CARRIER_RULES", "ZENITH", "CarrierTables", "estimate_zenith", "map_zenith", "zenith_of_epoch"]

Array = NDArray[np.float64]
N = 4  # unknowns: position and zenith delay

CARRIER_RULES = record(
    correlation="time of code errors [s]",
    phase="carrier of one band, zenith, 1 sigma [m]; 0 where no carrier is used",
    zenith=("?", "the zenith delay is a state"),
    zenith_sigma="its deviation, 1 sigma [m]",
    zenith_tau="its correlation time [s]",
    lasting="epochs for which errors of the zenith delay of an epoch last [-]",
)
ZENITH = record(value="zenith delay less the model [m]", variance="of it [m^2]; 0: not yet begun")


class CarrierTables(NamedTuple):
    """rules (1,) of CARRIER_RULES; zenith (B,) of ZENITH."""

    rules: Records
    zenith: Records


@jit(borrows=True)
def map_zenith(sine: float) -> float:
    """Slant over zenith delay, ``1.001 / sqrt(0.002001 + sin^2 E)`` (RTCA DO-229, A.4.2.4)."""
    return 1.001 / math.sqrt(0.002001 + sine * sine)


@jit
def estimate_zenith(v: int, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, carrier: CarrierTables) -> None:
    """Advance the zenith delay of vehicle v by an interval, and correct its ranges by it."""
    rules, state, los = carrier.rules[0], carrier.zenith[v], epoch.measured.los[epoch.measured.sight[v]]
    prior = rules.zenith_sigma**2
    if state.variance == 0.0:
        state.value, state.variance = 0.0, prior
    decay = math.exp(-service.rules[0].interval / rules.zenith_tau)
    state.value *= decay
    state.variance = decay * decay * state.variance + (1.0 - decay * decay) * prior
    found, value, variance = zenith_of_epoch(
        los, service.tables.system, ranges.y[v], ranges.variance[v], ranges.used[v]
    )
    if found:
        gain = state.variance / (state.variance + rules.lasting * variance)
        state.value += gain * (value - state.value)
        state.variance *= 1.0 - gain
    for s in range(los.shape[0]):
        if ranges.used[v, s]:
            slant = map_zenith(los[s, 2])
            ranges.y[v, s] -= slant * state.value
            ranges.variance[v, s] += slant * slant * state.variance


@jit
def zenith_of_epoch(
    los: Array, system: NDArray[np.int64], y: Array, variance: Array, used: NDArray[np.bool_]
) -> tuple[bool, float, float]:
    """Zenith delay of an epoch by least squares with position and clocks free: (solved, delay [m], variance [m^2])."""
    mean, weight = np.zeros((MAX_GROUPS, N + 1)), np.zeros(MAX_GROUPS)
    row, a = np.empty(N + 1), np.zeros((N, N + 1))
    for s in range(y.shape[0]):
        if used[s]:
            w, g = 1.0 / variance[s], system[s]
            weight[g] += w
            for k in range(3):
                mean[g, k] -= w * los[s, k]
            mean[g, 3] += w * map_zenith(los[s, 2])
            mean[g, N] += w * y[s]
    for s in range(y.shape[0]):
        if used[s]:
            w, g = 1.0 / variance[s], system[s]
            for k in range(3):
                row[k] = -los[s, k] - mean[g, k] / weight[g]
            row[3] = map_zenith(los[s, 2]) - mean[g, 3] / weight[g]
            row[N] = y[s] - mean[g, N] / weight[g]
            for i in range(N):
                for j in range(N + 1):
                    a[i, j] += w * row[i] * row[j]
    for i in range(N):  # elimination: the zenith delay is the last unknown, so its pivot is the inverse of its variance
        pivot = a[i, i]
        if not pivot > 1e-9:
            return False, 0.0, 0.0
        for j in range(i + 1, N):
            share = a[j, i] / pivot
            for k in range(i, N + 1):
                a[j, k] -= share * a[i, k]
    return True, a[N - 1, N] / a[N - 1, N - 1], 1.0 / a[N - 1, N - 1]
