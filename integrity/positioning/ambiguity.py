"""Integer ambiguity resolution for any leading batch axes, by the kernels.

Letters as in :mod:`lanebound.integrity.positioning.lambda_kernel`. ``tests/reference/plain_ambiguity.py`` is the same
in plain NumPy, slow and meant to be read; tests hold the two together.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning import lambda_kernel as kernel

__all__ = ["NODE_LIMIT", "AmbiguitySolution", "SearchStatus", "problems_of", "resolve"]

Array = NDArray[np.float64]
NODE_LIMIT = 20_000  # about 0.2 ms; a decorrelated problem worth fixing needs some hundreds


class SearchStatus(IntEnum):
    """How a search ended; the integers are those of the kernels."""

    OK = kernel.OK  # candidates are the best there are
    NODE_LIMIT = kernel.NODE_LIMIT  # candidates are not proven best; wait for a more precise float solution
    NOT_POSITIVE_DEFINITE = kernel.NOT_POSITIVE_DEFINITE  # covariance has lost rank; rebuild the float solution
    NOT_FINITE = kernel.NOT_FINITE  # float ambiguities are not numbers; rebuild the float solution


@dataclass(frozen=True)
class AmbiguitySolution:
    """Integer candidates and what is known about them, for any batch shape ``...``."""

    candidates: Array
    """(..., m, n) best first [cycles]; NaN-free: the rounded float solution where there is none."""
    norms: Array
    """(..., m) squared norms, inf where there is no candidate."""
    failure_rate: Array
    """(...,) bootstrapped P_IF, 1 where the covariance is unusable."""
    status: NDArray[np.int64]
    """(...,) values of :class:`SearchStatus`."""

    @property
    def ratio(self) -> Array:
        """(...,) second best over best norm; inf when the best fits perfectly or stands alone, 0 without a solution."""
        best, second = self.norms[..., 0], self.norms[..., 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(np.isfinite(best), second / best, 0.0)
        return np.where(np.isnan(ratio), np.inf, ratio)


def problems_of(a_hat: ArrayLike, Q: ArrayLike, m: int, node_limit: int) -> tuple[Array, Array, tuple[int, ...]]:
    """The problems flattened to (E, n) and (E, n, n), and their batch shape; InputError on shapes that do not fit."""
    try:
        a, cov = np.asarray(a_hat, dtype=np.float64), np.asarray(Q, dtype=np.float64)
        batch = np.broadcast_shapes(a.shape[:-1], cov.shape[:-2])
    except ValueError as exc:
        raise InputError(f"a_hat and Q must be numeric with batch axes that broadcast: {exc}") from exc
    n = a.shape[-1] if a.ndim else -1
    if n < 0 or cov.shape[-2:] != (n, n):
        raise InputError(
            f"Q must have shape (..., n, n) for a_hat (..., n), got {cov.shape} and {a.shape}: reshape them"
        )
    if m < 2 or node_limit < 1:
        raise InputError(f"candidates must be >= 2 and node_limit >= 1, got {m} and {node_limit}: raise them")
    count = int(np.prod(batch, dtype=np.int64))
    flat_a = np.ascontiguousarray(np.broadcast_to(a, (*batch, n)).reshape(count, n))
    return flat_a, np.ascontiguousarray(np.broadcast_to(cov, (*batch, n, n)).reshape(count, n, n)), batch


def resolve(
    a_hat: ArrayLike, Q: ArrayLike, candidates: int = 2, node_limit: int = NODE_LIMIT, reuse: bool = False
) -> AmbiguitySolution:
    """Minimise ``(a_hat - a)' Q^-1 (a_hat - a)`` over integer a; the best ``candidates`` of them.

    Parameters
    ----------
    a_hat, Q
        Float solutions (..., n) [cycles] and their covariances (..., n, n) [cycles^2]; batch axes broadcast.
    candidates, node_limit
        How many to return (>= 2), and the most nodes a search may visit.
    reuse
        Neighbours along the last batch axis are epochs of the same ambiguities: each then starts from the
        transformation of the one before. Solutions and norms are the same, the failure rate may differ slightly.

    Raises
    ------
    InputError
        When shapes or counts do not fit. NaN and singular covariances are statuses, not errors.
    """
    a, cov, batch = problems_of(a_hat, Q, candidates, node_limit)
    count, n = a.shape
    out = np.tile(np.floor(np.nan_to_num(a) + 0.5)[:, None, :], (1, candidates, 1))
    norms, rate, status = np.empty((count, candidates)), np.empty(count), np.empty(count, dtype=np.int64)
    kernel.solve_epochs(a, cov, node_limit, reuse, out, norms, rate, status)
    return AmbiguitySolution(
        out.reshape(*batch, candidates, n),
        norms.reshape(*batch, candidates),
        rate.reshape(batch),
        status.reshape(batch),
    )
