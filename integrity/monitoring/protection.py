"""Protection levels from solution separation: closed form, multi-hypothesis root, and the batch driver of the kernels.

``PL = inf`` whenever no finite level holds the risk: no solution, a mode with a prior that cannot be solved, or no risk
left after what is spent on events outside the modes. Columns and axes as in
:mod:`lanebound.integrity.monitoring.separation`; priors of the fault-free column are 2 (both sides count).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lanebound.integrity.core.accel import run_rows
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_shape
from lanebound.integrity.core.records import one_record
from lanebound.integrity.monitoring import protection_kernel as kernel
from lanebound.integrity.monitoring.fault_modes import FaultModes
from lanebound.integrity.monitoring.risk import RiskConfig, pair_risk, upper_quantile
from lanebound.integrity.monitoring.separation import Separation
from lanebound.integrity.positioning.geometry_kernel import MAX_GROUPS

__all__ = [
    "BatchLevels",
    "closed_form",
    "closed_form_published",
    "multi_hypothesis",
    "protection_levels",
    "protection_levels_batch",
    "scaled_by_rank",
    "tail_sum",
]


Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FAULT_FREE_PRIOR = 2.0
BISECTIONS = 80
RANK_TOLERANCE = 1e-6  # of the smaller singular value of a separation


@dataclass(frozen=True)
class BatchLevels:
    """Levels of E epochs and R risks, (E, R, 2) [m], inf where none; ``status`` (E,) is a ``Solvability`` code."""

    root_m: Array
    closed_m: Array
    status: Ints


def closed_form(separation: Separation, k_fa: ArrayLike, k_md: ArrayLike) -> Array:
    """``PL = max_i K_fa sigma_di + K_md,i sigma_i + B_i`` (S1 eq 17).

    k_fa (...,); k_md (..., 1 + M) or (..., 1 + M, 2), -inf leaves a mode out -> (..., 2) [m].
    """
    factor = np.asarray(k_md, dtype=np.float64)
    if factor.ndim == 0 or factor.shape[-1] != 2 or factor.ndim < separation.sigma_m.ndim:
        factor = factor[..., None]
    skipped = factor == -np.inf
    with np.errstate(invalid="ignore"):  # factor 0 on a mode without a solution: still inf
        margin = np.where(skipped, 0.0, factor) * np.where(skipped, 1.0, separation.sigma_m)
    margin = np.where(~skipped & np.isinf(separation.sigma_m), np.inf, margin)
    tested = np.asarray(k_fa, dtype=np.float64)[..., None, None] * separation.delta_m
    level = np.where(skipped, -np.inf, tested + margin + separation.bias_m)
    return np.asarray(np.where(np.isfinite(separation.sigma_m[..., 0, :]), level.max(-2), np.inf))


def closed_form_published(separation: Separation, k_fa: ArrayLike, risk: float) -> Array:
    """S1 eq 17 with the printed factor ``K_md = Qinv(risk)``, unsplit, for every mode.  -> (..., 2) [m]."""
    return closed_form(separation, k_fa, np.full(separation.sigma_m.shape[-2], upper_quantile(risk)))


def tail_sum(level_m: ArrayLike, separation: Separation, priors: ArrayLike, k_fa: ArrayLike) -> Array:
    """``f(PL) = sum_i P_i Q((PL - K_fa sigma_di - b_i) / sigma_i)`` (S2 eq 10-11), P_0 = 2.

    level_m (..., 2), priors (..., 1 + M), k_fa (...,) -> (..., 2). A mode without a solution counts with its prior.
    """
    offset = np.asarray(k_fa, dtype=np.float64)[..., None, None] * separation.delta_m + separation.bias_m
    away = np.asarray(level_m, dtype=np.float64)[..., None, :] - offset
    lost = ~np.isfinite(separation.sigma_m)
    chance = np.where(lost, 1.0, ndtr(-away / np.where(lost, 1.0, separation.sigma_m)))
    return np.asarray((np.asarray(priors, dtype=np.float64)[..., None] * chance).sum(-2))


def multi_hypothesis(
    separation: Separation, priors: ArrayLike, k_fa: ArrayLike, budgets: ArrayLike, tolerate: bool = False
) -> Array:
    """The level at which :func:`tail_sum` meets the budget, from above, by bisection to the last bits.

    Parameters
    ----------
    priors : (..., 1 + M) probability of each column, 2 for column 0.
    k_fa : (...,) threshold of the separation test, in sigmas.
    budgets : (..., 2) integrity risk of AT and CT after deductions.
    tolerate : spend the prior of modes without a solution; otherwise they make the level inf.

    Returns
    -------
    (..., 2) [m].
    """
    p = np.asarray(priors, dtype=np.float64)
    risk = np.asarray(budgets, dtype=np.float64)
    lost = (p[..., 1:] * ~np.isfinite(separation.sigma_m[..., 1:, 0])).sum(-1)[..., None]
    hopeless = (risk <= (lost if tolerate else 0.0)) | ~np.isfinite(separation.sigma_m[..., 0, :])
    hopeless = hopeless | ((lost > 0.0) & (not tolerate))
    goal = np.where(hopeless, 0.5, risk)
    low = np.zeros(np.broadcast_shapes(goal.shape, separation.sigma_m[..., 0, :].shape))
    finite = np.where(np.isfinite(separation.sigma_m), separation.sigma_m, 0.0)
    offset = np.asarray(k_fa, dtype=np.float64)[..., None, None] * separation.delta_m + separation.bias_m
    share = np.where(hopeless, 0.1, (risk - lost * tolerate) / p.sum(-1)[..., None])
    high = (offset + upper_quantile(share)[..., None, :] * finite).max(-2) + np.zeros_like(low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        above = tail_sum(middle, separation, p, k_fa) > goal
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.where(hopeless, np.inf, high)


def protection_levels(
    separation: Separation,
    priors: ArrayLike,
    config: RiskConfig,
    risks: ArrayLike | None = None,
    *,
    spent: ArrayLike = 0.0,
) -> Array:
    """PL_AT and PL_CT of each risk: multi-hypothesis root (S2 eq 10-11) with the factors and budgets of ``config``.

    Parameters
    ----------
    separation : (..., 1 + M, 2) from :func:`lanebound.integrity.monitoring.separation.separate`.
    priors : (..., M) fault probability of each mode [-]; a mode with prior 0 is not counted.
    risks : (R,) total horizontal risks; default the configured one.
    spent : (...,) risk already spent, the probability of a wrong fix above all [-].

    Returns
    -------
    (..., R, 2) [m].
    """
    p = require_in_range("priors", priors, 0.0, 1.0)
    require_shape("priors", p, (separation.sigma_m.shape[-2] - 1,))
    n_modes = separation.sigma_m.shape[-2] - 1
    k_fa = config.false_alarm_factors(n_modes)[n_modes]
    if config.direction_test:
        separation = scaled_by_rank(separation, config.false_alarm_factors(n_modes, 2)[n_modes] / k_fa)
    outside = np.asarray(spent, dtype=np.float64) + config.unmonitored_risk
    if config.subtract_multiple:
        outside = outside + pair_risk(p)
    budgets = config.axis_budgets(risks, outside)
    columns = np.concatenate([np.full((*p.shape[:-1], 1), FAULT_FREE_PRIOR), p], -1)
    tolerate, count = config.spend_unsolvable, budgets.shape[-2]
    levels = [multi_hypothesis(separation, columns, k_fa, budgets[..., r, :], tolerate) for r in range(count)]
    return np.stack(levels, -2)


def scaled_by_rank(separation: Separation, factor: Array) -> Separation:
    """The same with the separations of modes that move East and North independently (rank 2) times ``factor``."""
    moved = separation.gain_track[..., :1, :, :] - separation.gain_track[..., 1:, :, :]
    size = np.sqrt((moved**2).sum((-2, -1)))
    plane = np.linalg.matrix_rank(moved, tol=RANK_TOLERANCE * size) > 1
    scale = np.where(plane, factor, 1.0)[..., None]
    return replace(
        separation, delta_m=np.concatenate([separation.delta_m[..., :1, :], scale * separation.delta_m[..., 1:, :]], -2)
    )


def protection_levels_batch(
    los_enu: ArrayLike,
    in_view: ArrayLike,
    group: ArrayLike,
    variance_m2: ArrayLike,
    heading_rad: ArrayLike,
    config: RiskConfig,
    risks: ArrayLike | None = None,
    *,
    accuracy_m2: ArrayLike | None = None,
    bias_m: ArrayLike = 0.0,
    spent: ArrayLike = 0.0,
    subsets: FaultModes | None = None,
    closed: bool = False,
) -> BatchLevels:
    """Multi-hypothesis levels of E epochs with one row for each satellite, by the kernels and exact biases.

    Parameters
    ----------
    los_enu : (E, N, 3) unit vectors receiver to satellite; any value where not in view.
    in_view : (E, N) or (N,) bool.
    group : (E, N) or (N,) clock group of each satellite, 0 to 7.
    variance_m2, accuracy_m2 : (E, N) or (N,) positive, for integrity and for the separations (default the same).
    heading_rad : (E,) or scalar azimuth of motion.
    bias_m : bounds of the nominal biases, >= 0, broadcast to (E, N).
    spent : (E,) or scalar risk already spent [-].
    subsets : further modes of several satellites at once, columns as those of ``in_view``; single satellites and
        constellations have their priors in ``config``.
    closed : compute the closed form too; else its levels are inf.

    Raises
    ------
    InputError
        Wrong shapes, entries in view that are not finite, variances that are not positive, negative biases.
    """
    los = np.require(los_enu, np.float64, ["C", "W"])
    require_shape("los_enu", los, (None, None, 3))
    shape = los.shape[:2]
    epochs = kernel.Epochs(
        los,
        _full(in_view, shape, np.bool_),
        _full(group, shape, np.int64),
        _full(variance_m2, shape),
        _full(variance_m2 if accuracy_m2 is None else accuracy_m2, shape),
        _full(bias_m, shape),
        _full(require_finite("heading_rad", heading_rad), shape[:1]),
        _full(require_in_range("spent", spent, 0.0, 1.0) + config.unmonitored_risk, shape[:1]),
    )
    removed, prior = _subset_columns(subsets, shape[1])
    wanted = require_in_range("risks", config.risks(risks), 0.0, 1.0, low_open=True, high_open=True)
    tables = kernel.RiskTables(
        *config.priors(), removed, prior, _factors_by_rank(config, shape[1] + MAX_GROUPS + len(prior)),
        np.ascontiguousarray(wanted),
    )  # fmt: skip
    rules = one_record(
        kernel.RULES,
        at_share=config.at_share,
        fault_free_share=config.fault_free_share,
        constellations=config.monitors_constellations,
        multiple=config.subtract_multiple,
        tolerate=config.spend_unsolvable,
        closed=closed,
    )
    level = (shape[0], wanted.size, 2)
    out = BatchLevels(np.full(level, np.inf), np.full(level, np.inf), np.zeros(shape[0], np.int64))
    results = kernel.LevelResults(out.status, out.root_m, out.closed_m)
    run_rows(kernel.find_levels, shape[0], epochs, tables, rules, results, row_us=2.0)
    bad = np.flatnonzero(out.status == kernel.BAD_INPUT)
    if bad.size:
        _refuse(int(bad[0]), epochs)
    return out


def _factors_by_rank(config: RiskConfig, largest: int) -> Array:
    """K_fa by the number of fault modes and by rank 0 to 2, a separation's highest.  (largest + 1, 3)."""
    return np.stack([config.false_alarm_factors(largest, max(rank, 1)) for rank in range(3)], -1)


def _subset_columns(subsets: FaultModes | None, satellites: int) -> tuple[NDArray[np.bool_], Array]:
    """Subsets and their priors as the kernel takes them; none at all without any."""
    if subsets is None:
        return np.zeros((0, satellites), np.bool_), np.zeros(0)
    require_shape("subsets.removes", subsets.removes, (None, satellites))
    return np.require(subsets.removes, np.bool_, ["C", "W"]), np.require(subsets.prior, np.float64, ["C", "W"])


def _full(value: ArrayLike, shape: tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
    """``value`` broadcast to ``shape``, contiguous and writable: one kind of array means one compiled kernel."""
    return np.require(np.broadcast_to(np.asarray(value, dtype=dtype), shape), requirements=["C", "W"])


def _refuse(epoch: int, epochs: kernel.Epochs) -> None:
    """Raise the InputError that names what cannot be used at ``epoch``."""
    seen = epochs.in_view[epoch]
    require_in_range(f"group[{epoch}]", epochs.group[epoch, seen], 0, MAX_GROUPS - 1)
    for name, value in (("variance_m2", epochs.variance), ("accuracy_m2", epochs.accuracy)):
        require_in_range(f"{name}[{epoch}]", value[epoch, seen], 0.0, np.inf, low_open=True)
    require_in_range(f"bias_m[{epoch}]", epochs.bias[epoch, seen], 0.0, np.inf)
    require_finite(f"los_enu[{epoch}]", epochs.los[epoch, seen])
    raise InputError(f"los_enu[{epoch}] must hold unit vectors where in view: normalise them or clear in_view")
