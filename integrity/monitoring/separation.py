"""Solution separation of any linear model, the plain way: every fault mode is solved anew (S1 eq 10-12).

The reference for the kernels, and the form for correlated rows, modes of several rows and unusual unknowns. Column 0 of
every result is the fault-free solution, columns 1 to M are the modes; axis -1 is (AT, CT).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.risk import Variant
from lanebound.integrity.positioning.least_squares import gain, weights

__all__ = ["Separation", "published_bias", "separate"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Separation:
    """Per mode and axis, (..., 1 + M, 2) [m].

    ``sigma_m`` of the solution (inf where it does not exist), ``delta_m`` of its separation from the fault-free one,
    ``bias_m`` bound of its nominal bias, ``separation_m = x - x_i`` (0 without measurements). ``status`` (..., 1 + M)
    is a ``Solvability`` code, ``gain_track`` (..., 1 + M, 2, m) the rows ``R S_i``.
    """

    sigma_m: Array
    delta_m: Array
    bias_m: Array
    separation_m: Array
    status: Ints
    gain_track: Array

    @property
    def solved(self) -> Bools:
        """Which solutions exist.  (..., 1 + M)."""
        return np.asarray(self.status == 0)


def published_bias(gain_en: Array, bias: Array, heading_rad: Array) -> Array:
    """``B_AT = sqrt((sin t a1'S b)^2 + (cos t a2'S b)^2)``, B_CT with sin and cos exchanged (S1 eq 17).

    It depends on the heading, and signs cancel: equal biases on all satellites of one clock give 0. Only for
    reproducing. gain_en (..., 2, m), bias (..., m) [m], heading_rad (...,) -> (..., 2) [m].
    """
    shift = (gain_en @ bias[..., None])[..., 0]
    sine, cosine = np.sin(heading_rad), np.cos(heading_rad)
    along = np.hypot(sine * shift[..., 0], cosine * shift[..., 1])
    return np.stack([along, np.hypot(cosine * shift[..., 0], sine * shift[..., 1])], -1)


def separate(
    design: ArrayLike,
    covariance: ArrayLike,
    modes: ArrayLike,
    heading_rad: ArrayLike,
    *,
    accuracy: ArrayLike | None = None,
    bias: ArrayLike = 0.0,
    y: ArrayLike | None = None,
    rows: ArrayLike | None = None,
    variant: Variant = Variant.EXACT,
) -> Separation:
    """Fault-free and fault-tolerant solutions along and across the track.

    ``S_i = (G'W_i G)^-1 G'W_i`` with W_i the inverse covariance of the rows that are left,
    ``sigma_i^2 = [R S_i Q_y S_i'R']_qq``, ``sigma_di^2 = [R (S_i - S) Q_acc (S_i - S)'R']_qq``,
    ``b_i = sum_j abs([R S_i]_qj) b_j``.

    Parameters
    ----------
    design : (..., m, n) with E, N and Up first, which must be determined; clocks without a row left are dropped.
    covariance : (..., m, m) for integrity [m^2].
    modes : (..., M, m) bool, the rows that each mode removes.
    heading_rad : (...,) azimuth of motion.
    accuracy : (..., m, m) covariance of which the separations are made [m^2]; default ``covariance`` (S1).
    bias : (..., m) bounds of the nominal biases, >= 0 [m].
    y : (..., m) measurements [m].
    rows : (..., m) bool, rows in view; default all.
    variant : PUBLISHED takes the bias of S1 eq 17.

    Raises
    ------
    InputError
        Values that are not finite, shapes that do not fit, a negative bias, a covariance that is not positive definite.
    """
    g, q = require_finite("design", design), require_finite("covariance", covariance)
    m = g.shape[-2]
    removed = np.asarray(modes, dtype=bool)
    if removed.ndim < 2 or removed.shape[-1] != m:
        raise InputError(f"modes must have shape (..., M, {m}), got {removed.shape}: one column for each row of design")
    b = np.broadcast_to(require_in_range("bias", bias, 0.0, np.inf), np.broadcast_shapes(np.shape(bias), (m,)))
    spread = q if accuracy is None else require_finite("accuracy", accuracy)
    require_shape("accuracy", spread, (m, m))
    heading = require_finite("heading_rad", heading_rad)[..., None]
    seen = np.ones(m, bool) if rows is None else np.asarray(rows, dtype=bool)
    left = _rows_of_columns(removed, seen)
    s = gain(g[..., None, :, :], weights(q[..., None, :, :], left))
    enu = s.gain[..., :2, :]
    track = track_from_enu_matrix(heading) @ enu
    delta = np.where(s.solved[..., None, None], track[..., :1, :, :] - track, 0.0)
    tied = b[..., None, :]
    bounded = (np.abs(track) @ tied[..., None])[..., 0]
    exact = variant is Variant.EXACT
    separation = (
        np.zeros(delta.shape[:-1]) if y is None else (delta @ require_finite("y", y)[..., None, :, None])[..., 0]
    )
    return Separation(
        sigma_m=np.where(s.solved[..., None], _deviation(track, q), np.inf),
        delta_m=_deviation(delta, spread),
        bias_m=bounded if exact else published_bias(enu, np.broadcast_to(tied, enu[..., 0, :].shape), heading),
        separation_m=separation,
        status=s.status,
        gain_track=track,
    )


def _rows_of_columns(removed: Bools, seen: Bools) -> Bools:
    """Rows left in each column: all those in view, then those in view less each mode's.  (..., 1 + M, m)."""
    modes = seen[..., None, :] & ~removed
    first = np.broadcast_to(seen[..., None, :], (*modes.shape[:-2], 1, modes.shape[-1]))
    return np.concatenate([first, modes], -2)


def _deviation(rows: Array, covariance: Array) -> Array:
    """Root of the diagonal of ``rows Q rows'``.  (..., K, 2, m), (..., m, m) -> (..., K, 2)."""
    variance = ((rows @ covariance[..., None, :, :]) * rows).sum(-1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
