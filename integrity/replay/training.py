"""Gaussian overbounds of the code errors of the training part of a drive, in classes of C/N0, with a free centre.

A reflected signal is always delayed; its errors lie between a few metres below zero and a hundred metres above. In each
class of C/N0 the bound is the normal distribution ``N(mu, s^2)`` with the smallest s that bounds the empirical tails,

``F_emp(mu - s z) <= Q(z)`` and ``1 - F_emp(mu + s z) <= Q(z)`` for all z with ``Q(z) <= tail``

(two-sided overbounding of the distribution function as in DeCleene 2000, ION GPS, with a free centre). The centre is
subtracted from the measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtri

from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.recorded.smartloc import SmartLoc
from lanebound.integrity.sky.orbit import ranges_and_sights

Array = NDArray[np.float64]

EDGES_DBHZ = (0.0, 25.0, 30.0, 35.0, 40.0, 43.0, 46.0, 49.0, 60.0)
TAIL = 0.25  # the bound holds for tails up to this probability; the core of the distribution is not constrained
FEWEST = 25  # smallest number of errors in a class
FLOOR_M = 1.0
MOST_PAIRED = 1000  # largest number of errors of one satellite in the autocorrelation, limits the memory


@dataclass(frozen=True)
class CodeErrors:
    """Bounds of code errors: centre and sigma (K,) [m] at C/N0 knots (K,) [dB-Hz], and correlation time [s]."""

    cn0_dbhz: Array
    centre_m: Array
    sigma_m: Array
    tau_s: float

    def at(self, cn0_dbhz: ArrayLike) -> tuple[Array, Array]:
        """Centre and sigma at C/N0 values, linear between the knots, constant beyond.  (...,) -> (...,), (...,)."""
        c = np.asarray(cn0_dbhz, dtype=np.float64)
        return np.interp(c, self.cn0_dbhz, self.centre_m), np.interp(c, self.cn0_dbhz, self.sigma_m)


def gaussian_bound(error_m: ArrayLike, outside: float = 0.0) -> tuple[float, float]:
    """Centre and smallest sigma of a normal distribution that bounds both empirical tails of errors (n,) [m].

    The k-th largest of n errors has the tail probability ``k / (n + 1)``. The share ``outside`` of each tail is
    ignored.

    Raises
    ------
    InputError
        There are fewer than two errors, or one is not finite.
    """
    error = np.sort(require_finite("error_m", error_m).ravel())
    n = error.size
    if n < 2:
        raise InputError(f"error_m must have at least 2 entries, got {n}: use wider classes")
    first = int(outside * (n + 1))
    rank = np.arange(first, max(int(TAIL * (n + 1)), first + 1))
    z = -ndtri((rank + 1) / (n + 1.0))
    low, high = error[rank], error[::-1][rank]

    def least(centre: float) -> float:
        return float(max(((centre - low) / z).max(), ((high - centre) / z).max()))

    found = minimize_scalar(least, bounds=(float(error[0]), float(error[-1])), method="bounded")
    return float(found.x), max(float(found.fun), FLOOR_M)


def lasting_s(time_s: Array, owner: NDArray[np.int64], normalised: Array, longest_s: float = 60.0) -> float:
    """Correlation time (1/e) of errors of one satellite, from products of its normalised errors (n,) at all lags.

    The autocorrelation is estimated at lags of whole seconds. The mean of each satellite is not subtracted: constant
    errors increase the correlation time. Without a crossing of 1/e the result is ``longest_s``.
    """
    bins = np.arange(int(longest_s) + 1)
    total, number = np.zeros(bins.size), np.zeros(bins.size)
    for s in np.unique(owner):
        thin = -(-int((owner == s).sum()) // MOST_PAIRED)
        t, v = time_s[owner == s][::thin], normalised[owner == s][::thin]
        lag = np.rint(np.abs(t[:, None] - t[None, :])).astype(np.int64)
        inside = lag <= bins[-1]
        total += np.bincount(lag[inside], (v[:, None] * v[None, :])[inside], minlength=bins.size)
        number += np.bincount(lag[inside], minlength=bins.size)
    there = np.flatnonzero(number)
    share = total[there] / number[there]
    below = there[share < share[0] * np.exp(-1.0)]
    return float(below[0]) if below.size else longest_s


def fit_overbound(
    error_m: Array, cn0_dbhz: Array, time_s: Array, owner: NDArray[np.int64], outside: float = 0.0
) -> CodeErrors:
    """Fit bounds of errors (n,) by C/N0; classes with few errors are left out, sigma does not decrease with lower C/N0.

    ``outside`` is the share of each tail that the bound ignores; re-weighting must handle these errors.

    Raises
    ------
    InputError
        No class has enough errors.
    """
    knots = []
    for low, high in pairwise(EDGES_DBHZ):
        inside = (cn0_dbhz >= low) & (cn0_dbhz < high)
        if int(inside.sum()) >= FEWEST:
            knots.append((float(np.median(cn0_dbhz[inside])), *gaussian_bound(error_m[inside], outside)))
    if not knots:
        raise InputError(
            f"error_m must have {FEWEST} errors of one C/N0 class, got {error_m.size} in all: train longer"
        )
    cn0, centre, sigma = np.array(knots).T
    sigma = np.maximum.accumulate(sigma[::-1])[::-1]
    bounds = CodeErrors(cn0, centre, sigma, 0.0)
    mean, spread = bounds.at(cn0_dbhz)
    return CodeErrors(cn0, centre, sigma, lasting_s(time_s, owner, (error_m - mean) / spread))


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
