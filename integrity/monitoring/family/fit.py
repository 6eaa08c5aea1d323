"""Weighted least squares of code epochs, many at once, with the clocks of the systems eliminated.

The clock of a system is the weighted mean of its codes less the rest. With rows ``a_i = -e_i - mean`` and values
``y_i - mean`` of each system, ``C = (sum w a a')^-1`` is the position block of ``(G'WG)^-1``, ``S_i = C a_i w_i`` its
gain, and ``R_ii = 1 - w_i a_i'C a_i - w_i / sum of w of its system`` the redundancy number: the same figures as with
clock columns, by 3 x 3 matrices only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.sbas import semi_major_m
from lanebound.integrity.positioning.least_squares import Solvability

__all__ = ["CodeFit", "row_correlation", "solve_codes"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

SINGULAR_BELOW = 1e-10  # determinant of the normal matrix scaled to a unit diagonal
UNTESTED_BELOW = 1e-9  # redundancy number of a code that no other code checks
UNKNOWNS = 3


@dataclass(frozen=True)
class CodeFit:
    """Solution of E epochs; where ``status`` is not SOLVED everything is 0.

    Attributes
    ----------
    x_m : (E, 3) position, East-North-Up.
    cofactor : (E, 3, 3) covariance of it, if the deviations are those of the errors.
    rows : (E, m, 3) ``a_i``, 0 where not used; gain : (E, m, 3) ``S_i``.
    residual_m : (E, m); redundancy : (E, m) ``R_ii``.
    weight, clock_share : (E, m) ``w_i``, and ``w_i`` over the sum of its system.
    df : (E,) codes less unknowns; wsse : (E,) ``r'W r``.
    status : (E,) codes of Solvability.
    """

    x_m: Array
    cofactor: Array
    rows: Array
    gain: Array
    residual_m: Array
    redundancy: Array
    weight: Array
    clock_share: Array
    df: Ints
    wsse: Array
    status: Ints

    @property
    def solved(self) -> Bools:
        """Where there is a position.  (E,)."""
        return np.asarray(self.status == Solvability.SOLVED.code)

    @property
    def used(self) -> Bools:
        """Codes that have weight.  (E, m)."""
        return np.asarray(self.weight > 0.0)

    @property
    def major_m(self) -> Array:
        """Largest standard deviation in the plane.  (E,)."""
        return semi_major_m(self.cofactor[:, 0, 0], self.cofactor[:, 1, 1], self.cofactor[:, 0, 1])

    @property
    def hdop_m(self) -> Array:
        """Weighted HDOP, ``sqrt(C_EE + C_NN)``.  (E,)."""
        return np.asarray(np.sqrt(self.cofactor[:, 0, 0] + self.cofactor[:, 1, 1]))

    @property
    def normalised(self) -> Array:
        """``w_i = r_i / (sigma_i sqrt(R_ii))`` of N(0, 1) without faults; 0 for codes that none checks.  (E, m)."""
        tested = self.redundancy > UNTESTED_BELOW
        return np.where(tested, self.residual_m * np.sqrt(self.weight / np.where(tested, self.redundancy, 1.0)), 0.0)

    def slopes(self, columns: slice = slice(0, 2)) -> Array:
        """``slope_i = sigma_i |S_i| / sqrt(R_ii)`` (S3 eq 13, with sigma_i as in Walter and Enge).  (E, m) [m].

        It is inf for a code that moves the position and is checked by none, and 0 for a code without influence.
        """
        length = np.sqrt(np.square(self.gain[..., columns]).sum(-1))
        tested = self.redundancy > UNTESTED_BELOW
        root = np.sqrt(self.weight * np.where(tested, self.redundancy, 1.0))
        slope = length / np.where(root > 0.0, root, 1.0)
        free = ~tested & (length > UNTESTED_BELOW)
        return np.where(self.used & free, np.inf, np.where(self.used & tested, slope, 0.0))


def solve_codes(epochs: CodeEpochs) -> CodeFit:
    """Solve all epochs by weighted least squares."""
    weight = np.where(epochs.used, 1.0 / np.square(np.where(epochs.used, epochs.sigma_m, 1.0)), 0.0)
    rows, y, share, present = _without_clocks(epochs, weight)
    weighted = rows * weight[..., None]
    cofactor, regular = _inverse(np.swapaxes(rows, 1, 2) @ weighted)
    number = epochs.used.sum(-1)
    df = number - UNKNOWNS - present
    status = np.where(regular, Solvability.SOLVED.code, Solvability.SINGULAR.code)
    status = np.where(df < 0, Solvability.TOO_FEW.code, status).astype(np.int64)
    good = status == Solvability.SOLVED.code
    cofactor = np.where(good[:, None, None], cofactor, 0.0)
    gain = weighted @ cofactor
    x = np.einsum("emk,em->ek", gain, y)
    residual = np.where(good[:, None] & epochs.used, y - (rows @ x[..., None])[..., 0], 0.0)
    redundancy = np.where(good[:, None] & epochs.used, 1.0 - np.einsum("emk,emk->em", gain, rows) - share, 0.0)
    return CodeFit(
        x, cofactor, rows, gain, residual, np.clip(redundancy, 0.0, 1.0), weight, share, np.where(good, df, 0),
        (weight * np.square(residual)).sum(-1), status,
    )  # fmt: skip


def _without_clocks(epochs: CodeEpochs, weight: Array) -> tuple[Array, Array, Array, Ints]:
    """Rows and observations less the weighted means of their systems, share of each weight in its system's sum, and
    the number of systems."""
    names, of = np.unique(epochs.system, return_inverse=True)
    owns = (np.arange(names.size)[:, None] == of).astype(np.float64)
    table = np.empty((*weight.shape, 5))
    np.multiply(epochs.los_enu, weight[..., None], out=table[..., :3])
    np.multiply(epochs.y_m, weight, out=table[..., 3])
    table[..., 4] = weight
    sums = owns @ table  # (E, systems, 5), a product for each epoch: its bits do not depend on the others
    total = sums[..., 4]
    mean = sums[..., :4] / np.where(total > 0.0, total, 1.0)[..., None]
    centre = np.take(mean, of, 1)
    used = epochs.used
    rows = np.where(used[..., None], centre[..., :3] - epochs.los_enu, 0.0)
    y = np.where(used, epochs.y_m - centre[..., 3], 0.0)
    share = weight / np.take(np.where(total > 0.0, total, 1.0), of, 1)
    return rows, y, share, np.asarray((total > 0.0).sum(-1), dtype=np.int64)


def _inverse(normal: Array) -> tuple[Array, Bools]:
    """Inverse of symmetric (E, 3, 3) by cofactors, scaled to a unit diagonal, and whether it exists."""
    d = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 0.0))
    scale = 1.0 / np.where(d > 0.0, d, 1.0)
    p, q, r = (normal[:, i, j] * scale[:, i] * scale[:, j] for i, j in ((0, 1), (0, 2), (1, 2)))
    det = 1.0 + 2.0 * p * q * r - p * p - q * q - r * r
    regular = (d > 0.0).all(-1) & (det > SINGULAR_BELOW)
    out = np.empty_like(normal)
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = 1.0 - r * r, 1.0 - q * q, 1.0 - p * p
    out[:, 0, 1] = out[:, 1, 0] = q * r - p
    out[:, 0, 2] = out[:, 2, 0] = p * r - q
    out[:, 1, 2] = out[:, 2, 1] = p * q - r
    out *= scale[:, :, None] * scale[:, None, :] / np.where(regular, det, 1.0)[:, None, None]
    return np.where(regular[:, None, None], out, 0.0), np.asarray(regular)


def row_correlation(fit: CodeFit, system: Ints, row: Ints) -> Array:
    """Correlation of the normalised residual of one code of each epoch, row (E,), with those of all.  (E, m)."""
    at = np.arange(row.size)
    cross = (fit.gain @ fit.rows[at, row][..., None])[..., 0]  # w_j a_j'C a_i
    same = system == system[row][:, None]
    own_weight = fit.weight[at, row][:, None]
    q = -(cross + np.where(same, fit.clock_share, 0.0))  # w_j Q_r,ij apart from the diagonal
    tested = (fit.redundancy > UNTESTED_BELOW) & (fit.redundancy[at, row][:, None] > UNTESTED_BELOW)
    spread = np.sqrt(np.where(tested, fit.redundancy * fit.redundancy[at, row][:, None], 1.0))
    # Q_r,ij = q / w_j and the deviations are sqrt(R_ii / w_i), so that sqrt(w_i / w_j) remains
    factor = np.sqrt(own_weight / np.where(fit.weight > 0.0, fit.weight, 1.0))
    found = np.where(tested & fit.used, q * factor / spread, 0.0)
    found[at, row] = np.where(tested[at, row], 1.0, 0.0)
    return found
