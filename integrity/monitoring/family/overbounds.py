"""Normal overbounds of errors: of the distribution, paired, of the density, of the tails; of both sides or of one.

``z_k`` is the quantile ``Phi^-1(k / (n + 1))`` of the k-th smallest of n errors. All bounds hold for the sample at
hand; they promise nothing for errors rarer than one in n.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtri

from lanebound.integrity.core.errors import InputError, require_finite, require_in_range

__all__ = ["BoundForm", "ErrorSides", "Overbound", "overbound"]

Array = NDArray[np.float64]

FEWEST = 10
MOST_TAIL = 0.49  # of a CDF bound: at the centre itself only errors with this median have a finite one
LEAST_SIGMA_M = 1e-6


class BoundForm(Enum):
    """What of the law is bounded."""

    CDF = "cdf"
    PAIRED = "paired"
    PDF = "pdf"
    TAIL = "tail"


class ErrorSides(Enum):
    """Which errors are bounded."""

    BOTH = "both"
    LATE = "late"
    EARLY = "early"


@dataclass(frozen=True)
class Overbound:
    """``N(centre - bias, sigma^2)`` bounds the early side, ``N(centre + bias, sigma^2)`` the late side [m]."""

    centre_m: float
    sigma_m: float
    bias_m: float = 0.0


def overbound(
    error_m: ArrayLike, form: BoundForm = BoundForm.CDF, sides: ErrorSides = ErrorSides.BOTH, *, tail: float = 0.25,
    centred: bool = False, factor: float = 4.0,
) -> Overbound:  # fmt: skip
    """The smallest normal law that bounds errors (n,) [m].

    ===== =============================================================================================================
    CDF   ``F(e) <= F_bound(e)`` below the centre, the reverse above (DeCleene 2000): sigma covers tails up to 0.49
    TAIL  the same for tails up to the probability ``tail`` only
    PAIRED all of F between the laws of two centres (Rife 2006), the pair of least ``bias + factor sigma``
    PDF   the density is above that of the errors, by histogram, beyond one sigma
    ===== =============================================================================================================

    Parameters
    ----------
    sides : LATE and EARLY leave the errors of the other sign unbounded.
    centred : bound about the median in place of 0.
    factor : sigmas at which a paired bound is to be least.

    Raises
    ------
    InputError
        Fewer than 10 errors, an entry that is not finite, or a tail outside (0, 0.5].
    """
    e = np.sort(require_finite("error_m", error_m).ravel())
    if e.size < FEWEST:
        raise InputError(f"error_m must have {FEWEST} errors or more, got {e.size}: join classes")
    require_in_range("tail", tail, 0.0, 0.5, low_open=True)
    centre = float(np.median(e)) if centred else 0.0
    late, early = _side(e - centre), _side(np.sort(centre - e))
    chosen = {ErrorSides.BOTH: [late, early], ErrorSides.LATE: [late], ErrorSides.EARLY: [early]}[sides]
    if form is BoundForm.PAIRED:
        return _paired(centre, chosen, factor)
    if form is BoundForm.PDF:
        return Overbound(centre, _density(e - centre, sides))
    largest = tail if form is BoundForm.TAIL else MOST_TAIL
    sigma = max(_slope(values, z, largest) for values, z in chosen)
    return Overbound(centre, max(sigma, LEAST_SIGMA_M))


def _side(e: Array) -> tuple[Array, Array]:
    """Sorted errors and their normal quantiles."""
    return e, np.asarray(ndtri(np.arange(1, e.size + 1) / (e.size + 1.0)))


def _slope(e: Array, z: Array, largest: float) -> float:
    """Least sigma with ``e_k <= sigma z_k`` for upper tails up to ``largest``."""
    own = z >= -ndtri(largest)
    return float((e[own] / z[own]).max()) if own.any() else 0.0


def _paired(centre: float, sides: list[tuple[Array, Array]], factor: float) -> Overbound:
    """Least ``b + factor s`` with ``e_k <= b + s z_k`` for all k of each side."""

    def bias(sigma: float) -> float:
        return max(0.0, *(float((e - sigma * z).max()) for e, z in sides))

    most = max(float(np.abs(e).max()) for e, _ in sides) + LEAST_SIGMA_M
    found = minimize_scalar(lambda s: bias(s) + factor * s, bounds=(LEAST_SIGMA_M, most), method="bounded")
    return Overbound(centre, float(found.x), bias(float(found.x)))


def _density(e: Array, sides: ErrorSides) -> float:
    """Least sigma whose density is above the histogram in all bins beyond one sigma."""
    count = max(8, round(2.0 * e.size ** (1.0 / 3.0)))
    density, edges = np.histogram(e, bins=count, density=True)
    middle = 0.5 * (edges[1:] + edges[:-1])
    own = {ErrorSides.BOTH: middle != 0.0, ErrorSides.LATE: middle > 0.0, ErrorSides.EARLY: middle < 0.0}[sides]
    x, f = np.abs(middle[own]), density[own]
    low, high = LEAST_SIGMA_M, float(np.abs(e).max()) * e.size
    for _ in range(80):
        s = np.sqrt(low * high)
        beyond = x > s
        bound = np.exp(-0.5 * np.square(x[beyond] / s)) / (s * np.sqrt(2.0 * np.pi))
        low, high = (low, s) if (bound >= f[beyond]).all() else (s, high)
    return float(high)
