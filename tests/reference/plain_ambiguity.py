"""Integer least squares in plain NumPy, slow and meant to be read: the reference of every kernel of its search.

Letters as in :mod:`lanebound.integrity.positioning.lambda_kernel`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfc

from lanebound.integrity.positioning import lambda_kernel as kernel
from lanebound.integrity.positioning.ambiguity import NODE_LIMIT, AmbiguitySolution, SearchStatus, problems_of

__all__ = ["Decorrelation", "bootstrap_failure_rate", "decorrelate", "integer_least_squares"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Decorrelation:
    """``Z'QZ = U diag(D) U'``: Z (n, n) unimodular, U (n, n) unit upper triangular, D (n,) [cycles^2]."""

    Z: Array
    U: Array
    D: Array


def _factor(Q: Array) -> tuple[Array, Array, Array] | None:
    """``P'QP = U D U'`` with the smallest remaining variance taken last to first, or None."""
    n = len(Q)
    A, U, order = Q.copy(), np.eye(n), np.arange(n)
    D, floor = np.zeros(n), kernel.PIVOT_FLOOR * np.diag(Q)
    if not (floor > 0.0).all():
        return None
    for i in range(n - 1, -1, -1):
        swap = np.arange(n)
        p = int(np.argmin(np.append(np.diag(A)[:i], np.inf)))
        if i and A[p, p] < A[i, i]:
            swap[[p, i]] = i, p
        A, order, floor = A[np.ix_(swap, swap)], order[swap], floor[swap]
        U[:, i + 1 :] = U[swap, i + 1 :]
        D[i] = A[i, i]
        if not floor[i] < D[i] < np.inf:
            return None
        U[:i, i] = A[:i, i] / D[i]
        A[:i, :i] -= D[i] * np.outer(U[:i, i], U[:i, i])
    return U, D, np.eye(n)[:, order]


def _round(x: float) -> float:
    """Nearest integer, halves upward as in the kernels."""
    return float(math.floor(x + 0.5))


def _exchange(j: int, d: float, U: Array, D: Array, Z: Array) -> None:
    """Exchange z_j and z_j+1; d is the conditional variance of z_j+1 afterwards."""
    u = U[j, j + 1]
    eta, lam = D[j] / d, D[j + 1] * u / d
    D[j], D[j + 1] = eta * D[j + 1], d
    U[:j, [j, j + 1]] = U[:j, [j, j + 1]] @ np.array([[-u, eta], [1.0, lam]])
    U[[j, j + 1], j + 2 :] = U[[j + 1, j], j + 2 :]
    U[j, j + 1] = lam
    Z[:, [j, j + 1]] = Z[:, [j + 1, j]]


def _gauss(j: int, i: int, U: Array, Z: Array) -> None:
    """``z_j -= mu z_i`` with ``mu = round(U_ji)``."""
    mu = _round(U[j, i])
    if mu:
        U[j] -= mu * U[i]
        Z[:, j] -= mu * Z[:, i]


def decorrelate(Q: ArrayLike) -> Decorrelation | None:
    """Decorrelate one covariance (n, n) [cycles^2]; None when it is not positive definite.

    Integer Gauss transformations and exchanges of neighbours (de Jonge & Tiberius 1996, section 3; Chang et al. 2005).
    """
    factored = _factor(np.asarray(Q, dtype=np.float64))
    if factored is None:
        return None
    U, D, Z = factored
    n, j = len(D), len(D) - 2
    if n and np.diag(np.asarray(Q)).max() < kernel.SMALL_VARIANCE:
        return Decorrelation(Z, U, D)
    while j >= 0:
        rest = U[j, j + 1] - _round(U[j, j + 1])
        d = D[j] + rest**2 * D[j + 1]
        if d < kernel.SWAP_GAIN * D[j + 1]:
            for i in range(j + 1, n):
                _gauss(j, i, U, Z)
            _exchange(j, d, U, D, Z)
            j = min(j + 1, n - 2)
        else:
            j -= 1
    for j in range(n - 2, -1, -1):
        for i in range(j + 1, n):
            _gauss(j, i, U, Z)
    return Decorrelation(Z, U, D)


def bootstrap_failure_rate(D: ArrayLike) -> Array:
    """``P_IF = 1 - prod_i (2 Phi(1 / (2 sqrt(D_i))) - 1)`` over the last axis: (..., n) [cycles^2] -> (...,).

    Accurate down to 1e-15 (Teunissen 1998). An empty product leaves P_IF = 0.
    """
    factors = np.log1p(-erfc(np.sqrt(0.125 / np.asarray(D, dtype=np.float64))))
    return np.asarray(-np.expm1(factors.sum(axis=-1)))


def _search(z_float: Array, U: Array, D: Array, m: int, node_limit: int) -> tuple[Array, Array, bool]:
    """The m best integer vectors, their norms and whether that is proven; depth first in zig-zag order."""
    n = len(D)
    found: list[tuple[float, Array]] = []
    distance, mean, z, step = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    k, descend, complete = n - 1, True, False
    for _ in range(node_limit):
        if descend:
            mean[k] = z_float[k] + U[k, k + 1 :] @ (z[k + 1 :] - mean[k + 1 :])
            z[k] = _round(mean[k])
            step[k] = 1.0 if mean[k] > z[k] else -1.0
        norm = distance[k] + (mean[k] - z[k]) ** 2 / D[k]
        inside = len(found) < m or norm < found[-1][0]
        descend = inside and k > 0
        if descend:
            k -= 1
            distance[k] = norm
            continue
        if inside:
            found = sorted([*found, (norm, z.copy())], key=lambda item: item[0])[:m]
        elif k == n - 1:
            complete = True
            break
        else:
            k += 1
        z[k] += step[k]
        step[k] = -step[k] - math.copysign(1.0, step[k])
    candidates, norms = np.zeros((m, n)), np.full(m, np.inf)
    for slot, (norm, vector) in enumerate(found):
        candidates[slot], norms[slot] = vector, norm
    return candidates, norms, complete


def _solve_one(a_hat: Array, Q: Array, m: int, node_limit: int) -> tuple[Array, Array, float, SearchStatus]:
    """Integer least squares of one problem: candidates (m, n), norms (m,), failure rate, status."""
    n = len(a_hat)
    none = np.tile(np.floor(np.nan_to_num(a_hat) + 0.5), (m, 1)), np.full(m, np.inf), 1.0
    if not np.isfinite(a_hat).all():
        return *none, SearchStatus.NOT_FINITE
    reduced = decorrelate(Q)
    if reduced is None:
        return *none, SearchStatus.NOT_POSITIVE_DEFINITE
    if n == 0:
        return np.zeros((m, 0)), np.append(0.0, np.full(m - 1, np.inf)), 0.0, SearchStatus.OK
    whole = np.floor(a_hat + 0.5)
    z, norms, complete = _search(reduced.Z.T @ (a_hat - whole), reduced.U, reduced.D, m, node_limit)
    candidates = whole + np.rint(np.linalg.solve(reduced.Z.T, z.T)).T
    status = SearchStatus.OK if complete else SearchStatus.NODE_LIMIT
    return candidates, norms, float(bootstrap_failure_rate(reduced.D)), status


def integer_least_squares(
    a_hat: ArrayLike, Q: ArrayLike, candidates: int = 2, node_limit: int = NODE_LIMIT
) -> AmbiguitySolution:
    """Reference of ``min (a_hat - a)' Q^-1 (a_hat - a)`` over integer a, the best ``candidates`` of them.

    Parameters
    ----------
    a_hat, Q
        Float solutions (..., n) [cycles] and their covariances (..., n, n) [cycles^2]; batch axes broadcast.
    candidates, node_limit
        How many to return (>= 2), and the most nodes a search may visit.

    Raises
    ------
    InputError
        When shapes or counts do not fit. NaN and singular covariances are statuses, not errors.
    """
    a, cov, batch = problems_of(a_hat, Q, candidates, node_limit)
    solved = [_solve_one(x, q, candidates, node_limit) for x, q in zip(a, cov, strict=True)]
    columns = list(zip(*solved, strict=True)) if solved else [(), (), (), ()]
    n = a.shape[-1]
    return AmbiguitySolution(
        np.array(columns[0], dtype=np.float64).reshape(*batch, candidates, n),
        np.array(columns[1], dtype=np.float64).reshape(*batch, candidates),
        np.array(columns[2], dtype=np.float64).reshape(batch),
        np.array(columns[3], dtype=np.int64).reshape(batch),
    )
