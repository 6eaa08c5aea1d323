"""Vertical levels of snapshot monitors: the forms of the horizontal ones with Up in the place of the plane.

A separation gives the risk to one axis: the columns are named (U, E, N), and twice the risk is halved between the first
two. The level of isotropic errors of the plane bounds one axis as well, because one axis has less of the error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from lanebound.integrity.monitoring.araim import UP_FIRST
from lanebound.integrity.monitoring.family.config import LevelKind
from lanebound.integrity.monitoring.family.levels import (
    LevelWork,
    isotropic_factor,
    noncentralities,
    normal_factor,
    times,
)
from lanebound.integrity.monitoring.family.odds import odds_axes
from lanebound.integrity.monitoring.family.separations import root_axes
from lanebound.integrity.monitoring.sbas import Operation
from lanebound.integrity.monitoring.significance import two_sided_factor

__all__ = ["vertical_level"]

Array = NDArray[np.float64]

UP = slice(2, 3)
LARGEST_RISK = 1.0 - 1e-9


def vertical_level(work: LevelWork) -> Array:
    """Vertical levels (E, R), inf where the kind states none; ARAIM has its own."""
    form = STATED.get(work.config.level) or (ASKED.get(work.config.level) if work.config.vertical else None)
    if form is None:
        return np.full((work.fit.df.size, work.risks.size), np.inf)
    return np.where(work.fit.solved[:, None], form(work), np.inf)


def _deviation(work: LevelWork) -> Array:
    """Standard deviation of the height.  (E, 1)."""
    return np.asarray(np.sqrt(work.fit.cofactor[:, 2, 2])[:, None])


def _sbas(work: LevelWork) -> Array:
    operation = Operation.EN_ROUTE if work.config.en_route else Operation.PRECISION_APPROACH
    return np.repeat(operation.value[1] * _deviation(work), work.risks.size, 1)


def _normal(work: LevelWork) -> Array:
    return np.asarray(normal_factor(work.risks) * _deviation(work))


def _slope(work: LevelWork) -> Array:
    """``VPL = Vslope_max sqrt(lambda_det)``."""
    fit, worst = work.fit, work.fit.slopes(UP).max(-1)[:, None]
    least = np.sqrt(noncentralities(fit.df, work.config.false_alarm, work.risks))
    return np.where((fit.df > 0)[:, None], times(least, worst), np.inf)


def _weighted(work: LevelWork) -> Array:
    """``VPL = max(Vslope) T + k sigma_V`` (Walter and Enge 1995)."""
    fit = work.fit
    limit = np.sqrt(np.where(fit.df > 0, chdtri(np.maximum(fit.df, 1), work.config.false_alarm), np.inf))
    return np.asarray(times(limit, fit.slopes(UP).max(-1))[:, None] + two_sided_factor(work.risks) * _deviation(work))


def _uncertainty(work: LevelWork) -> Array:
    fit = work.fit
    found = np.where(fit.df > 0, np.sqrt(fit.wsse), np.inf)
    return np.asarray(times(found, fit.slopes(UP).max(-1))[:, None] + two_sided_factor(work.risks) * _deviation(work))


def _isotropic(work: LevelWork) -> Array:
    fit = work.fit
    size = np.sqrt(fit.wsse)[:, None] * _deviation(work)
    return np.where((fit.df > 0)[:, None], times(isotropic_factor(fit.df, work.risks), size), np.inf)


def _of_axes(form: Callable[[LevelWork], Array]) -> Callable[[LevelWork], Array]:
    def level(work: LevelWork) -> Array:
        e, doubled = work.epochs, np.minimum(2.0 * work.risks, LARGEST_RISK)
        turned = replace(work, epochs=replace(e, los_enu=e.los_enu[..., UP_FIRST]), risks=doubled)
        return np.asarray(form(turned)[..., 0])

    return level


STATED: dict[LevelKind, Callable[[LevelWork], Array]] = {LevelKind.SBAS: _sbas, LevelKind.NORMAL: _normal}
"""Forms of kinds that always state a vertical level."""

ASKED: dict[LevelKind, Callable[[LevelWork], Array]] = {
    LevelKind.SLOPE: _slope,
    LevelKind.WEIGHTED: _weighted,
    LevelKind.UNCERTAINTY: _uncertainty,
    LevelKind.SEPARATION: _of_axes(lambda w: root_axes(w.epochs, w.fit, w.config, w.risks, closed=True)),
    LevelKind.SEPARATION_ROOT: _of_axes(lambda w: root_axes(w.epochs, w.fit, w.config, w.risks, closed=False)),
    LevelKind.SEPARATION_ODDS: _of_axes(lambda w: odds_axes(w.epochs, w.fit, w.config, w.risks)),
    LevelKind.ISOTROPIC: _isotropic,
    LevelKind.ISOTROPIC_PUBLISHED: _isotropic,
}
"""Forms of kinds that state one where the configuration asks for it."""
