"""Code epochs of the family by the one solver of code positions, and correlations of its tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.positioning.code_solution import UNTESTED_BELOW, CodeFit, solve_ranges

__all__ = ["CodeFit", "row_correlation", "solve_codes"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def solve_codes(epochs: CodeEpochs) -> CodeFit:
    """Solve all epochs by weighted least squares."""
    return solve_ranges(epochs.los_enu, epochs.y_m, np.square(epochs.sigma_m), epochs.used, epochs.system)


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
