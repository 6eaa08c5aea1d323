"""Weighted least squares on any batch, with rows masked and clocks that may vanish.

Rows that are masked out carry no weight, whatever they contain. A nuisance column (a clock) that no remaining row
touches is dropped; the first ``required`` columns, the position, never are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.errors import InputError, require_finite, require_shape

__all__ = ["Gain", "Solvability", "design_matrix", "gain", "weights"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

POSITION_COLUMNS = 3
SINGULAR_BELOW = 1e-13  # smallest eigenvalue of the normal matrix scaled to a unit diagonal


class Solvability(Advice):
    """Whether the measurements determine the unknowns; ``code`` is what arrays carry."""

    SOLVED = 0, "the measurements determine the position"
    TOO_FEW = 1, "fewer measurements than unknowns: wait for more satellites, or use fewer clocks"
    SINGULAR = 2, "the geometry does not determine the position: wait until the satellites spread out"
    UNSETTLED = 3, "the iteration does not settle: begin nearer to the position, or leave out a wrong range"


@dataclass(frozen=True)
class Gain:
    """``S`` (..., n, m) of ``x = S y``, cofactor ``(G'WG)^-1`` (..., n, n) and status (...,); zeros unless SOLVED."""

    gain: Array
    cofactor: Array
    status: Ints

    @property
    def solved(self) -> Bools:
        """Where the status is SOLVED.  (...,)."""
        return np.asarray(self.status == Solvability.SOLVED.code)


def design_matrix(los_enu: ArrayLike, group: ArrayLike, n_groups: int | None = None) -> Array:
    """Rows ``[-e, one-hot clock]`` (S1 eq 1).

    Parameters
    ----------
    los_enu : (..., m, 3) unit vectors receiver to satellite.
    group : (..., m) clock of each row, 0 to n_groups - 1.
    n_groups : number of clock columns; by default the largest group and one.

    Returns
    -------
    (..., m, 3 + n_groups).

    Raises
    ------
    InputError
        A vector that is not of unit length, or a group out of range.
    """
    los = require_finite("los_enu", los_enu)
    require_shape("los_enu", los, (None, POSITION_COLUMNS))
    clocks = np.asarray(group, dtype=np.int64)
    size = int(clocks.max(initial=-1)) + 1 if n_groups is None else n_groups
    if clocks.size and (clocks.min() < 0 or clocks.max() >= size):
        raise InputError(
            f"group must lie in [0, {size - 1}], got {clocks.min()} to {clocks.max()}: renumber the clocks"
        )
    length = np.linalg.norm(los, axis=-1)
    if (np.abs(length - 1.0) > 1e-6).any():
        raise InputError(
            f"los_enu must be unit vectors, got length {length.flat[np.abs(length - 1.0).argmax()]}: normalise"
        )
    one_hot = clocks[..., None] == np.arange(size)
    return np.concatenate([-los, np.broadcast_to(one_hot, (*los.shape[:-1], size)).astype(np.float64)], -1)


def weights(covariance: ArrayLike, rows: ArrayLike | None = None) -> Array:
    """``W = Q_y^-1`` of the rows that are used, zero elsewhere.

    covariance (..., m, m) [m^2], positive definite on the used rows; rows (..., m) bool, default all -> (..., m, m).

    Raises
    ------
    InputError
        The covariance of the used rows is not positive definite.
    """
    q = require_finite("covariance", covariance)
    require_shape("covariance", q, (None, q.shape[-1]))
    used = np.ones(q.shape[-1], bool) if rows is None else np.asarray(rows, dtype=bool)
    both = used[..., :, None] & used[..., None, :]
    filled = np.where(both, q, np.where(used[..., None], 0.0, np.eye(q.shape[-1])))
    try:
        np.linalg.cholesky(filled)
    except np.linalg.LinAlgError:
        raise InputError(
            "covariance must be positive definite, it is not: give every row a positive variance"
        ) from None
    return np.where(both, np.linalg.inv(filled), 0.0)


def gain(design: ArrayLike, weight: ArrayLike, required: int = POSITION_COLUMNS) -> Gain:
    """``S = (G'WG)^-1 G'W`` (S1 eq 9), with a verdict for every item of the batch.

    Parameters
    ----------
    design : (..., m, n) design matrix G.
    weight : (..., m, m) weights W; zero rows are rows out of view.
    required : the first columns, which must be determined; a later one without any row is dropped (its gain is zero).
    """
    g, w = require_finite("design", design), require_finite("weight", weight)
    require_shape("weight", w, (g.shape[-2], g.shape[-2]))
    used = np.diagonal(w, axis1=-2, axis2=-1) > 0.0
    seen = np.where(used[..., None], g, 0.0)
    live = (seen != 0.0).any(-2)
    live[..., :required] = True
    gw = np.swapaxes(seen, -1, -2) @ w
    inverse, regular = _scaled_inverse(gw @ seen, live)
    status = np.where(regular, Solvability.SOLVED.code, Solvability.SINGULAR.code)
    status = np.where(used.sum(-1) < live.sum(-1), Solvability.TOO_FEW.code, status).astype(np.int64)
    cofactor = np.where((status == Solvability.SOLVED.code)[..., None, None], inverse, 0.0)
    return Gain(cofactor @ gw, cofactor, status)


def _scaled_inverse(normal: Array, live: Bools) -> tuple[Array, Bools]:
    """Inverse on the live columns (zero elsewhere) and whether it exists; scaled, so that units do not matter."""
    both = live[..., :, None] & live[..., None, :]
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    scale = np.where(live & (diagonal > 0.0), 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)
    outer = scale[..., :, None] * scale[..., None, :]
    scaled = np.where(both, normal * outer, np.eye(normal.shape[-1]))
    regular = np.linalg.eigvalsh(scaled)[..., 0] > SINGULAR_BELOW
    inverse = np.linalg.inv(np.where(regular[..., None, None], scaled, np.eye(normal.shape[-1])))
    return np.where(both, inverse * outer, 0.0), np.asarray(regular)
