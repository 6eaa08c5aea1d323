"""Rate of undetected errors above the protection levels, by plain Monte Carlo of the measurement model.

An epoch is *misleading* on an axis if the separation test detects nothing and the error exceeds the level. Faults are
drawn as assumed by the levels: none, one faulty satellite, two at once, or a wrong fix that the test cannot detect. The
size of a fault is uniform up to twice the size at the threshold: most faults are harmless or detected. The worst sizes
are the subject of :mod:`lanebound.integrity.assessment.importance`.
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
BLOCK = 4096  # epochs drawn at once, which fit into the processor cache
LARGEST_FAULT = 2.0  # in units of the size whose separation is at the threshold
WAVELENGTH_M = 0.19029367279836487  # L1


@dataclass
class ExceedanceCounts:
    """Counts of misleading epochs: ``misleading[form]`` (R, 3, strata) along, across, either; ``epochs`` (strata,).

    ``available[form]`` (R,) epochs with a finite level, ``alarms`` (strata,) epochs with a detection.
    """

    misleading: dict[Form, Ints]
    available: dict[Form, Ints]
    epochs: Ints
    alarms: Ints = field(default_factory=lambda: np.zeros(len(STRATA), np.int64))

    @staticmethod
    def empty(risks: int) -> ExceedanceCounts:
        """Counts of zero."""
        return ExceedanceCounts(
            {form: np.zeros((risks, AXES + 1, len(STRATA)), np.int64) for form in Form},
            {form: np.zeros(risks, np.int64) for form in Form},
            np.zeros(len(STRATA), np.int64),
        )


def tally(
    prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator, into: ExceedanceCounts
) -> None:
    """Draw ``epochs`` of a case and add the counts to ``into``; ``wrong_fix`` is the probability of a wrong fix."""
    strata = _numbers_of_strata(prepared, epochs, wrong_fix, generator)
    for form, levels in prepared.levels_m.items():
        into.available[form] += epochs * np.isfinite(levels).all(-1)
    for stratum, count in enumerate(strata):
        into.epochs[stratum] += count
        for first in range(0, count, BLOCK):
            _count_block(prepared, stratum, min(BLOCK, count - first), generator, into)


def _numbers_of_strata(prepared: Prepared, epochs: int, wrong_fix: float, generator: np.random.Generator) -> Ints:
    """Draw the numbers of epochs without fault, with one fault, with two, and with a wrong fix."""
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
    """Add a fault in one satellite of each epoch, up to twice the size whose separation is at the threshold."""
    chance = prepared.prior / prepared.prior.sum()
    which = generator.choice(len(prepared.case), size=len(error), p=chance)
    reach = prepared.threshold * prepared.sigma_of_fault_m
    size = generator.uniform(-LARGEST_FAULT, LARGEST_FAULT, len(error)) * reach[which]
    error += size[:, None] * prepared.fault_error[which]
    statistic += size[:, None] * prepared.fault_test[which]


def expected_fault_free(prepared: Prepared, form: Form) -> Array:
    """Probability in closed form that a fault-free error exceeds the level, without regard to the test.  (R, 2)."""
    sigma = np.linalg.norm(prepared.error_rows, axis=-1)
    level = prepared.levels_m[form]
    return np.asarray(ndtr((prepared.shift - level) / sigma) + ndtr((-prepared.shift - level) / sigma))


def least_fault_free(prepared: Prepared, budgets: ArrayLike) -> Array:
    """Smallest levels that fault-free errors exceed with at most the probabilities ``budgets`` (R, 2).  -> (R, 2) [m].

    The difference to a protection level is the margin for faults, or conservatism.
    """
    sigma, shift = np.linalg.norm(prepared.error_rows, axis=-1), np.abs(prepared.shift)
    wanted = np.asarray(budgets, dtype=np.float64)
    low, high = np.zeros_like(wanted), shift + sigma * upper_quantile(0.5 * wanted)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = ndtr((shift - middle) / sigma) + ndtr((-shift - middle) / sigma) > wanted
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.asarray(high)
