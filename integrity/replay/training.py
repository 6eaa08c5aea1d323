"""Code errors of a part of a drive whose truth is known: what bounds are fitted on, and on nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.replay.overbound import CodeErrors, fit_overbound
from lanebound.integrity.replay.sagnac import ranges_and_sights

__all__ = ["code_errors", "train"]

Array = NDArray[np.float64]

STRONG_DBHZ = 42.0  # signals that tell of the clock: mostly direct
SECONDS_PER_TERM = 10.0  # of the polynomial of the receiver's clock
EARLY_M, LATE_M = 6.0, 3.0  # scales beyond which an error does not move the clock: late ones say less
ROUNDS = 50


def code_errors(drive: SmartLoc, until_s: float) -> tuple[NDArray[np.bool_], Array]:
    """Which pseudoranges are before a time and have a truth, and the errors of those (n,) [m].

    Errors are ``range - distance - clock``. The clock of the receiver is a polynomial in time and an offset for each
    further system, fitted robustly to strong signals: a reflection makes a range too long, so that late ones count less
    (a Cauchy law with two scales). What it has wrong is common to all satellites, as the clock of a solution is.

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
    """Columns of the clock: Chebyshev polynomials and one step for each system after the first."""
    span = max(float(np.ptp(time_s)), 1.0)
    terms = np.polynomial.chebyshev.chebvander(2.0 * (time_s - time_s.min()) / span - 1.0, int(span / SECONDS_PER_TERM))
    others = [(system == letter).astype(np.float64) for letter in np.unique(system)[1:]]
    return np.column_stack([terms, *others])


def train(drive: SmartLoc, until_s: float, outside: float = 0.0) -> CodeErrors:
    """Bounds of the code errors from the part before ``until_s``; ``outside`` as in :func:`.fit_overbound`."""
    keep, error = code_errors(drive, until_s)
    r = drive.ranges
    return fit_overbound(error, r.cn0_dbhz[keep], r.time_s[keep], r.satellite[keep], outside)
