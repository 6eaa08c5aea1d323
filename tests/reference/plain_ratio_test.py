"""Acceptance of an integer solution: ratio test with a fixed failure rate, or the popular constant.

The ratio of second best to best norm has no failure rate of its own: a constant 3 is too strict for strong models and
too lax for weak ones. The fixed-failure-rate test takes its threshold from the number of ambiguities and the failure
rate of the model, such that P(wrong and accepted) stays within a limit (Verhagen & Teunissen 2013, GPS Solutions 17,
535-548; their tables are not used, :func:`simulate_thresholds` makes ours).

What is tabulated: limits 1e-3 and 1e-2, n from 1 to 66, failure rates up to 0.2. Below a limit of 1e-3 nothing is
extrapolated: the model's own failure rate has to be within the limit, and the ratio then only guards against errors of
the model (``floor``).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import InputError, require_probability
from lanebound.integrity.positioning import ratio_kernel as kernel
from lanebound.integrity.positioning.lambda_kernel import OK, search, search_scratch
from plain_ambiguity import bootstrap_failure_rate, decorrelate

__all__ = [
    "RatioTestConfig",
    "RatioVariant",
    "accepted",
    "minimum_ratio",
    "model_covariance",
    "simulate_ratios",
    "simulate_thresholds",
]

Array = NDArray[np.float64]
WAVELENGTHS_M = (0.190293673, 0.244210213)  # GPS L1 and L2, IS-GPS-200
PHASE_M = 0.003  # scale is free: the covariance is scaled to the wanted failure rate
SIMULATION_NODES = 20_000


class RatioVariant(Enum):
    """Where the threshold of the ratio test comes from."""

    FIXED_FAILURE_RATE = "threshold from n and the model's failure rate, wrong fixes accepted at most at the limit"
    CONSTANT = "the floor alone, whatever the model; the failure rate is not bounded"


class RatioTestConfig(Config):
    """How an integer solution is accepted."""

    variant: RatioVariant = Field(RatioVariant.FIXED_FAILURE_RATE, description="source of the threshold")
    failure_limit: float = Field(
        1e-3, gt=0.0, lt=1.0, description="largest P(wrong and accepted) [1]; customary, Verhagen & Teunissen 2013"
    )
    floor: float = Field(
        2.0, ge=1.0, description="smallest second best over best norm [1]; 3 is the popular constant (RTKLIB's default)"
    )


def _interpolated_mu(n: Array, failure_rate: Array, table: Array) -> Array:
    """Bilinear in the logarithms of n and failure rate, clipped to the table."""
    by_rate = np.stack([np.interp(np.log(failure_rate), np.log(kernel.FAILURE_RATES), row) for row in table], axis=-1)
    x = np.interp(np.log(n), np.log(kernel.NUMBERS), np.arange(len(kernel.NUMBERS)))
    i = np.minimum(x.astype(np.int64), len(kernel.NUMBERS) - 2)
    low, high = (np.take_along_axis(by_rate, (i + k)[..., None], axis=-1)[..., 0] for k in (0, 1))
    return np.asarray(low + (x - i) * (high - low))


def minimum_ratio(n: ArrayLike, failure_rate: ArrayLike, config: RatioTestConfig | None = None) -> Array:
    """Smallest second best over best norm to accept, inf where nothing may be accepted: (...,), (...,) -> (...,).

    ``n`` ambiguities with bootstrapped failure rate P_IF. With ``mu`` from the table, ``max(1 / mu, floor)``.
    """
    config = config or RatioTestConfig()
    number, rate = np.broadcast_arrays(np.asarray(n, dtype=np.float64), np.asarray(failure_rate, dtype=np.float64))
    if config.variant is RatioVariant.CONSTANT:
        return np.full(number.shape, config.floor)
    limit = config.failure_limit
    mu = np.where(np.isnan(rate), 0.0, 1.0)
    known = limit >= kernel.LIMITS[0]
    table = kernel.MU[1 if limit >= kernel.LIMITS[1] else 0]
    exceeds = (rate > limit) & (number > 0)
    inside = exceeds & known & (rate <= kernel.FAILURE_RATES[-1])
    safe_n, safe_rate = np.where(inside, number, 1.0), np.where(inside, rate, kernel.FAILURE_RATES[0])
    mu = np.where(exceeds, np.where(inside, _interpolated_mu(safe_n, safe_rate, table), 0.0), mu)
    with np.errstate(divide="ignore"):
        return np.maximum(1.0 / mu, config.floor)


def accepted(
    norms: ArrayLike, n: ArrayLike, failure_rate: ArrayLike, config: RatioTestConfig | None = None
) -> NDArray[np.bool_]:
    """Whether the best candidate is accepted: norms (..., m >= 2), n (...,), P_IF (...,) -> (...,).

    A solution without candidates (infinite best norm) is never accepted; one without ambiguities always is.
    """
    s = np.asarray(norms, dtype=np.float64)
    if s.ndim == 0 or s.shape[-1] < 2:
        raise InputError(f"norms must have shape (..., m) with m >= 2, got {s.shape}: ask for two candidates")
    best, second = s[..., 0], s[..., 1]
    threshold = minimum_ratio(n, failure_rate, config)
    with np.errstate(invalid="ignore"):
        return np.isfinite(best) & np.isfinite(threshold) & (second >= threshold * best)


def model_covariance(n: int, rng: np.random.Generator) -> Array:
    """Covariance (n, n) [cycles^2] of double-differenced ambiguities, code and phase of one epoch, random sky.

    Two bands when n is even, one when it is odd; code 50 to 200 times as noisy as phase, variances by
    ``1 / sin^2(elevation)`` above 10 degrees, a position known to 30 m.
    """
    bands = 2 if n % 2 == 0 else 1
    pairs = n // bands
    sine, azimuth = rng.uniform(np.sin(np.radians(10)), 1.0, pairs + 1), rng.uniform(0, 2 * np.pi, pairs + 1)
    cosine = np.sqrt(1 - sine**2)
    e = np.stack([cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine], axis=-1)
    difference = np.hstack([-np.ones((pairs, 1)), np.eye(pairs)])
    weights = np.linalg.inv(2 * PHASE_M**2 * difference @ np.diag(sine**-2) @ difference.T)
    code_weight = rng.uniform(50, 200) ** -2
    normal = np.zeros((3 + n, 3 + n))
    normal[:3, :3] = np.eye(3) / 30.0**2
    for band in range(bands):
        for weight, wavelength in ((code_weight, 0.0), (1.0, WAVELENGTHS_M[band])):
            rows = np.zeros((pairs, 3 + n))
            rows[:, :3] = -difference @ e
            rows[:, 3 + band * pairs : 3 + (band + 1) * pairs] = wavelength * np.eye(pairs)
            normal += weight * rows.T @ weights @ rows
    Q = np.linalg.inv(normal)[3:, 3:]
    return np.asarray((Q + Q.T) / 2)


def _scale_to(D: Array, failure_rate: float) -> float:
    """Factor on all variances that brings the bootstrapped failure rate to the one wanted, by bisection."""
    low, high = -40.0, 40.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        if float(bootstrap_failure_rate(np.exp(middle) * D)) < failure_rate:
            low = middle
        else:
            high = middle
    return float(np.exp(low))


@numba.njit(nogil=True)
def simulate_ratios(n: int, U: Array, D: Array, draws: Array, node_limit: int, ratios: Array) -> Any:
    """Best over second best norm of each wrong fix, 1 for right ones; ``draws`` (E, n) are standard normal.

    Float ambiguities ``z = U sqrt(D) g`` around zero, so that a fix is right when all its integers are zero. A search
    that exhausts its nodes counts as 1 too: it is never accepted. ``ratios`` (E,) is filled.
    """
    scratch = search_scratch(n, 2)
    scratch.U[:], scratch.D[:] = U, D
    for e in range(draws.shape[0]):
        for i in range(n):
            total = 0.0
            for k in range(i, n):
                total += U[i, k] * math.sqrt(D[k]) * draws[e, k]
            scratch.z_float[i] = total
        status = search(n, node_limit, scratch)
        wrong = False
        for i in range(n):
            wrong = wrong or scratch.candidates[0, i] != 0.0
        ratios[e] = 1.0
        if status == OK and wrong:
            ratios[e] = scratch.norms[0] / scratch.norms[1]


def simulate_thresholds(
    n: int, failure_rate: float, rng: np.random.Generator, draws: int = 50_000, models: int = 16
) -> Array:
    """One cell of the table: mu (2,) for the limits 1e-3 and 1e-2, the smallest over random models.

    Draws float solutions of covariances scaled to ``failure_rate``, fixes them, and takes the largest mu that accepts
    no more wrong ones than the limit. The whole table is this at every n and every k-th failure rate, with
    ``rng = np.random.default_rng([n, k])``, then made to fall with the failure rate and rise with n, as it must but for
    the luck of the draw, by the running minimum in both directions.
    """
    require_probability("failure_rate", failure_rate)
    if n < 1 or draws < 1 or models < 1:
        raise InputError(f"n, draws and models must be >= 1, got {n}, {draws} and {models}: raise them")
    mu = np.ones(len(kernel.LIMITS))
    for _ in range(models):
        reduced = decorrelate(model_covariance(n, rng))
        if reduced is None:
            continue
        D = reduced.D * _scale_to(reduced.D, failure_rate)
        ratios = np.empty(draws)
        simulate_ratios(n, reduced.U, D, rng.standard_normal((draws, n)), SIMULATION_NODES, ratios)
        ratios.sort()
        allowed = (kernel.LIMITS * draws).astype(np.int64)
        mu = np.minimum(mu, np.where(ratios[allowed] < 1.0, ratios[allowed] * (1 - 1e-12), 1.0))
    return mu
