"""The closed form of the protection levels (S1 eq 17) with exact factors, in NumPy: the reference for the kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.monitoring.protection import (
    FAULT_FREE_PRIOR,
    closed_form,
    closed_form_published,
    protection_levels,
    scaled_by_rank,
)
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, pair_risk, upper_quantile
from lanebound.integrity.monitoring.separation import Separation

Array = NDArray[np.float64]


def plain_levels(
    separation: Separation,
    priors: ArrayLike,
    config: RiskConfig,
    risks: ArrayLike | None = None,
    *,
    root: bool,
    spent: float = 0.0,
) -> Array:
    """PL_AT and PL_CT (..., R, 2): those of protection_levels, or of the closed form and the variant of ``config``."""
    if root:
        return protection_levels(separation, priors, config, risks, spent=spent)
    p, n_modes = np.asarray(priors, dtype=np.float64), separation.sigma_m.shape[-2] - 1
    k_fa = config.false_alarm_factors(n_modes)[n_modes]
    if config.direction_test:
        separation = scaled_by_rank(separation, config.false_alarm_factors(n_modes, 2)[n_modes] / k_fa)
    if config.variant is Variant.PUBLISHED:
        return np.stack([closed_form_published(separation, k_fa, float(r)) for r in config.risks(risks)], -2)
    outside = spent + config.unmonitored_risk + (pair_risk(p) if config.subtract_multiple else 0.0)
    columns = np.concatenate([np.full((*p.shape[:-1], 1), FAULT_FREE_PRIOR), p], -1)
    return _closed_of_risks(separation, columns, k_fa, config.axis_budgets(risks, outside), config)


def _closed_of_risks(separation: Separation, columns: Array, k_fa: Array, budgets: Array, config: RiskConfig) -> Array:
    """The closed form with exact factors for every row of ``budgets`` (..., R, 2)."""
    shares = mode_shares(columns.shape[-1], config.fault_free_share)
    lost = ~np.isfinite(separation.sigma_m[..., 0])
    spent = (columns * lost)[..., 1:].sum(-1)[..., None, None]
    left = budgets - spent * config.spend_unsolvable
    k_md = missed_detection_factor(left[..., None, :], shares[:, None], columns[..., None, :, None])
    leave_out = (lost & config.spend_unsolvable) | (columns == 0.0)
    k_md = np.where(leave_out[..., None, :, None], -np.inf, k_md)
    levels = np.stack([closed_form(separation, k_fa, k_md[..., r, :, :]) for r in range(budgets.shape[-2])], -2)
    refused = (left <= 0.0) | ((spent > 0.0) & (not config.spend_unsolvable))
    return np.where(refused, np.inf, levels)


def mode_shares(n_columns: int, fault_free_share: float = 0.0) -> Array:
    """Shares w_i of the budget, sum 1: all equal, or ``fault_free_share`` for column 0.  -> (n_columns,)."""
    if fault_free_share <= 0.0 or n_columns == 1:
        return np.full(n_columns, 1.0 / n_columns)
    rest = (1.0 - fault_free_share) / (n_columns - 1)
    return np.concatenate([[fault_free_share], np.full(n_columns - 1, rest)])


def missed_detection_factor(budget: ArrayLike, share: ArrayLike, prior: ArrayLike) -> Array:
    """``K_md,i = Qinv(w_i P_HMI,q / P_i)``, fault-free with P_0 = 2 (equations.md 6).

    budget (...,), share (...,), prior (...,) -> (...,); -inf where the prior is within its share, inf without budget.
    """
    allowed = np.asarray(budget, dtype=np.float64) * np.asarray(share, dtype=np.float64)
    p = np.broadcast_to(np.asarray(prior, dtype=np.float64), np.broadcast_shapes(allowed.shape, np.shape(prior)))
    ratio = np.divide(allowed, p, out=np.full(p.shape, np.inf), where=p > 0.0)
    return upper_quantile(ratio)
