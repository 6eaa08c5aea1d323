"""How often errors exceed protection levels unnoticed: plain Monte Carlo of the measurement model.

An epoch is *misleading* on an axis when the separation test finds nothing and the error exceeds the level there. Nature
is drawn as the levels assume it: no fault, one faulty satellite, two at once, or a wrong fix that no test can see. A
fault is drawn with any size up to twice the threshold's: most of them harmless, others found (the worst ones are the
business of :mod:`lanebound.integrity.assessment.importance`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lanebound.integrity.assessment.measurement_model import Form, Prepared
from lanebound.integrity.monitoring.risk import multiple_fault_risk, upper_quantile

__all__ = ["STRATA", "ExceedanceCounts", "expected_fault_free", "least_fault_free", "tally"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

STRATA = ("no fault", "one fault", "two faults", "wrong fix")
AXES = 2
BLOCK = 4096  # epochs drawn at once: they stay in the cache
LARGEST_FAULT = 2.0  # of the size whose separation lies at the threshold
WAVELENGTH_M = 0.19029367279836487  # L1


@dataclass
class ExceedanceCounts:
    """Counts of misleading epochs: ``misleading[form]`` (R, 3, strata) along, across, either; ``epochs`` (strata,).

    ``available[form]`` (R,) epochs with a finite level, ``alarms`` (strata,) epochs in which the test found something.
    """

    misleading: dict[Form, Ints]
    available: dict[Form, Ints]
    epochs: Ints
    alarms: Ints = field(default_factory=lambda: np.zeros(len(STRATA), np.int64))

    @staticmethod
    def empty(risks: int) -> ExceedanceCounts:
        """Nothing counted yet."""
        return ExceedanceCounts(
            {form: np.zeros((risks, AXES + 1, len(STRATA)), np.int64) for form in Form},
            {form: np.zeros(risks, np.int64) for form in Form},
            np.zeros(len(STRATA), np.int64),
        )


def tally(
    prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator, into: ExceedanceCounts
) -> None:
    """Draw ``epochs`` of a case and add what is counted to ``into``; a wrong fix has probability ``wrong_fix``."""
    strata = _numbers_of_strata(prepared, epochs, wrong_fix, generator)
    for form, levels in prepared.levels_m.items():
        into.available[form] += epochs * np.isfinite(levels).all(-1)
    for stratum, count in enumerate(strata):
        into.epochs[stratum] += count
        for first in range(0, count, BLOCK):
            _count_block(prepared, stratum, min(BLOCK, count - first), generator, into)


def _numbers_of_strata(prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator) -> Ints:
    """How many of the epochs have no fault, one, two, or a wrong fix."""
    none, more = float(np.prod(1.0 - prepared.prior)), float(multiple_fault_risk(prepared.prior))
    faults = np.array([none, max(1.0 - none - more, 0.0), more])
    return np.asarray(generator.multinomial(epochs, [*(1.0 - wrong_fix) * faults, wrong_fix]))


def _count_block(
    prepared: Prepared, stratum: int, count: int, generator: np.random.Generator, into: ExceedanceCounts
) -> None:
    normal = generator.standard_normal((count, len(prepared.case)))
    error = normal @ prepared.error_rows.T + prepared.shift
    statistic = normal @ prepared.test_rows.T + prepared.test_shift
    if STRATA[stratum] == "wrong fix":
        turn = generator.uniform(0.0, 2.0 * np.pi, count)
        error += WAVELENGTH_M * np.stack([np.sin(turn), np.cos(turn)], -1)  # a shift of the position has no residual
    for _ in range({"one fault": 1, "two faults": 2}.get(STRATA[stratum], 0)):
        _add_faults(prepared, error, statistic, generator)
    quiet = np.maximum(statistic.max(-1), -statistic.min(-1)) < prepared.threshold
    into.alarms[stratum] += count - int(quiet.sum())
    least = np.minimum.reduce([levels.min(0) for levels in prepared.levels_m.values()])
    size = np.abs(error)
    size = size[quiet & (size > least).any(-1)]
    for form, levels in prepared.levels_m.items():
        for r, level in enumerate(levels):
            beyond = size > level
            if np.isfinite(level).all() and beyond.any():
                each = beyond.sum(0)
                into.misleading[form][r, :AXES, stratum] += each
                into.misleading[form][r, AXES, stratum] += beyond.any(-1).sum()


def _add_faults(prepared: Prepared, error: Array, statistic: Array, generator: np.random.Generator) -> None:
    """A fault in one satellite of each epoch, up to twice the size whose separation lies at the threshold."""
    chance = prepared.prior / prepared.prior.sum()
    which = generator.choice(len(prepared.case), size=len(error), p=chance)
    reach = prepared.threshold * prepared.sigma_of_fault_m
    size = generator.uniform(-LARGEST_FAULT, LARGEST_FAULT, len(error)) * reach[which]
    error += size[:, None] * prepared.fault_error[which]
    statistic += size[:, None] * prepared.fault_test[which]


def expected_fault_free(prepared: Prepared, form: Form) -> Array:
    """Probability that a fault-free error exceeds the level, tested or not, in closed form.  (R, 2)."""
    sigma = np.linalg.norm(prepared.error_rows, axis=-1)
    level = prepared.levels_m[form]
    return np.asarray(ndtr((prepared.shift - level) / sigma) + ndtr((-prepared.shift - level) / sigma))


def least_fault_free(prepared: Prepared, budgets: ArrayLike) -> Array:
    """The smallest levels that fault-free errors exceed no more often than ``budgets`` (R, 2).  -> (R, 2) [m].

    Whatever a level is above it guards against faults, or is caution.
    """
    sigma, shift = np.linalg.norm(prepared.error_rows, axis=-1), np.abs(prepared.shift)
    wanted = np.asarray(budgets, dtype=np.float64)
    low, high = np.zeros_like(wanted), shift + sigma * upper_quantile(0.5 * wanted)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = ndtr((shift - middle) / sigma) + ndtr((-shift - middle) / sigma) > wanted
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.asarray(high)
