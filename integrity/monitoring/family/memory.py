"""What levels with memory share, and KIPL: a filter aided by displacements.

The filters work on positions, on East and North apart: ``x^- = x + step``, ``K = P^- / (P^- + sigma^2)``. Errors of
codes last for seconds to minutes, so that no filter takes them as independent between epochs: deviations of old and
new errors add up as they are, not as squares. That is exact for errors that do not change, and an upper bound of the
deviation for every other correlation.

A method has one memory for each vehicle. Recorded epochs come one after another into the memory of one vehicle
(:func:`rows_of`), epochs of a batch each into that of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.levels import LevelWork, isotropic_factor, normal_factor, times

__all__ = ["KalmanMemory", "Memory", "Remembered", "blend", "isotropic_kalman", "rows_of", "share_of", "steps_of"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


LEAST_STEP_M = 1e-3  # deviation of a step, that gains stay positive


@dataclass(frozen=True)
class Remembered:
    """Positions (E, 3), levels (E, R), inf where none, alarms (E,), and where the method has begun (E,).

    ``used`` and ``excluded`` (E, m) are those of the position where they are not those of the codes, else None.
    """

    position_enu_m: Array
    hpl_m: Array
    alarm: Bools
    begun: Bools
    used: Bools | None = None
    excluded: Bools | None = None


class Memory(ABC):
    """What a method keeps of each vehicle: a dataclass of arrays (B, ...)."""

    @classmethod
    @abstractmethod
    def new(cls, batch: int, columns: int, risks: int) -> Self:
        """Memories that have not begun, of vehicles with ``columns`` satellites."""

    def take(self, rows: Any) -> Self:
        """The memories of some vehicles, copied."""
        return type(self)(**{name: value[rows].copy() for name, value in vars(self).items()})

    def put(self, rows: Any, part: Memory) -> None:
        """Write memories of some vehicles back."""
        for name, value in vars(part).items():
            getattr(self, name)[rows] = value


M = TypeVar("M", bound=Memory)


def rows_of(work: LevelWork, kind: type[M]) -> tuple[M, list[slice]]:
    """The memory of the work and all its rows at once, or a new one of one vehicle and row after row."""
    if work.memory is not None:
        assert isinstance(work.memory, kind)
        return work.memory, [slice(None)]
    new = kind.new(1, work.epochs.y_m.shape[1], work.risks.size)
    return new, [slice(k, k + 1) for k in range(work.epochs.count)]


def steps_of(work: LevelWork) -> tuple[Array, Array]:
    """Steps (E, 2) and their deviations (E, 1), inf where unknown and at the beginning of a drive."""
    epochs: CodeEpochs = work.epochs
    if epochs.step_enu_m is None or epochs.step_sigma_m is None:
        raise InputError("step_enu_m must be known for filters, got None: add wheels, gyro or Doppler to the epochs")
    begins = epochs.starts() if work.memory is None else np.zeros(epochs.count, bool)
    spread = np.where(begins, np.inf, np.maximum(epochs.step_sigma_m, LEAST_STEP_M))[:, None]
    return np.where(np.isfinite(spread), epochs.step_enu_m[:, :2], 0.0), spread


def share_of(before: Array, own: Array, there: Bools) -> Array:
    """Gain ``K`` of a filter of deviation ``before`` for a position of deviation ``own``; 1 if it knows nothing."""
    known = np.isfinite(before)
    square = np.square(np.where(known, before, 1.0))
    return np.where(there, np.where(known, square / (square + np.square(np.where(there, own, 1.0))), 1.0), 0.0)


def blend(share: Array, old: Array, new: Array) -> Array:
    """``(1 - K) old + K new``, where K = 0 or 1 takes nothing of the other, be it infinite."""
    with np.errstate(invalid="ignore"):
        return np.where(share >= 1.0, new, np.where(share <= 0.0, old, (1.0 - share) * old + share * new))


@dataclass
class KalmanMemory(Memory):
    """KIPL of B vehicles: position (B, 2), its deviation (B, 2), inf before it has begun, and levels (B, R)."""

    position_m: Array
    sigma_m: Array
    level_m: Array

    @classmethod
    def new(cls, batch: int, columns: int, risks: int) -> KalmanMemory:
        """See :class:`Memory`."""
        return cls(np.zeros((batch, 2)), np.full((batch, 2), np.inf), np.full((batch, risks), np.inf))


def isotropic_kalman(work: LevelWork) -> Remembered:
    """KIPL in a conservative form.

    ``L_k = max(1 - K) (L_{k-1} + z q) + max(K) k |r| d_major``: the level of the old position, grown by the quantile z
    of the step's error, and the isotropic level of the new one, each by its share. Levels add up where the errors of
    all epochs are jointly elliptical (as the isotropic law is), whatever their correlation; an epoch without redundancy
    only moves the position.
    """
    fit, (step, spread) = work.fit, steps_of(work)
    good = (fit.solved & (fit.df > 0))[:, None]
    size = np.where(good, (np.sqrt(fit.wsse) * fit.major_m)[:, None], 0.0)
    factor = times(isotropic_factor(np.maximum(fit.df, 1), work.risks), size)
    z, own = normal_factor(work.risks), np.sqrt(np.diagonal(fit.cofactor, axis1=1, axis2=2)[:, :2])
    position, level, begun = fit.x_m.copy(), np.full(factor.shape, np.inf), np.zeros(fit.df.size, bool)
    memory, rows = rows_of(work, KalmanMemory)
    for at in rows:
        x, s = memory.position_m + step[at], np.hypot(memory.sigma_m, spread[at])
        share = share_of(s, own[at], good[at])
        least, most = share.min(-1, keepdims=True), share.max(-1, keepdims=True)
        grown = np.where(least < 1.0, memory.level_m + z * spread[at], 0.0)
        memory.level_m = (1.0 - least) * grown + most * factor[at]
        memory.position_m = x + share * (fit.x_m[at, :2] - x)
        memory.sigma_m = np.where(good[at], np.sqrt(share) * own[at], s)
        position[at, :2], level[at] = memory.position_m, memory.level_m
        begun[at] = np.isfinite(memory.level_m).any(-1)
    return Remembered(position, level, work.alarm, begun)
