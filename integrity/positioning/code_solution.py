"""Positions by weighted least squares of codes, many epochs at once: the one solver of filters and monitors.

The clock of a system is the weighted mean of its codes less the rest. With rows ``a_i = -e_i - mean`` and values
``y_i - mean`` of each system, ``C = (sum w a a')^-1`` is the position block of ``(G'WG)^-1``, ``S_i = C a_i w_i`` its
gain, and ``R_ii = 1 - w_i a_i'C a_i - w_i / sum of w of its system`` the redundancy number: the same figures as with
clock columns, by 3 x 3 matrices only. A height that is known from elsewhere is one more row, ``up = height``.

Ranges to satellites at a finite distance are not linear: :func:`gauss_newton` linearises them again at each position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.positioning.code_solution_kernel import CodeRows, CodeSolutions, solve_epochs
from lanebound.integrity.positioning.least_squares import Solvability

__all__ = ["CodeFit", "gauss_newton", "semi_major_m", "solve_ranges"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

UNTESTED_BELOW = 1e-9  # redundancy number of a code that no other code checks
SETTLED_M = 1e-4
MOST_ROUNDS = 12  # from the Earth's centre some 6
EPOCH_US = 2.0


def semi_major_m(east_m2: ArrayLike, north_m2: ArrayLike, cross_m2: ArrayLike) -> Array:
    """Largest standard deviation in the plane, ``sqrt((dE2+dN2)/2 + sqrt(((dE2-dN2)/2)^2 + dEN^2))``.  (...,)."""
    e, n, c = (np.asarray(v, dtype=np.float64) for v in (east_m2, north_m2, cross_m2))
    return np.asarray(np.sqrt(0.5 * (e + n) + np.hypot(0.5 * (e - n), c)))


@dataclass(frozen=True)
class CodeFit:
    """Solution of E epochs; where ``status`` is not SOLVED everything but weights is 0.

    Attributes
    ----------
    x_m : (E, 3) position, East-North-Up.
    cofactor : (E, 3, 3) covariance of it, if the deviations are those of the errors.
    rows : (E, m, 3) ``a_i``, 0 where not used; gain : (E, m, 3) ``S_i``.
    residual_m : (E, m); redundancy : (E, m) ``R_ii``.
    weight, clock_share : (E, m) ``w_i``, and ``w_i`` over the sum of its system.
    df : (E,) codes, and a known height, less unknowns; wsse : (E,) ``r'W r``.
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

    def take(self, rows: ArrayLike | slice) -> CodeFit:
        """Some of the epochs, by mask, index or slice."""
        which: Any = rows if isinstance(rows, slice) else np.asarray(rows)
        return CodeFit(**{name: value[which] for name, value in vars(self).items()})

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


def solve_ranges(
    los_enu: ArrayLike,
    y_m: ArrayLike,
    variance_m2: ArrayLike,
    used: ArrayLike,
    system: ArrayLike,
    height: tuple[ArrayLike, ArrayLike] | None = None,
) -> CodeFit:
    """Solve all epochs; too few rows and a singular geometry are outcomes in ``status``, never NaN.

    Parameters
    ----------
    los_enu : (E, m, 3) unit vectors receiver to satellite; any finite value where not used
    y_m, variance_m2 : (E, m) observed minus computed codes and their variances, positive where used
    used : (E, m) bool
    system : (m,) or (E, m) clock of each code, 0 to 7
    height : Up (E,) as known from elsewhere and its 1 sigma (E,), inf for none [m]
    """
    mask = np.ascontiguousarray(used, dtype=np.bool_)
    epochs, m = mask.shape
    up, weight = np.zeros((2, epochs))
    if height is not None:
        up[:], sigma = height[0], np.broadcast_to(np.asarray(height[1], dtype=np.float64), (epochs,))
        weight[:] = 1.0 / np.square(sigma)
    codes = CodeRows(
        _wide(los_enu, (epochs, m, 3)), _wide(y_m, (epochs, m)), _wide(variance_m2, (epochs, m)), mask,
        np.ascontiguousarray(np.broadcast_to(np.asarray(system, dtype=np.int64), mask.shape)), up, weight,
    )  # fmt: skip
    both, wide = (epochs, m), (epochs, m, 3)
    out = CodeSolutions(
        np.zeros((epochs, 3)), np.zeros((epochs, 3, 3)), np.zeros(wide), np.zeros(wide), np.zeros(both), np.zeros(both),
        np.zeros(both), np.zeros(both), np.zeros(epochs, np.int64), np.zeros(epochs), np.zeros(epochs, np.int64),
    )  # fmt: skip
    run_rows(solve_epochs, epochs, codes, out, row_us=EPOCH_US)
    return CodeFit(*out)


def gauss_newton(
    linearise: Callable[[Array], tuple[Array, Array]],
    start_m: Array,
    variance_m2: ArrayLike,
    used: ArrayLike,
    system: ArrayLike,
) -> tuple[Array, CodeFit]:
    """Iterated least squares of ranges that are not linear in the position: positions (E, 3), and the last solution,
    which is about them; UNSETTLED where it still moves.

    Parameters
    ----------
    linearise : positions (E, 3) -> observed minus computed ranges (E, m) there, and unit vectors (E, m, 3) in the
        frame of the positions
    start_m : (E, 3); an epoch whose geometry is not solvable stays where it is
    """
    x = np.array(start_m, dtype=np.float64)
    for _ in range(MOST_ROUNDS):
        y, los = linearise(x)
        fit = solve_ranges(los, y, variance_m2, used, system)
        x = x + fit.x_m
        moving = (np.abs(fit.x_m) > SETTLED_M).any(-1)
        if not moving.any():
            return x, fit
    return x, replace(fit, status=np.where(moving & fit.solved, Solvability.UNSETTLED.code, fit.status))


def _wide(values: ArrayLike, shape: tuple[int, ...]) -> Array:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=np.float64), shape))
