"""Horizontal levels of snapshot monitors: residual RAIM, uncertainty, reliability, SBAS, isotropic, position laws.

Each function takes a :class:`LevelWork` and returns (E, R) [m]; inf where the method gives none. Letters: ``T^2`` the
threshold of ``r'W r``, ``lambda`` the non-centrality at which a bias is missed with P_MD. Methods that state a missed
detection take the risk for P_MD; those that state a risk take it as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, chndtrix

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, LevelKind
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit
from lanebound.integrity.monitoring.family.odds import odds_level
from lanebound.integrity.monitoring.family.separations import (
    closed_level,
    published_level,
    root_level,
)
from lanebound.integrity.monitoring.sbas import Operation
from lanebound.integrity.monitoring.significance import noncentrality, two_sided_factor

__all__ = [
    "LEVELS", "OWN_LEVELS", "Level", "LevelWork", "fixed_level_false_alarm", "isotropic_factor", "noncentralities",
    "normal_factor", "predicted_level", "times",
]  # fmt: skip

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class LevelWork:
    """What a level is computed from: the solution of the codes that are left, the risks (R,), where the test of the
    codes has failed (E,), and the memory of a method for each epoch, each one of another vehicle; None: epochs come one
    after another."""

    epochs: CodeEpochs
    fit: CodeFit
    config: FamilyMonitorConfig
    risks: Array
    alarm: NDArray[np.bool_]
    memory: Any = None


@lru_cache(maxsize=4096)
def _noncentrality(false_alarm: float, risk: float, df: int) -> float:
    return noncentrality(false_alarm, max(1.0 - risk, false_alarm * (1.0 + 1e-9)), df)


def noncentralities(df: Ints, false_alarm: float, risks: Array) -> Array:
    """``lambda_det`` of a global test (S3 eq 9 and 12), inf without redundancy.  (E,), (R,) -> (E, R)."""
    largest = int(df.max(initial=0))
    table = np.full((largest + 1, risks.size), np.inf)
    for d in np.unique(df[df > 0]):
        table[d] = [_noncentrality(false_alarm, float(risk), int(d)) for risk in risks]
    return np.asarray(table[np.maximum(df, 0)])


def normal_factor(risk: Array) -> Array:
    """``sqrt(-2 ln risk)``: a plane error of N(0, C) exceeds it times the largest deviation with at most ``risk``."""
    return np.asarray(np.sqrt(-2.0 * np.log(risk)))


def isotropic_factor(df: Ints, risks: Array) -> Array:
    """``k = sqrt(risk^(-2 / (N - n)) - 1)``, inf without redundancy (house equations 7).  (E,), (R,) -> (E, R)."""
    power = np.where(df > 0, -2.0 / np.maximum(df, 1), -np.inf)
    with np.errstate(over="ignore"):
        return np.where((df > 0)[:, None], np.sqrt(risks[None, :] ** power[:, None] - 1.0), np.inf)


def times(factor: Array, length: Array) -> Array:
    """Product with 0 for no influence, even of an infinite factor."""
    with np.errstate(invalid="ignore"):
        return np.where(length == 0.0, 0.0, factor * length)


def predicted_level(fit: CodeFit, false_alarm: float, risks: Array) -> Array:
    """``HPL = slope_max sqrt(lambda_det)`` (S3 eq 14): no measurement enters, so that it can be predicted.  (E, R)."""
    worst = fit.slopes().max(-1)[:, None]
    return np.where((fit.df > 0)[:, None], times(np.sqrt(noncentralities(fit.df, false_alarm, risks)), worst), np.inf)


def slope(work: LevelWork) -> Array:
    """Classic HPL: the worst single bias that the global test misses with P_MD = risk."""
    return predicted_level(work.fit, work.config.false_alarm, work.risks)


def weighted(work: LevelWork) -> Array:
    """``HPL = max(Hslope) T + k(P_MD) HDOP`` (Walter and Enge 1995, S5 eq 1-4)."""
    fit = work.fit
    worst = fit.slopes().max(-1)
    limit = np.sqrt(np.where(fit.df > 0, chdtri(np.maximum(fit.df, 1), work.config.false_alarm), np.inf))
    return np.asarray(times(limit, worst)[:, None] + two_sided_factor(work.risks) * fit.hdop_m[:, None])


def uncertainty(work: LevelWork) -> Array:
    """HUL: as :func:`weighted` with the residuals found in place of their threshold (S3 III-A)."""
    fit = work.fit
    found = np.where(fit.df > 0, np.sqrt(fit.wsse), np.inf)
    return np.asarray(times(found, fit.slopes().max(-1))[:, None] + two_sided_factor(work.risks) * fit.hdop_m[:, None])


def reliability(work: LevelWork) -> Array:
    """Baarda's external reliability: ``max_i |S_i| MDB_i``, ``MDB_i = sigma_i sqrt(lambda_0 / R_ii)``.

    ``lambda_0`` is that of a local test of size P_FA / m and power 1 - risk.
    """
    fit = work.fit
    number = fit.used.sum(-1)
    factor = np.full((number.max(initial=0) + 1, work.risks.size), np.inf)
    for m in np.unique(number[fit.df > 0]):
        alpha = work.config.false_alarm / int(m)
        factor[m] = [np.sqrt(_noncentrality(alpha, float(risk), 1)) for risk in work.risks]
    return np.where((fit.df > 0)[:, None], times(factor[number], fit.slopes().max(-1)[:, None]), np.inf)


def fixed_level_false_alarm(fit: CodeFit, level_m: float, risks: Array) -> tuple[Array, Array]:
    """Threshold ``T^2`` and P_FA for which the HPL is ``level_m``, P_MD the risk (S3 V-B1).  (E, R) each.

    ``lambda = (level / slope_max)^2``; ``T^2`` is its quantile of P_MD, P_FA what the fault-free law has beyond.
    """
    worst, df = fit.slopes().max(-1), np.maximum(fit.df, 1)
    tested = (fit.df > 0) & np.isfinite(worst)
    allowed = np.square(level_m / np.where(tested & (worst > 0.0), worst, np.inf))
    allowed = np.minimum(np.where(tested & (worst == 0.0), 1e4, allowed), 1e4)
    limit = chndtrix(np.broadcast_to(risks, (df.size, risks.size)), df[:, None], allowed[:, None])
    limit = np.asarray(np.where(tested[:, None] & np.isfinite(limit), limit, 0.0), dtype=np.float64)
    return np.asarray(limit), np.asarray(chdtrc(df[:, None], limit))


def road(work: LevelWork) -> Array:
    """Road RAIM: the level is the alert limit where the residuals pass the test that has this level, else none."""
    limit, _ = fixed_level_false_alarm(work.fit, work.config.hal_m, work.risks)
    return np.where(work.fit.wsse[:, None] < limit, work.config.hal_m, np.inf)


def sbas(work: LevelWork) -> Array:
    """``K_H d_major`` with the factor of the operation, whatever the risk (DO-229D J.1)."""
    operation = Operation.EN_ROUTE if work.config.en_route else Operation.PRECISION_APPROACH
    return np.repeat((operation.value[0] * work.fit.major_m)[:, None], work.risks.size, 1)


def normal(work: LevelWork) -> Array:
    """``K d_major`` with the factor of a normal error at the risk."""
    return np.asarray(normal_factor(work.risks) * work.fit.major_m[:, None])


def isotropic(work: LevelWork) -> Array:
    """IBPL: ``k |r| d_major`` of whitened residuals; errors of any size that point in any direction alike.

    The chance of an error beyond it is the risk in a circular geometry, and below it in others.
    """
    return _isotropic(work, work.fit.major_m)


def isotropic_published(work: LevelWork) -> Array:
    """IBPL as printed: ``k |r| HDOP`` (S3 eq 15), HDOP of the deviations; up to root 2 above :func:`isotropic`."""
    return _isotropic(work, work.fit.hdop_m)


def _isotropic(work: LevelWork, spread_m: Array) -> Array:
    size = np.sqrt(work.fit.wsse) * spread_m
    return np.where((work.fit.df > 0)[:, None], times(isotropic_factor(work.fit.df, work.risks), size[:, None]), np.inf)


def rayleigh(work: LevelWork) -> Array:
    """Quantile of a Rayleigh law of the horizontal error, its scale fitted in units of ``d_major`` (S3 V-A)."""
    return np.asarray(work.config.rayleigh_factor * normal_factor(work.risks) * work.fit.major_m[:, None])


def pareto(work: LevelWork) -> Array:
    """Quantile of a generalised Pareto tail of the horizontal error, in units of ``d_major`` (S3 V-A).

    ``q = u + s/xi ((risk / share)^-xi - 1)`` beyond the threshold u; risks above the share have u.
    """
    c = work.config
    ratio = np.minimum(work.risks / c.pareto_share, 1.0)
    grown = -np.log(ratio) if abs(c.pareto_shape) < 1e-9 else (ratio**-c.pareto_shape - 1.0) / c.pareto_shape
    return np.asarray((c.pareto_threshold + c.pareto_scale * grown) * work.fit.major_m[:, None])


def _separated(form: Callable[..., Array]) -> Callable[[LevelWork], Array]:
    def level(work: LevelWork) -> Array:
        return form(work.epochs, work.fit, work.config, work.risks)

    return level


Level = Callable[[LevelWork], Array]
OWN_LEVELS: dict[str, Level] = {}
"""Levels of registered monitors, by the name of the monitor."""


def own(work: LevelWork) -> Array:
    """The level of a registered monitor, which ``register_monitor`` put into ``OWN_LEVELS`` under its name."""
    name, shape = work.config.own_level, (work.fit.df.size, work.risks.size)
    level = np.asarray(OWN_LEVELS[name](work), dtype=np.float64)
    if level.shape != shape:
        raise InputError(
            f"level of monitor {name!r} must have shape (epochs, risks) = {shape}, got {level.shape}: return one for "
            "each epoch and risk"
        )
    if not (level >= 0.0).all():
        raise InputError(f"level of monitor {name!r} must be >= 0, got {level.min():g}: inf stands for no level")
    return level


LEVELS: dict[LevelKind, Level] = {
    LevelKind.SLOPE: slope,
    LevelKind.UNCERTAINTY: uncertainty,
    LevelKind.WEIGHTED: weighted,
    LevelKind.RELIABILITY: reliability,
    LevelKind.ROAD: road,
    LevelKind.SEPARATION: _separated(closed_level),
    LevelKind.SEPARATION_PUBLISHED: _separated(published_level),
    LevelKind.SEPARATION_ROOT: _separated(root_level),
    LevelKind.SEPARATION_ODDS: _separated(odds_level),
    LevelKind.SBAS: sbas,
    LevelKind.NORMAL: normal,
    LevelKind.ISOTROPIC: isotropic,
    LevelKind.ISOTROPIC_PUBLISHED: isotropic_published,
    LevelKind.RAYLEIGH: rayleigh,
    LevelKind.PARETO: pareto,
    LevelKind.OWN: own,
}
"""Levels that follow from an epoch alone; ARAIM is in :mod:`.separations`, those with memory in :mod:`.monitor`."""
