"""Code errors of the training part of a drive with known truth, to which the error bounds are fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.replay.overbound import CodeErrors, fit_overbound
from lanebound.integrity.replay.sagnac import ranges_and_sights

__all__ = ["code_errors", "train"]

Array = NDArray[np.float64]

STRONG_DBHZ = 42.0  # stronger signals, mostly direct ones, determine the clock
SECONDS_PER_TERM = 10.0  # duration for each term of the clock polynomial
EARLY_M, LATE_M = 6.0, 3.0  # scales of negative and positive errors in the robust fit; positive ones get less weight
ROUNDS = 50


def code_errors(drive: SmartLoc, until_s: float) -> tuple[NDArray[np.bool_], Array]:
    """Compute the code errors (n,) [m] of pseudoranges before a time with a known truth; also returns their mask.

    Errors are ``range - distance - clock``. The clock of the receiver is a polynomial in time and an offset for each
    further system. It is fitted robustly to strong signals: reflections make ranges too long, therefore positive errors
    get less weight (Cauchy weights with two scales). An error of the fit is common to all satellites, like the clock of
    a solution.

    Raises
    ------
    InputError
        There is no truth, or not enough strong signals.
    """
    if drive.truth is None:
        raise InputError("drive must have a ground truth to train on, has none: give its *_GT file")
    ranges = drive.ranges
    position, known = drive.truth.at(ranges.time_s)
    keep = known & (ranges.time_s < until_s)
    distance, _ = ranges_and_sights(ranges.satellite_ecef_m[keep], position[keep])
    raw, time = ranges.range_m[keep] - distance, ranges.time_s[keep]
    strong = ranges.cn0_dbhz[keep] >= STRONG_DBHZ
    design = _clock_terms(time, ranges.system[keep])
    if int(strong.sum()) < 4 * design.shape[1]:
        raise InputError(
            f"the training part must have {4 * design.shape[1]} signals above {STRONG_DBHZ:g} dB-Hz, got "
            f"{int(strong.sum())}: train on more"
        )
    weight = np.ones(int(strong.sum()))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        x = np.linalg.lstsq(design[strong] * root[:, None], raw[strong] * root, rcond=None)[0]
        v = raw[strong] - design[strong] @ x
        weight = 1.0 / (1.0 + (v / np.where(v > 0.0, LATE_M, EARLY_M)) ** 2)
    return keep, raw - design @ x


def _clock_terms(time_s: Array, system: NDArray[np.str_]) -> Array:
    """Columns of the clock: Chebyshev polynomials and one offset for each system after the first."""
    span = max(float(np.ptp(time_s)), 1.0)
    terms = np.polynomial.chebyshev.chebvander(2.0 * (time_s - time_s.min()) / span - 1.0, int(span / SECONDS_PER_TERM))
    others = [(system == letter).astype(np.float64) for letter in np.unique(system)[1:]]
    return np.column_stack([terms, *others])


def train(drive: SmartLoc, until_s: float, outside: float = 0.0) -> CodeErrors:
    """Fit bounds of the code errors to the part before ``until_s``; ``outside`` as in :func:`.fit_overbound`."""
    keep, error = code_errors(drive, until_s)
    r = drive.ranges
    return fit_overbound(error, r.cn0_dbhz[keep], r.time_s[keep], r.satellite[keep], outside)
