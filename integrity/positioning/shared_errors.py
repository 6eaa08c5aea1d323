"""Code positions whose errors have parts that all satellites share: least squares with the full covariance.

With R = D + C C', D the diagonal of the errors of each code and C (m, c) the effects of c shared errors of unit
variance (ionosphere and troposphere beyond what the clocks take), the solution follows from that of D alone::

    M0 = annihilator of the design in the metric D^-1,  S0, P0 gain and covariance of the position
    N  = I + C'M0 C,   M = R^-1 - R^-1 G (G'R^-1 G)^-1 G'R^-1 = M0 - M0 C N^-1 C'M0
    S  = S0 - S0 C N^-1 C'M0,   P = P0 + S0 C N^-1 (S0 C)',   WSSE = y'M y

M0 C are the weighted residuals of the columns of C when they are solved as measurements. The shared errors have a prior
variance, so that they cost no redundancy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.positioning.code_solution import CodeFit, solve_ranges

__all__ = ["solve_with_shared_errors"]

Array = NDArray[np.float64]


def solve_with_shared_errors(
    los_enu: ArrayLike,
    y_m: ArrayLike,
    variance_m2: ArrayLike,
    used: ArrayLike,
    system: ArrayLike,
    shared_m: Array,
) -> CodeFit:
    """Solve all epochs as :func:`~.code_solution.solve_ranges`, with the effects of shared errors (E, m, c) [m].

    Weights and rows are those of ``variance_m2``; gain, covariance and WSSE are those of the full covariance;
    ``residual_m`` is ``D M y``, what remains after the estimated shared errors; ``redundancy`` is ``D_ii M_ii``, so
    that ``slopes()`` is ``|S_i| / sqrt(M_ii)``.
    """
    own = solve_ranges(los_enu, y_m, variance_m2, used, system)
    columns = [
        solve_ranges(los_enu, np.ascontiguousarray(shared_m[..., k]), variance_m2, used, system)
        for k in range(shared_m.shape[-1])
    ]
    moved = np.stack([column.x_m for column in columns], -1)  # S0 C (E, 3, c)
    left = np.stack([column.residual_m for column in columns], -1)  # D M0 C (E, m, c)
    weighted = own.weight[..., None] * left
    normal = np.einsum("emk,eml->ekl", left, weighted) + np.eye(len(columns))
    inverse = np.linalg.inv(normal)
    seen = np.einsum("emk,em->ek", weighted, own.residual_m)  # C'M0 y
    shared = np.einsum("ekl,el->ek", inverse, seen)
    taken = np.einsum("emk,ekl->eml", weighted, inverse)  # M0 C N^-1
    found = own.solved[:, None]
    return replace(
        own,
        x_m=own.x_m - np.einsum("eik,ek->ei", moved, shared),
        cofactor=own.cofactor + np.einsum("eik,ekl,ejl->eij", moved, inverse, moved),
        gain=own.gain - np.einsum("eml,eil->emi", taken, moved),
        residual_m=own.residual_m - np.einsum("emk,ek->em", left, shared),
        redundancy=np.where(found, np.clip(own.redundancy - (taken * left).sum(-1), 0.0, 1.0), own.redundancy),
        wsse=np.maximum(own.wsse - (seen * shared).sum(-1), 0.0),
    )  # fmt: skip
