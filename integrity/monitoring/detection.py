"""Fault detection by least squares (S1 3.1, S2 4.1): global test, solution separation, maximum direction, w-test.

NumPy reference, batched over any leading axes, rows out of use masked. Letters: ``W = Q_y^-1``,
``S = (G'WG)^-1 G'W``, ``e`` the residuals, ``Q_e = Q_y - G (G'WG)^-1 G'``, ``M = W Q_e W``, ``u = W e``. A fault mode i
is a set of rows with columns C in the identity; removing them is the same as estimating their biases
``(C'MC)^-1 C'u``, so no adjustment is repeated: ``d_i = x - x_i = S C (C'MC)^+ C'u``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.detection_kernel import RANK_TOLERANCE

__all__ = [
    "Adjustment",
    "ModeSeparation",
    "TestOutcome",
    "TestResult",
    "adjust",
    "checked_modes",
    "chi2_threshold",
    "diagonal_covariance",
    "direction_test",
    "global_test",
    "minimal_detectable_bias",
    "mode_statistics",
    "normal_threshold",
    "separate",
    "separation_test",
    "w_test",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

SINGULAR_TOLERANCE = 1e-10  # smallest eigenvalue of the correlation form of a normal matrix that has a solution


class TestOutcome(Advice):
    """What a test found."""

    __test__ = False  # not a test case, whatever pytest thinks of the name

    PASSED = 0, "no fault detected"
    FAILED = 1, "fault detected; exclude it or do not use the solution"
    NO_REDUNDANCY = 2, "too few measurements to test; only the protection level guards"
    SINGULAR = 3, "geometry has no solution; wait for more satellites"


@dataclass(frozen=True)
class Adjustment:
    """A weighted least-squares solution with what its tests need.

    Attributes
    ----------
    x : (..., n) solution; 0 where singular and for unknowns no used row sees.
    residual : (..., m) ``e = (I - G S) y``; 0 in masked rows.
    weight : (..., m, m) W; gain : (..., n, m) S; reliability : (..., m, m) M = W Q_e W. All 0 in masked rows.
    used : (..., m) rows in use.
    df : (...,) redundancy, used rows minus estimable unknowns.
    solvable : (...,) whether the geometry has a solution.
    """

    x: Array
    residual: Array
    weight: Array
    gain: Array
    reliability: Array
    used: Bools
    df: Ints
    solvable: Bools

    @property
    def score(self) -> Array:
        """``u = W e``, (..., m)."""
        return np.asarray(np.einsum("...ij,...j->...i", self.weight, self.residual))


def adjust(
    design: ArrayLike, covariance: ArrayLike, observation: ArrayLike, used: ArrayLike | None = None
) -> Adjustment:
    """``x = S y``, ``e = y - G x``, ``Q_e = Q_y - G (G'WG)^-1 G'`` (S1 eq 8-9, with W = Q_y^-1).

    Parameters
    ----------
    design : (..., m, n) G; an unknown that no used row sees (a clock without satellites) is left out of the count.
    covariance : (..., m, m) Q_y; of uncorrelated rows, :func:`diagonal_covariance` of their variances.
    observation : (..., m) y.
    used : (..., m) rows in use, all by default.

    Raises
    ------
    InputError
        Shapes that do not fit, non-finite entries, or variances of used rows that are not positive.
    """
    G, Q, y, mask = _checked_inputs(design, covariance, observation, used)
    G = np.where(mask[..., None], G, 0.0)
    y = np.where(mask, y, 0.0)
    W = _inverse_of_used(Q, mask)
    GtW = np.swapaxes(G, -1, -2) @ W
    inverse, solvable, unknowns = _safe_inverse(GtW @ G)
    S = inverse @ GtW
    x = np.einsum("...ij,...j->...i", S, y)
    e = np.where(solvable[..., None], y - np.einsum("...ij,...j->...i", G, x), 0.0)
    M = np.where(solvable[..., None, None], W - np.swapaxes(GtW, -1, -2) @ S, 0.0)
    df = np.where(solvable, mask.sum(-1) - unknowns, 0)
    return Adjustment(x, e, W, S, M, mask, df, solvable)


def _checked_inputs(
    design: ArrayLike, covariance: ArrayLike, observation: ArrayLike, used: ArrayLike | None
) -> tuple[Array, Array, Array, Bools]:
    """G, Q_y, y and the mask, broadcast to common leading axes."""
    G, y = require_finite("design", design), require_finite("observation", observation)
    if y.ndim == 0:
        raise InputError("observation must have shape (..., m), got a scalar: pass one entry for each row")
    m = y.shape[-1]
    require_shape("design", G, (m, None))
    Q = require_finite("covariance", covariance)
    require_shape("covariance", Q, (m, m))
    mask = np.ones(m, dtype=np.bool_) if used is None else np.asarray(used, dtype=np.bool_)
    require_shape("used", mask, (m,))
    lead = np.broadcast_shapes(G.shape[:-2], Q.shape[:-2], y.shape[:-1], mask.shape[:-1])
    mask = np.broadcast_to(mask, (*lead, m))
    variance = np.broadcast_to(np.diagonal(Q, axis1=-2, axis2=-1), (*lead, m))
    if not (variance[mask] > 0.0).all():
        raise InputError(f"covariance must have positive variances, got {variance[mask].min()}: mask that row")
    full = [
        np.broadcast_to(G, (*lead, *G.shape[-2:])),
        np.broadcast_to(Q, (*lead, m, m)),
        np.broadcast_to(y, (*lead, m)),
    ]
    return full[0], full[1], full[2], mask


def _inverse_of_used(Q: Array, mask: Bools) -> Array:
    """Inverse of the block of used rows, 0 elsewhere."""
    both = mask[..., None, :] & mask[..., :, None]
    block = np.where(both, Q, np.eye(mask.shape[-1]))
    try:
        return np.where(both, np.linalg.inv(block), 0.0)
    except np.linalg.LinAlgError as exc:
        raise InputError("covariance must be positive definite, got a singular one: mask a duplicate row") from exc


def _safe_inverse(normal: Array) -> tuple[Array, Bools, Ints]:
    """Inverse of the normal matrix, whether it exists, and the number of unknowns that any row sees."""
    scale = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    seen = scale > 0.0
    safe = np.where(seen, scale, 1.0)
    correlation = normal / (safe[..., :, None] * safe[..., None, :])
    correlation = np.where(seen[..., :, None] & seen[..., None, :], correlation, np.eye(scale.shape[-1]))
    unknowns = seen.sum(-1)
    solvable = (np.linalg.eigvalsh(correlation)[..., 0] > SINGULAR_TOLERANCE) & (unknowns > 0)
    correlation = np.where(solvable[..., None, None], correlation, np.eye(scale.shape[-1]))
    inverse = np.linalg.inv(correlation) / (safe[..., :, None] * safe[..., None, :])
    keep = solvable[..., None, None] & seen[..., :, None] & seen[..., None, :]
    return np.where(keep, inverse, 0.0), solvable, unknowns


@dataclass(frozen=True)
class TestResult:
    """Statistics, thresholds and outcome codes of :class:`TestOutcome`, all of one shape; statistics are never NaN."""

    __test__ = False

    statistic: Array
    threshold: Array
    outcome: Ints

    @property
    def failed(self) -> Bools:
        """Where a fault was detected."""
        return np.asarray(self.outcome == TestOutcome.FAILED.code)

    @property
    def excess(self) -> Array:
        """Statistic over threshold, 0 where there was nothing to test: comparable between modes of different rank."""
        return np.asarray(self.statistic / np.where(np.isfinite(self.threshold), self.threshold, np.inf))


def _result(statistic: Array, threshold: ArrayLike, testable: ArrayLike, solvable: ArrayLike) -> TestResult:
    statistic, limit = np.broadcast_arrays(statistic, np.asarray(threshold, dtype=np.float64))
    ok = np.broadcast_to(testable, statistic.shape)
    outcome = np.where(statistic >= limit, TestOutcome.FAILED.code, TestOutcome.PASSED.code)
    outcome = np.where(ok, outcome, TestOutcome.NO_REDUNDANCY.code)
    outcome = np.where(solvable, outcome, TestOutcome.SINGULAR.code)
    return TestResult(np.where(ok, statistic, 0.0), np.where(ok, limit, np.inf), outcome.astype(np.int64))


def chi2_threshold(significance: ArrayLike, df: ArrayLike) -> Array:
    """``chi2_{1-significance}(df)``, ``inf`` where df < 1."""
    degrees = np.asarray(df)
    return np.where(degrees >= 1, chdtri(np.maximum(degrees, 1), significance), np.inf)


def global_test(adjustment: Adjustment, significance: ArrayLike) -> TestResult:
    """UMPI test ``e'Q_y^-1 e >= chi2_{1-a1}(df)`` (S1 eq 8, corrected to Q_y).  significance (...,) -> (...,)."""
    statistic = np.maximum((adjustment.residual * adjustment.score).sum(-1), 0.0)
    threshold = chi2_threshold(significance, adjustment.df)
    return _result(statistic, threshold, adjustment.df >= 1, adjustment.solvable)


def _diagonal(matrix: Array) -> Array:
    return np.asarray(np.diagonal(matrix, axis1=-2, axis2=-1))


def diagonal_covariance(variance: ArrayLike) -> Array:
    """Q_y of uncorrelated rows.  variance (..., m) -> (..., m, m)."""
    entries = require_finite("variance", variance)
    return np.asarray(entries[..., None] * np.eye(entries.shape[-1]))


def minimal_detectable_bias(adjustment: Adjustment, lambda0: ArrayLike) -> Array:
    """Smallest bias of each row found: ``sqrt(lambda_0 / c'W Q_e W c)``, ``inf`` where it cannot be checked.

    ``lambda0`` is that of :func:`~lanebound.integrity.monitoring.significance.noncentrality`.  (..., m), in units of y.
    """
    redundancy = _diagonal(adjustment.reliability)
    testable = redundancy > RANK_TOLERANCE * _diagonal(adjustment.weight)
    lam = np.asarray(lambda0, dtype=np.float64)[..., None]
    return np.where(testable, np.sqrt(lam / np.where(testable, redundancy, 1.0)), np.inf)


def checked_modes(modes: ArrayLike | None, rows: int) -> Bools:
    """Fault modes as (k, m) bool, row sets; each row alone by default."""
    if modes is None:
        return np.eye(rows, dtype=np.bool_)
    sets = np.asarray(modes, dtype=np.bool_)
    if sets.ndim != 2:
        raise InputError(f"modes must have shape (k, {rows}), got {sets.shape}: one row of flags for each fault mode")
    require_shape("modes", sets, (rows,))
    return sets


@dataclass(frozen=True)
class _Blocks:
    """Pseudo-inverse of C'MC of each mode on the r rows of the largest one, with what it leaves undetermined.

    member (k, r) indices of rows, 0 where a mode has fewer; inverse, null (..., k, r, r), zero there.
    """

    member: Ints
    inverse: Array
    rank: Ints
    null: Array
    active: Bools


def _members(modes: Bools) -> tuple[Ints, Bools]:
    """Row indices of each mode, filled up with 0 to those of the largest mode, and which of them count.  (k, r)."""
    count = modes.sum(-1)
    counts = np.arange(max(int(count.max(initial=0)), 1)) < count[:, None]
    member = np.zeros(counts.shape, dtype=np.int64)
    member[counts] = np.nonzero(modes)[1]
    return member, counts


def _mode_blocks(adjustment: Adjustment, modes: Bools) -> _Blocks:
    member, counts = _members(modes)
    rows = counts & adjustment.used[..., member]
    scale = np.sqrt(np.where(adjustment.used, _diagonal(adjustment.weight), 1.0))[..., member]
    block = adjustment.reliability[..., member[:, :, None], member[:, None, :]]
    block = block / (scale[..., :, None] * scale[..., None, :])
    value, vector = np.linalg.eigh(np.where(rows[..., :, None] & rows[..., None, :], block, 0.0))
    kept = value > RANK_TOLERANCE
    inverse = (vector * np.where(kept, 1.0 / np.where(kept, value, 1.0), 0.0)[..., None, :]) @ np.swapaxes(
        vector, -1, -2
    )
    unit = 1.0 / scale
    determined = (vector * kept[..., None, :]) @ np.swapaxes(vector, -1, -2)
    projector = np.where(rows[..., :, None], np.eye(rows.shape[-1]), 0.0) - determined
    return _Blocks(
        member=member,
        inverse=inverse * unit[..., :, None] * unit[..., None, :],
        rank=kept.sum(-1),
        null=projector * unit[..., :, None],
        active=np.asarray(rows.any(-1)),
    )


def mode_statistics(adjustment: Adjustment, modes: ArrayLike | None = None) -> tuple[Array, Ints]:
    """``u'C (C'MC)^+ C'u ~ chi2(rank)`` of each mode, statistic and rank (..., k); rank 0 where nothing can be checked.

    For a single row it is w squared; for k rows the correlated form that tests code and phase of a satellite together.
    """
    blocks = _mode_blocks(adjustment, checked_modes(modes, adjustment.used.shape[-1]))
    u = adjustment.score[..., blocks.member]
    return np.maximum(np.einsum("...ki,...kij,...kj->...k", u, blocks.inverse, u), 0.0), blocks.rank


def w_test(adjustment: Adjustment, significance: ArrayLike, modes: ArrayLike | None = None) -> TestResult:
    """Each mode's statistic against ``chi2_{1-a}(rank)``; ``significance`` (...,) is that of one mode.  -> (..., k)."""
    statistic, rank = mode_statistics(adjustment, modes)
    local = np.asarray(significance, dtype=np.float64)[..., None]
    return _result(statistic, chi2_threshold(local, rank), rank >= 1, adjustment.solvable[..., None])


@dataclass(frozen=True)
class ModeSeparation:
    """Separations ``d_i = x - x_i`` of k modes.

    Attributes
    ----------
    d_en_m : (..., k, 2) in East and North; covariance_m2 : (..., k, 2, 2) ``Q_di = (S_i - S) Q_y (S_i - S)'``.
    active : (..., k) modes with rows in use; monitored : (..., k) those whose removal leaves a solution.
    solvable : (...,) of the full solution.
    """

    d_en_m: Array
    covariance_m2: Array
    active: Bools
    monitored: Bools
    solvable: Bools

    @property
    def n_modes(self) -> Ints:
        """Number of modes in use (...,), at least 1: what a false alarm is shared among."""
        return np.asarray(np.maximum(self.active.sum(-1), 1))


def separate(adjustment: Adjustment, modes: ArrayLike | None = None) -> ModeSeparation:
    """Separation in East and North, the first two unknowns, of each mode (S1 eq 10-12).  modes (k, m) row sets."""
    blocks = _mode_blocks(adjustment, checked_modes(modes, adjustment.used.shape[-1]))
    gain = np.swapaxes(adjustment.gain[..., :2, blocks.member], -3, -2)  # (..., k, 2, r)
    step = gain @ blocks.inverse
    d = np.einsum("...kij,...kj->...ki", step, adjustment.score[..., blocks.member])
    Q = step @ np.swapaxes(gain, -1, -2)
    undetermined = np.abs(gain @ blocks.null).max((-2, -1))
    sigma = 1.0 / np.sqrt(np.where(adjustment.used, _diagonal(adjustment.weight), 1.0))
    size = np.abs(adjustment.gain[..., :2, :] * sigma[..., None, :]).max((-2, -1))[..., None]
    feasible = undetermined <= np.sqrt(RANK_TOLERANCE) * size
    monitored = blocks.active & feasible & adjustment.solvable[..., None]
    return ModeSeparation(d, Q, blocks.active, monitored, adjustment.solvable)


def separation_test(
    separation: ModeSeparation, heading_rad: ArrayLike, alpha: ArrayLike, n_modes: ArrayLike | None = None
) -> TestResult:
    """AT and CT test: fault when ``|d_i| / sigma_di >= Qinv(a / (2 * 2 * n_modes))`` on either (S2 eq 8 with "or").

    heading_rad, alpha, n_modes (...,); n_modes counts the modes in use unless given. -> (..., k, 2), last AT, CT.
    """
    size = require_in_range("alpha", alpha, 0.0, 1.0, low_open=True, high_open=True)
    R = track_from_enu_matrix(heading_rad)[..., None, :, :]
    d = np.abs(np.einsum("...ij,...j->...i", R, separation.d_en_m))
    variance = _diagonal(R @ separation.covariance_m2 @ R)
    total = _diagonal(separation.covariance_m2).sum(-1)[..., None]
    moves = variance > RANK_TOLERANCE**2 * np.maximum(total, np.finfo(np.float64).tiny)
    statistic = np.where(moves, d / np.sqrt(np.where(moves, variance, 1.0)), 0.0)
    count = separation.n_modes if n_modes is None else np.asarray(n_modes)
    threshold = normal_threshold(size / (4.0 * count))[..., None, None]
    ok = separation.monitored[..., None]
    return _result(statistic, threshold, ok, separation.solvable[..., None, None])


def normal_threshold(tail: ArrayLike) -> Array:
    """``Qinv(tail)``, the point that N(0, 1) exceeds with this probability."""
    return np.asarray(-ndtri(np.asarray(tail, dtype=np.float64)))


def direction_test(separation: ModeSeparation, alpha: ArrayLike, n_modes: ArrayLike | None = None) -> TestResult:
    """Maximum-direction test ``d' Q_di^+ d >= chi2_{1-a/n_modes}(rank Q_di)`` (S2 eq 9), for turns.

    A single-satellite Q_di has rank 1, where the published eigenvalue form divides by zero. -> (..., k).
    """
    size = require_in_range("alpha", alpha, 0.0, 1.0, low_open=True, high_open=True)
    value, vector = np.linalg.eigh(separation.covariance_m2)
    kept = value > RANK_TOLERANCE * np.maximum(value[..., -1:], np.finfo(np.float64).tiny)
    along = np.einsum("...ij,...i->...j", vector, separation.d_en_m)
    statistic = (np.where(kept, along, 0.0) ** 2 / np.where(kept, value, 1.0)).sum(-1)
    rank = kept.sum(-1)
    count = separation.n_modes if n_modes is None else np.asarray(n_modes)
    threshold = chi2_threshold(np.asarray(size / count)[..., None], rank)
    return _result(statistic, threshold, separation.monitored & (rank >= 1), separation.solvable[..., None])
