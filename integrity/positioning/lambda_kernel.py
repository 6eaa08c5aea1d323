"""Integer least squares: decorrelation of the ambiguities, MLAMBDA search, bootstrapped failure rate.

Conventions of every kernel in this file
    ``n`` ambiguities are used, whatever the capacity ``c >= n`` of the arrays. ``a`` is the float solution [cycles],
    ``Q`` (>= n, >= n) its covariance [cycles^2]. The factor of the covariance of ``z = Z'a`` is
    ``Z'QZ = U diag(D) U'`` with a unit upper triangular U, so that ``D[i]`` is the variance of z_i given
    z_{i+1} .. z_{n-1}: the last one is the most precise. All of them are arrays of :class:`SearchScratch`.

Sources: Teunissen (1995), J. Geodesy 70, 65-82 (decorrelation); Teunissen (1998), J. Geodesy 72, 606-612
(bootstrapping); de Jonge & Tiberius (1996), LGR series 12; Chang, Yang & Zhou (2005), J. Geodesy 79, 552-565 (MLAMBDA).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

Array = NDArray[np.float64]

OK, NODE_LIMIT, NOT_POSITIVE_DEFINITE, NOT_FINITE = 0, 1, 2, 3  # values of ambiguity.SearchStatus
SWAP_GAIN = 0.99  # Lovasz factor: a swap has to win 1 %, so that a drifting covariance keeps its transform
PIVOT_FLOOR = 1e-13  # a conditional variance below this share of the variance is a loss of rank
GROWTH_LIMIT = 64.0  # [1] entries of the factor above it are rounded off at once, so that no digits are lost
SMALL_VARIANCE = 0.05**2  # [cycles^2] below it everywhere, the search needs no decorrelation
NO_FAILURE_VARIANCE = 0.0036  # [cycles^2] sigma 0.06: erfc(1 / (2 sqrt(2) sigma)) < 1e-16


class SearchScratch(NamedTuple):
    """Arrays of a search for up to c ambiguities and m candidates; matrices (c, c), vectors (c,).

    Out: Zt = Z' (its rows are the new ambiguities, integers as floats), Z_inverse = Z^-1 (its rows bring them back,
    ``a = sum_i z_i Z^-1[i]``), U, D; candidates (m, c), best first, and norms (m,). Inside: A, L, S; distance, mean, z,
    step, inverse of the search; rounded, z_float, solution of the transformations.
    """

    Zt: Array
    Z_inverse: Array
    A: Array
    U: Array
    L: Array
    S: Array
    D: Array
    distance: Array
    mean: Array
    z: Array
    step: Array
    inverse: Array
    rounded: Array
    z_float: Array
    solution: Array
    candidates: Array
    norms: Array


@jit
def search_scratch(c: int, m: int) -> SearchScratch:
    """Allocate the scratch for up to c ambiguities and m candidates."""
    return SearchScratch(
        np.zeros((c, c)), np.zeros((c, c)), np.zeros((c, c)), np.zeros((c, c)), np.zeros((c, c)), np.zeros((c, c)),
        np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c), np.zeros(c),
        np.zeros(c), np.zeros((m, c)), np.zeros(m),
    )  # fmt: skip


@jit(borrows=True)
def identity(n: int, Zt: Array, Z_inverse: Array) -> None:
    """Set the transformation to the identity: the cold start of :func:`decorrelate`."""
    for i in range(n):
        for j in range(n):
            Zt[i, j], Z_inverse[i, j] = 0.0, 0.0
        Zt[i, i], Z_inverse[i, i] = 1.0, 1.0


@jit(borrows=True)
def transformed_covariance(n: int, Q: Array, Zt: Array, T: Array, A: Array) -> None:
    """Lower triangle of ``A = Z' Q Z``; T is scratch. Zeros of Z, the majority, are skipped."""
    for i in range(n):
        for q in range(n):
            T[i, q] = 0.0
        for k in range(n):
            z = Zt[i, k]
            if z != 0.0:
                for q in range(n):
                    T[i, q] += z * Q[k, q]
        for j in range(i + 1):
            total = 0.0
            for q in range(n):
                total += T[i, q] * Zt[j, q]
            A[i, j] = total


@jit(borrows=True)
def _swap_rows(M: Array, i: int, j: int, n: int) -> None:
    """Exchange the first n entries of two rows."""
    for q in range(n):
        kept = M[i, q]
        M[i, q] = M[j, q]
        M[j, q] = kept


@jit(borrows=True)
def _pivot(n: int, i: int, A: Array, U: Array, D: Array, Zt: Array, Z_inverse: Array) -> None:
    """Bring the smallest remaining variance to position i (symmetric pivoting: most swaps are then spared later)."""
    p = i
    for q in range(i):
        if A[q, q] < A[p, p]:
            p = q
    if p == i:
        return
    _swap_rows(A, p, i, p)
    for q in range(p + 1, i):
        A[q, p], A[i, q] = A[i, q], A[q, p]
    A[p, p], A[i, i] = A[i, i], A[p, p]
    D[p], D[i] = D[i], D[p]
    _swap_rows(U, p, i, n)
    _swap_rows(Zt, p, i, n)
    _swap_rows(Z_inverse, p, i, n)


@jit(borrows=True)
def factor(n: int, A: Array, U: Array, D: Array, pivot: bool, Zt: Array, Z_inverse: Array) -> int:
    """Factor ``A = U diag(D) U'`` from its lower triangle, which is overwritten; OK or NOT_POSITIVE_DEFINITE."""
    for i in range(n):
        if not A[i, i] > 0.0:
            return NOT_POSITIVE_DEFINITE
        D[i] = A[i, i] * PIVOT_FLOOR
        for q in range(n):
            U[i, q] = 0.0
    for i in range(n - 1, -1, -1):
        if pivot:
            _pivot(n, i, A, U, D, Zt, Z_inverse)
        d = A[i, i]
        if not (d > D[i] and d < math.inf):
            return NOT_POSITIVE_DEFINITE
        D[i] = d
        U[i, i] = 1.0
        inverse = 1.0 / d
        for j in range(i):
            u = A[i, j] * inverse
            U[j, i] = u
            for q in range(j + 1):
                A[j, q] -= u * A[i, q]
    return OK


@jit(borrows=True)
def _gauss(n: int, j: int, i: int, U: Array, Zt: Array, Z_inverse: Array) -> None:
    """Integer Gauss transformation ``z_j -= mu z_i`` with ``mu = round(U_ji)``, i > j."""
    mu = np.floor(U[j, i] + 0.5)
    if mu != 0.0:
        for q in range(n):
            U[j, q] -= mu * U[i, q]
        for q in range(n):
            Zt[j, q] -= mu * Zt[i, q]
        for q in range(n):
            Z_inverse[i, q] += mu * Z_inverse[j, q]


@jit(borrows=True)
def reduce_block(n: int, first: int, U: Array, D: Array, Zt: Array, Z_inverse: Array) -> None:
    """Exchange neighbours until ``D[j] + U_j,j+1^2 D[j+1] >= D[j+1]`` throughout the trailing block ``first .. n-1``.

    Work starts at the end, so a block whose tail is already reduced costs only its new rows. Before an exchange the
    entry in question is rounded off, and others of its row when they have grown (rounding them all off is left to
    :func:`size_reduce`; it does not change D).
    """
    j = n - 2
    while j >= first and j >= 0:
        u = U[j, j + 1]
        u -= np.floor(u + 0.5)
        d = D[j] + u * u * D[j + 1]
        if not d < SWAP_GAIN * D[j + 1]:
            j -= 1
            continue
        for i in range(j + 1, n):
            size = abs(U[j, i])
            if size > GROWTH_LIMIT or (i == j + 1 and size > 0.5):
                _gauss(n, j, i, U, Zt, Z_inverse)
        u = U[j, j + 1]
        eta, lam = D[j] / d, D[j + 1] * u / d
        D[j], D[j + 1] = eta * D[j + 1], d
        for q in range(j):
            left, right = U[q, j], U[q, j + 1]
            U[q, j], U[q, j + 1] = right - u * left, eta * left + lam * right
        _swap_rows(U, j, j + 1, n)
        U[j, j], U[j, j + 1], U[j + 1, j], U[j + 1, j + 1] = 1.0, lam, 0.0, 1.0
        _swap_rows(Zt, j, j + 1, n)
        _swap_rows(Z_inverse, j, j + 1, n)
        j = min(j + 1, n - 2)


@jit(borrows=True)
def size_reduce(n: int, U: Array, Zt: Array, Z_inverse: Array) -> None:
    """Bring every entry of the unit triangular factor to within +-1/2."""
    for j in range(n - 2, -1, -1):
        for i in range(j + 1, n):
            if abs(U[j, i]) > 0.5:
                _gauss(n, j, i, U, Zt, Z_inverse)


@jit(borrows=True)
def all_small(n: int, Q: Array) -> bool:
    """Whether every standard deviation is below 0.05 cycles: rounding is then almost always the answer."""
    for i in range(n):
        if not Q[i, i] < SMALL_VARIANCE:
            return False
    return True


@jit(borrows=True)
def decorrelate(n: int, Q: Array, warm: bool, scratch: SearchScratch) -> int:
    """Decorrelate: ``Z'QZ = U diag(D) U'`` with nearly diagonal U; OK or NOT_POSITIVE_DEFINITE.

    Parameters
    ----------
    n, Q
        Number of ambiguities and their covariance [cycles^2]; only the lower triangle is read when cold.
    warm
        The scratch holds the transformation of an earlier call for the same ambiguities: few changes remain. Otherwise
        it is reset.
    scratch
        Out: Zt, Z_inverse, U and D.
    """
    Zt, Z_inverse, A, U, D = scratch.Zt, scratch.Z_inverse, scratch.A, scratch.U, scratch.D
    if warm:
        transformed_covariance(n, Q, Zt, scratch.S, A)
    else:
        identity(n, Zt, Z_inverse)
        for i in range(n):
            for j in range(i + 1):
                A[i, j] = Q[i, j]
    status = factor(n, A, U, D, not warm, Zt, Z_inverse)
    if status == OK and (warm or not all_small(n, Q)):
        reduce_block(n, 0, U, D, Zt, Z_inverse)
        size_reduce(n, U, Zt, Z_inverse)
    return int(status)


@jit
def bootstrap_failure_rate(first: int, n: int, D: Array) -> float:
    """``P_IF = 1 - prod_{i >= first} (2 Phi(1 / (2 sigma_i)) - 1)``, ``sigma_i = sqrt(D[i])`` [cycles].

    The bootstrapped failure rate, an upper bound of that of integer least squares, accurate down to 1e-15: each factor
    is ``1 - erfc(1 / (2 sqrt(2) sigma))`` and the product is a sum of log1p (Teunissen 1998).
    """
    log_success = 0.0
    for i in range(first, n):
        if D[i] > NO_FAILURE_VARIANCE:
            log_success += math.log1p(-math.erfc(math.sqrt(0.125 / D[i])))
    return -math.expm1(log_success)


@jit(borrows=True)
def _insert(n: int, m: int, z: Array, distance: float, candidates: Array, norms: Array) -> float:
    """Insert a candidate into the m best, ordered by norm; returns the norm that a further one has to beat."""
    slot = m - 1
    while slot > 0 and norms[slot - 1] > distance:
        norms[slot] = norms[slot - 1]
        for i in range(n):
            candidates[slot, i] = candidates[slot - 1, i]
        slot -= 1
    norms[slot] = distance
    for i in range(n):
        candidates[slot, i] = z[i]
    return float(norms[m - 1])


@jit(borrows=True)
def search(n: int, node_limit: int, scratch: SearchScratch) -> int:
    """The m integer vectors nearest to the float solution in the metric of its covariance, best first.

    Depth-first search of ``sum_i (z_i - zbar_i)^2 / D_i < bound`` in zig-zag order from the last ambiguity, the bound
    shrinking to the norm of the m-th best (Chang et al. 2005, section 4). Returns OK, or NODE_LIMIT when
    ``node_limit`` nodes did not suffice: the candidates are then good, but not proven best.

    ``scratch`` holds U, D and z_float [cycles]; its candidates and norms are filled, in the decorrelated domain.
    """
    U, D, L, S, z_float = scratch.U, scratch.D, scratch.L, scratch.S, scratch.z_float
    distance, mean, z, step, inverse = scratch.distance, scratch.mean, scratch.z, scratch.step, scratch.inverse
    candidates, norms = scratch.candidates, scratch.norms
    m = norms.shape[0]
    for slot in range(m):
        norms[slot] = math.inf
    if n <= 0:
        norms[0] = 0.0
        return OK
    for i in range(n):
        S[n - 1, i] = z_float[i]
        inverse[i] = 1.0 / D[i]
        for q in range(i):
            L[i, q] = U[q, i]
    k = n - 1
    distance[k] = 0.0
    mean[k] = z_float[k]
    z[k] = np.floor(mean[k] + 0.5)
    y = mean[k] - z[k]
    step[k] = 1.0 if y > 0.0 else -1.0
    bound = math.inf
    for _ in range(node_limit):
        norm = distance[k] + y * y * inverse[k]
        if norm < bound:
            if k > 0:
                pull = z[k] - mean[k]
                k -= 1
                distance[k] = norm
                for q in range(k + 1):
                    S[k, q] = S[k + 1, q] + pull * L[k + 1, q]
                mean[k] = S[k, k]
                z[k] = np.floor(mean[k] + 0.5)
                y = mean[k] - z[k]
                step[k] = 1.0 if y > 0.0 else -1.0
                continue
            bound = _insert(n, m, z, norm, candidates, norms)
        elif k == n - 1:
            return OK
        else:
            k += 1
        z[k] += step[k]
        y = mean[k] - z[k]
        step[k] = -step[k] - (1.0 if step[k] > 0.0 else -1.0)
    return NODE_LIMIT


@jit(borrows=True)
def to_decorrelated(n: int, a_hat: Array, Zt: Array, a_integer: Array, z_float: Array) -> None:
    """``z = Z' (a - round(a))``: whole cycles are set aside in ``a_integer``, so that large counts lose no digits."""
    for i in range(n):
        a_integer[i] = np.floor(a_hat[i] + 0.5)
    for i in range(n):
        total = 0.0
        for q in range(n):
            total += Zt[i, q] * (a_hat[q] - a_integer[q])
        z_float[i] = total


@jit(borrows=True)
def from_decorrelated(n: int, z: Array, Z_inverse: Array, a_integer: Array, a: Array) -> None:
    """``a = round(a_hat) + Z^-T z``; ``a`` may not share memory with ``z``."""
    for q in range(n):
        a[q] = a_integer[q]
    for i in range(n):
        if z[i] != 0.0:
            for q in range(n):
                a[q] += z[i] * Z_inverse[i, q]


@jit(borrows=True)
def all_finite(n: int, a_hat: Array) -> bool:
    """Whether every entry of the float solution is finite."""
    for i in range(n):
        if not abs(a_hat[i]) < math.inf:
            return False
    return True


@jit(borrows=True)
def integer_least_squares(n: int, a_hat: Array, Q: Array, node_limit: int, warm: bool, scratch: SearchScratch) -> int:
    """The integer vectors nearest to ``a_hat`` in the metric of Q: ``min (a_hat - a)' Q^-1 (a_hat - a)``.

    Parameters
    ----------
    n, a_hat, Q
        Number of ambiguities, float solution [cycles] and its covariance [cycles^2].
    node_limit
        The most nodes that the search may visit.
    warm
        The scratch holds the transformation of an earlier OK call for the same ambiguities in the same order.
    scratch
        Out: candidates, integers as floats, best first; norms, squared (inf where there is no candidate; with n = 0
        the one candidate is empty and has norm 0); D, conditional variances for :func:`bootstrap_failure_rate`.

    Returns
    -------
    OK, NODE_LIMIT (candidates are good, not proven best), NOT_POSITIVE_DEFINITE or NOT_FINITE (candidates are
    untouched, norms are inf and the transformation must not be used again).
    """
    candidates, norms, solution = scratch.candidates, scratch.norms, scratch.solution
    for slot in range(norms.shape[0]):
        norms[slot] = math.inf
    if not all_finite(n, a_hat):
        return NOT_FINITE
    status = decorrelate(n, Q, warm, scratch)
    if status != OK:
        return int(status)
    to_decorrelated(n, a_hat, scratch.Zt, scratch.rounded, scratch.z_float)
    status = search(n, node_limit, scratch)
    for slot in range(norms.shape[0]):
        if norms[slot] < math.inf:
            for i in range(n):
                solution[i] = candidates[slot, i]
            from_decorrelated(n, solution, scratch.Z_inverse, scratch.rounded, candidates[slot])
    return int(status)


@jit(borrows=True)
def largest_prefix(
    n_groups: int, group: int, Q: Array, failure_limit: float, scratch: SearchScratch
) -> tuple[int, float]:
    """How many groups of ambiguities, best first, can be fixed together within a failure rate.

    The ambiguities of Q are ordered from the best satellite to the worst, ``group`` of them to a satellite (both
    bands). The answer is the largest k for which the decorrelated ambiguities of the first k groups have a bootstrapped
    failure rate within ``failure_limit``, and that rate: ``(k, P_IF)``; (0, 0) when there is none, and (-1, 1) when the
    covariance is not positive definite. Satellites outside keep their float ambiguities. The rate is not monotonic in k
    (a further satellite is one more to fix, but strengthens the geometry once fixed), so that every k is tried.

    The reduction works from the last ambiguity forward, so with the best satellites last every prefix is met on the way
    to the whole set: all of them together cost one decorrelation.
    """
    n = n_groups * group
    A, U, D, Zt, Z_inverse = scratch.A, scratch.U, scratch.D, scratch.Zt, scratch.Z_inverse
    for i in range(n):
        for j in range(i + 1):
            A[i, j] = Q[n - 1 - i, n - 1 - j]
    identity(n, Zt, Z_inverse)
    if factor(n, A, U, D, False, Zt, Z_inverse) != OK:
        return -1, 1.0
    best, best_rate = 0, 0.0
    for k in range(1, n_groups + 1):
        reduce_block(n, n - k * group, U, D, Zt, Z_inverse)
        rate = bootstrap_failure_rate(n - k * group, n, D)
        if rate <= failure_limit:
            best, best_rate = k, rate
    return best, best_rate


@jit
def solve_epochs(
    a_hat: Array, Q: Array, node_limit: int, reuse: bool, candidates: Array, norms: Array, failure_rate: Array,
    status: NDArray[np.int64],
) -> None:  # fmt: skip
    """Solve the same ambiguities epoch after epoch, each with the transformation of the one before.

    ``a_hat`` (E, n), ``Q`` (E, n, n) -> ``candidates`` (E, m, n), untouched without a solution, ``norms`` (E, m),
    ``failure_rate`` (E,), ``status`` (E,) int64; the first epoch, those after a failure, and all of them when ``reuse``
    is False, start cold.
    """
    n, m = a_hat.shape[1], norms.shape[1]
    scratch = search_scratch(n, m)
    warm = False
    for e in range(a_hat.shape[0]):
        status[e] = integer_least_squares(n, a_hat[e], Q[e], node_limit, warm, scratch)
        solved = status[e] <= NODE_LIMIT
        failure_rate[e] = bootstrap_failure_rate(0, n, scratch.D) if solved else 1.0
        for slot in range(m):
            norms[e, slot] = scratch.norms[slot]
            if norms[e, slot] < math.inf:
                for i in range(n):
                    candidates[e, slot, i] = scratch.candidates[slot, i]
        warm = solved and reuse
