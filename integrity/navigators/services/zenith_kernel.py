"""Zenith delay of the troposphere as a state of PPP: a scalar filter next to the position of each epoch.

Least squares of an epoch with position, clocks and zenith delay as unknowns give the delay and its variance R. The
filter predicts a Gauss-Markov process and takes the epoch with ``K = P / (P + R)``, R raised for errors that last.
Ranges are corrected by ``m(el) z``, and their variance holds ``(m - 1)^2 P``: what is common is in the clocks.

Fault detection works on ranges that the predicted delay corrects. Only the ranges that it leaves in use, in an epoch
that passes, change the delay; then all ranges have the new one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.services.records_kernel import ServiceRows, ServiceTables
from lanebound.integrity.positioning.code_errors_kernel import troposphere_slant

__all__ = ["CARRIER_RULES", "ZENITH", "CarrierTables", "predict_zenith", "update_zenith", "zenith_of_epoch"]

N = 4  # unknowns: position and zenith delay

CARRIER_RULES = record(
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


@jit
def predict_zenith(v: int, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, carrier: CarrierTables) -> None:
    """Advance the zenith delay of vehicle v by an interval, and correct its ranges by it."""
    rules, state = carrier.rules[0], carrier.zenith[v]
    prior = rules.zenith_sigma**2
    if state.variance == 0.0:
        state.value, state.variance = 0.0, prior
    decay = math.exp(-service.rules[0].interval / rules.zenith_tau)
    state.value *= decay
    state.variance = decay * decay * state.variance + (1.0 - decay * decay) * prior
    correct(state.value, state.variance, ranges.rows[v])


@jit
def update_zenith(v: int, epoch: Epoch, service: ServiceTables, ranges: ServiceRows, carrier: CarrierTables) -> None:
    """Take an epoch that has passed its fault test into the zenith delay of vehicle v, and correct its ranges anew."""
    rules, state, rows = carrier.rules[0], carrier.zenith[v], ranges.rows[v]
    value, variance = state.value, state.variance
    correct(-value, -variance, rows)
    found, of_epoch, spread = zenith_of_epoch(rows)
    if found:
        gain = variance / (variance + rules.lasting * spread)
        state.value = value + gain * (of_epoch - value)
        state.variance = variance * (1.0 - gain)
    correct(state.value, state.variance, rows)


@jit
def correct(value: float, variance: float, rows: Records) -> None:
    """Subtract a zenith delay from the rows (S,) in use, and add its variance to theirs."""
    for s in range(rows.shape[0]):
        row = rows[s]
        if row.used:
            slant = troposphere_slant(row.e[2])
            row.y -= slant * value
            row.variance += (slant - 1.0) ** 2 * variance


@jit
def zenith_of_epoch(rows: Records) -> tuple[bool, float, float]:
    """Zenith delay of an epoch by least squares with position and clocks free: (solved, delay [m], variance [m^2])."""
    mean, weight = np.zeros((MAX_GROUPS, N + 1)), np.zeros(MAX_GROUPS)
    row, a = np.empty(N + 1), np.zeros((N, N + 1))
    for s in range(rows.shape[0]):
        here = rows[s]
        if here.used:
            w, g = 1.0 / here.variance, here.system
            weight[g] += w
            for k in range(3):
                mean[g, k] -= w * here.e[k]
            mean[g, 3] += w * troposphere_slant(here.e[2])
            mean[g, N] += w * here.y
    for s in range(rows.shape[0]):
        here = rows[s]
        if here.used:
            w, g = 1.0 / here.variance, here.system
            for k in range(3):
                row[k] = -here.e[k] - mean[g, k] / weight[g]
            row[3] = troposphere_slant(here.e[2]) - mean[g, 3] / weight[g]
            row[N] = here.y - mean[g, N] / weight[g]
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
