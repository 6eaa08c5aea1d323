"""Cycle slips of one satellite between two epochs: detection by three kinds of test, repair by integer search.

Letters: ``lambda_1``, ``lambda_2`` wavelengths [m] (0: no second band); those of :class:`Changes` and, ``s_`` before
the name, of :class:`Deviations`. All changes are free of the receiver clock (:func:`remove_common`, or between
satellites).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.positioning.lambda_kernel import (
    OK,
    bootstrap_failure_rate,
    integer_least_squares,
    search_scratch,
)

NO_SLIP, GEOMETRY_FREE, PREDICTED, CODE_PHASE = 0, 1, 2, 4  # bits of what detect_slip returns
REPAIRED, NOT_UNIQUE, HALF_CYCLE, INCONSISTENT = 0, 1, 2, 3  # values of cycle_slips.RepairStatus
REPAIR_NODES = 10_000
MIN_COMMON = 3  # a median of fewer satellites would take a slip for the clock


class Changes(NamedTuple):
    """Changes of one satellite between two epochs [m].

    phase_1, phase_2 by band; predicted change of the range; ionosphere: predicted change of ``phase_1 - phase_2``;
    code_1, code_2 by band.
    """

    phase_1: float
    phase_2: float
    predicted: float = 0.0
    ionosphere: float = 0.0
    code_1: float = 0.0
    code_2: float = 0.0


class Deviations(NamedTuple):
    """Standard deviations [m]: phase and code of one band at one epoch, of the prediction and of the ionosphere's
    change. An infinite one switches off the tests that need it."""

    phase: float
    predicted: float
    ionosphere: float
    code: float = math.inf


@jit
def sorted_median(values, count):  # type: ignore[no-untyped-def]
    """Median of the first ``count`` values, which are sorted in place: quicker than a partition for a dozen of them."""
    for i in range(1, count):
        value, k = values[i], i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@jit
def remove_common(change, member, system, n_systems, out):  # type: ignore[no-untyped-def]
    """Subtract the median change of each system's members: the receiver clock, whatever single satellites do.

    ``change``, ``member``, ``system`` (S,) -> ``out`` (S,), NaN (which no test passes judgement on) for satellites that
    are not members or whose system has fewer than 3 of them; ``out`` may be ``change``.
    """
    values = np.empty(change.shape[0])
    for k in range(n_systems):
        count = 0
        for s in range(change.shape[0]):
            if member[s] and system[s] == k:
                values[count] = change[s]
                count += 1
        middle = sorted_median(values, count) if count >= MIN_COMMON else math.nan
        for s in range(change.shape[0]):
            if system[s] == k:
                out[s] = change[s] - middle if member[s] else math.nan


@jit
def detect_slip(change: Changes, lambda_1: float, lambda_2: float, deviation: Deviations, k: float) -> int:
    """Which tests find a slip: NO_SLIP or a sum of GEOMETRY_FREE, PREDICTED and CODE_PHASE.

    A test rejects when its statistic exceeds k standard deviations:

    - geometry-free ``d1 - d2 - g``, variance ``4 s_phase^2 + s_iono^2``; blind to slips with
      ``lambda_1 N_1 = lambda_2 N_2``, nearly (9, 7) on L1 and L2;
    - Doppler-predicted ``d - p`` of each band, variance ``2 s_phase^2 + s_p^2`` (plus s_iono^2 on the second);
    - Melbourne-Wuebbena: wide-lane phase minus narrow-lane code, free of geometry and ionosphere, blind to N_1 = N_2.

    NaN statistics, and those of a missing band, do not reject.
    """
    d1, d2, p, g, c1, c2 = change
    s_phase, s_p, s_iono, s_code = deviation
    flags = NO_SLIP
    phase_var = 2.0 * s_phase * s_phase
    prediction_var = phase_var + s_p * s_p
    if abs(d1 - p) > k * math.sqrt(prediction_var):
        flags |= PREDICTED
    if not lambda_2 > 0.0:
        return flags
    if abs(d2 + g - p) > k * math.sqrt(prediction_var + s_iono * s_iono):
        flags |= PREDICTED
    if abs(d1 - d2 - g) > k * math.sqrt(2.0 * phase_var + s_iono * s_iono):
        flags |= GEOMETRY_FREE
    if not s_code < math.inf:
        return flags
    wide, narrow = 1.0 / (1.0 / lambda_1 - 1.0 / lambda_2), 1.0 / (1.0 / lambda_1 + 1.0 / lambda_2)
    spread = 1.0 / (lambda_1 * lambda_1) + 1.0 / (lambda_2 * lambda_2)
    jump = wide * (d1 / lambda_1 - d2 / lambda_2) - narrow * (c1 / lambda_1 + c2 / lambda_2)
    variance = spread * (wide * wide * phase_var + 2.0 * narrow * narrow * s_code * s_code)
    if abs(jump) > k * math.sqrt(variance):
        flags |= CODE_PHASE
    return flags


@jit
def repair_slip(
    change: Changes, lambda_1: float, lambda_2: float, deviation: Deviations, failure_limit: float, fit_limit: float,
    slips: NDArray[np.float64],
) -> int:  # fmt: skip
    """Find the slips (N_1, N_2) that explain both jumps, when only one pair can; returns a repair status.

    ``(d1 - p, d2 + g - p) = (lambda_1 N_1, lambda_2 N_2) + e``, where e has the prediction's error in common, is solved
    by integer least squares in half cycles. REPAIRED, with ``slips`` (2,) set, needs whole cycles, a bootstrapped
    failure rate within ``failure_limit``, a best norm within ``fit_limit`` (a chi-square quantile of 2 degrees), and a
    likelihood ratio to the runner-up of at least ``1 / failure_limit``. HALF_CYCLE: unique, but not whole; the others
    are not unique or fit nothing. Every status but REPAIRED requires a reset.
    """
    d1, d2, p, g, _, _ = change
    s_phase, s_p, s_iono, _ = deviation
    slips[0] = slips[1] = 0.0
    if not lambda_2 > 0.0:
        return NOT_UNIQUE
    scratch, a, Q = search_scratch(2, 2), np.empty(2), np.empty((2, 2))
    half_1, half_2 = 0.5 * lambda_1, 0.5 * lambda_2
    variance = 2.0 * s_phase * s_phase + s_p * s_p
    a[0], a[1] = (d1 - p) / half_1, (d2 + g - p) / half_2
    Q[0, 0] = variance / (half_1 * half_1)
    Q[1, 1] = (variance + s_iono * s_iono) / (half_2 * half_2)
    Q[0, 1] = Q[1, 0] = s_p * s_p / (half_1 * half_2)
    candidates, norms = scratch.candidates, scratch.norms
    status = integer_least_squares(2, a, Q, REPAIR_NODES, False, scratch)
    if status != OK or bootstrap_failure_rate(0, 2, scratch.D) > failure_limit:
        return NOT_UNIQUE
    if norms[0] > fit_limit:
        return INCONSISTENT
    if norms[1] - norms[0] < -2.0 * math.log(failure_limit):
        return NOT_UNIQUE
    if candidates[0, 0] % 2.0 != 0.0 or candidates[0, 1] % 2.0 != 0.0:
        return HALF_CYCLE
    slips[0], slips[1] = 0.5 * candidates[0, 0], 0.5 * candidates[0, 1]
    return REPAIRED
