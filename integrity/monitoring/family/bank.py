"""ERAIM: a bank of filters aided by displacements, the one of all codes and one without each code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.levels import LevelWork
from lanebound.integrity.monitoring.family.memory import Memory, Remembered, blend, rows_of, share_of, steps_of
from lanebound.integrity.monitoring.family.separations import separations
from lanebound.integrity.monitoring.protection import multi_hypothesis
from lanebound.integrity.monitoring.risk import false_alarm_factor
from lanebound.integrity.monitoring.separation import Separation

__all__ = ["BankMemory", "extended"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


NOISE_M = 1e-9  # of rounding, in separations


@dataclass
class BankMemory(Memory):
    """Banks of B vehicles with m satellites: of the filter of all codes and of those without each one, position,
    deviation (inf before it has begun) and deviation of the separation (B, 1 + m, 2); and which codes have entered the
    bank since it began (B, m)."""

    position_m: Array
    sigma_m: Array
    delta_m: Array
    entered: Bools

    @classmethod
    def new(cls, batch: int, columns: int, risks: int) -> BankMemory:
        """See :class:`~lanebound.integrity.monitoring.family.memory.Memory`."""
        shape = (batch, 1 + columns, 2)
        return cls(np.zeros(shape), np.full(shape, np.inf), np.zeros(shape), np.zeros((batch, columns), bool))


def extended(work: LevelWork) -> Remembered:
    """ERAIM: the level is the root of the sum over hypotheses (S2 eq 10-11), the alarm its separation test.

    Deviations follow ``s = (1 - K) (s + q) + K sigma``, those of separations the same with what the gains differ by. A
    code that has entered the bank stays a hypothesis until the drive ends, and the separations are tested at every
    epoch, with codes or without: what a faulty code has moved stays in the filters when it is gone.
    """
    fit, (step, spread) = work.fit, steps_of(work)
    parts = separations(fit)
    count, modes = parts.sigma_m.shape[:2]
    snapshot = fit.x_m[:, None, :2] - parts.separation_m
    there = np.isfinite(parts.sigma_m) & fit.solved[:, None, None]
    position, entered = fit.x_m.copy(), np.zeros(fit.used.shape, bool)
    sigma, delta, apart = np.full((count, modes, 2), np.inf), np.zeros((count, modes, 2)), np.zeros((count, modes, 2))
    memory, rows = rows_of(work, BankMemory)
    for at in rows:
        anew = np.isinf(spread[at])
        x, s = memory.position_m + step[at, None], memory.sigma_m + spread[at, None]
        share = share_of(s, parts.sigma_m[at], there[at])
        old = np.where(np.isfinite(s), memory.delta_m, 0.0)
        other = np.abs(share[:, :1] - share)  # moves a filter apart by the innovation of the filter of all codes
        moved = (other > 0.0) & np.isfinite(s[:, :1]) & (np.isfinite(s) | there[at])
        innovation = np.where(moved, s[:, :1] + parts.sigma_m[at, :1], 0.0)
        memory.delta_m = (1.0 - share) * old + share * parts.delta_m[at] + other * innovation
        memory.position_m = x + share * (snapshot[at] - x)
        memory.sigma_m = blend(share, s, parts.sigma_m[at])
        memory.entered = np.where(anew, False, memory.entered) | (fit.used[at] & fit.solved[at, None])
        position[at, :2], entered[at] = memory.position_m[:, 0], memory.entered
        sigma[at], delta[at], apart[at] = memory.sigma_m, memory.delta_m, memory.position_m[:, :1] - memory.position_m
    known = np.isfinite(sigma) & np.isfinite(sigma[:, :1])
    bank = Separation(sigma, delta, np.zeros_like(sigma), apart, np.zeros((count, modes), np.int64), parts.gain_track)
    k_fa = false_alarm_factor(work.config.false_alarm, entered.sum(-1))
    failed = (known & (np.abs(apart) > k_fa[:, None, None] * delta + NOISE_M)).any((1, 2))
    level = bank_levels(bank, entered, work.config, work.risks, k_fa)
    return Remembered(position, level, work.alarm | failed, np.isfinite(sigma[:, 0, 0]))


def bank_levels(bank: Separation, entered: Bools, config: FamilyMonitorConfig, risks: Array, k_fa: Array) -> Array:
    """Root of the sum over hypotheses, half of the risk on each axis.  (E, R)."""
    prior = np.concatenate([np.full((len(entered), 1), 2.0), config.satellite_prior * entered], 1)
    levels = [multi_hypothesis(bank, prior, k_fa, np.full((len(entered), 2), 0.5 * risk)) for risk in risks]
    return np.stack([np.hypot(level[:, 0], level[:, 1]) for level in levels], -1)
