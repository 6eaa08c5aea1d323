"""Levels by solution separation: closed form, published form, root, and ARAIM with constellations, for code epochs.

The kernels and forms are those of the vehicle (:mod:`lanebound.integrity.monitoring.protection`): along-track stands
for East, cross-track for North, and ``HPL = hypot(PL_E, PL_N)`` with half of the risk each.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.monitoring.araim import EAST_RAD, AraimConfig, SortedModes, checked_levels
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import MOST_SYSTEMS, CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit
from lanebound.integrity.monitoring.fault_modes import enumerate_faults
from lanebound.integrity.monitoring.protection import closed_form_published, protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, false_alarm_factor
from lanebound.integrity.monitoring.separation import Separation
from lanebound.integrity.positioning.least_squares import Solvability

__all__ = ["advanced_levels", "closed_level", "published_level", "root_axes", "root_level", "separations"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

ROAD_RISK = 1e-5  # of which the risks of the road are multiples
EVERY_MODE = 1e-300  # no threshold ends the search of modes


def separations(fit: CodeFit) -> Separation:
    """Separations of every single code on East and North, from the fit of all (``d_i = S_i r_i / R_ii``).

    Columns are the fault-free solution and one mode for each code; a mode whose code none checks has no solution.
    """
    tested = fit.redundancy > 1e-9
    part = np.where(tested, fit.redundancy, 1.0)
    gain = fit.gain[..., :2]
    variance = np.where(fit.used, 1.0 / np.where(fit.used, fit.weight, 1.0), 0.0)
    moved = np.square(gain) * (variance / part)[..., None]  # sigma_d^2
    base = np.diagonal(fit.cofactor, axis1=1, axis2=2)[:, :2]
    lost = fit.used & ~tested & (np.abs(gain).max(-1) > 1e-9)
    sigma = np.where(lost[..., None], np.inf, np.sqrt(base[:, None, :] + moved))
    whole = np.where(fit.solved[:, None], np.sqrt(base), np.inf)
    sigma = np.concatenate([whole[:, None], np.where(fit.solved[:, None, None], sigma, np.inf)], 1)
    delta = np.where(tested[..., None], np.sqrt(moved), 0.0)
    shift = gain * (fit.residual_m / part)[..., None] * tested[..., None]
    first = np.zeros((gain.shape[0], 1, 2))
    solved, singular = Solvability.SOLVED.code, Solvability.SINGULAR.code
    status = np.concatenate([fit.status[:, None], np.where(lost, singular, fit.status[:, None])], 1)
    return Separation(
        sigma_m=sigma,
        delta_m=np.concatenate([first, delta], 1),
        bias_m=np.zeros_like(sigma),
        separation_m=np.concatenate([first, shift], 1),
        status=np.where(status == solved, solved, status),
        gain_track=np.zeros((*sigma.shape, gain.shape[1])),
    )


def _rules(config: FamilyMonitorConfig, spend: bool = False) -> RiskConfig:
    return RiskConfig(
        false_alarm=config.false_alarm, satellite_prior=(config.satellite_prior,) * MOST_SYSTEMS,
        constellation_prior=(0.0,) * MOST_SYSTEMS, subtract_multiple=False, spend_unsolvable=spend,
    )  # fmt: skip


def root_axes(
    epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array, closed: bool, spent: ArrayLike = 0.0
) -> Array:
    """Levels of the first two columns of the directions with half of the risk each.  (E, R, 2)."""
    los = np.where(fit.used[..., None], epochs.los_enu, np.array([0.0, 0.0, 1.0]))
    variance = np.where(fit.used, np.square(np.where(fit.used, epochs.sigma_m, 1.0)), 1.0)
    found = protection_levels_batch(
        los, fit.used, epochs.system, variance, EAST_RAD, _rules(config), risks, closed=closed, spent=spent
    )  # fmt: skip
    return found.closed_m if closed else found.root_m


def _exact(
    epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array, closed: bool, spent: ArrayLike = 0.0
) -> Array:
    levels = root_axes(epochs, fit, config, risks, closed, spent)
    return np.hypot(levels[..., 0], levels[..., 1])


def closed_level(epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array) -> Array:
    """S1 eq 17 with exact factors.  (E, R)."""
    return _exact(epochs, fit, config, risks, True)


def root_level(
    epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array, spent: Array | None = None
) -> Array:
    """S2 eq 10-11, the root of the sum over hypotheses, less a risk (E,) that is already spent.  (E, R)."""
    return _exact(epochs, fit, config, risks, False, 0.0 if spent is None else spent)


def published_level(epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array) -> Array:
    """S1 eq 17 with the printed factors ``K_fa = Qinv(a/(2 n))`` and ``K_md = Qinv(risk)``.  (E, R)."""
    parts = separations(fit)
    k_fa = false_alarm_factor(config.false_alarm, fit.used.sum(-1), Variant.PUBLISHED)
    levels = [closed_form_published(parts, k_fa, float(risk)) for risk in risks]
    return np.stack([np.hypot(level[:, 0], level[:, 1]) for level in levels], -1)


def advanced_levels(
    epochs: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array
) -> tuple[Array, Array, Bools]:
    """HPL and VPL of ARAIM with faults of satellites and of constellations, (E, R) each, and where a test of a
    separation of any mode fails (E,).

    With ``config.araim`` the budgets of aviation hold whatever the risks; else each risk is that of the plane and of
    the vertical alike, with the false alarms and priors of the monitor. The modes of a sky are the same at all risks,
    so that a level depends on no other risk that is asked for. What cannot be monitored is spent (ADD v3.1): with one
    system that is its own fault, so that there is no level at risks below ``constellation_prior``.
    """
    budget = config.araim or _road_budget(config)
    times, whole = (np.ones(risks.size), None) if config.araim else (risks / ROAD_RISK, risks)
    columns = epochs.y_m.shape[1]
    hpl, vpl = np.full((2, fit.df.size, risks.size), np.inf)
    alarm = np.zeros(fit.df.size, bool)
    patterns, which = np.unique(fit.used, axis=0, return_inverse=True)
    for k, seen in enumerate(patterns):
        own = np.flatnonzero((which.ravel() == k) & fit.solved & (fit.df > 0))
        if not own.size or not columns:
            continue
        los, variance = epochs.los_enu[own][:, seen], np.square(epochs.sigma_m[own][:, seen])
        modes, y = _modes(epochs.system[seen].tobytes(), budget), epochs.y_m[own][:, seen]
        up, plane, alarm[own] = checked_levels(los, epochs.system[seen], variance, y, budget, modes, times, whole)
        hpl[own], vpl[own] = np.hypot(plane[..., 0], plane[..., 1]), up
    return hpl, vpl, alarm


@lru_cache(maxsize=1024)
def _modes(system: bytes, budget: AraimConfig) -> SortedModes:
    """The fault modes of satellites of these systems; epochs under one sky share them."""
    group = np.frombuffer(system, np.int64)
    found = enumerate_faults(
        group, budget.satellite_prior, budget.constellation_prior, unmonitored_below=budget.unmonitored_below,
        at_once=budget.at_once,
    )  # fmt: skip
    return SortedModes.of(found, group)


def _road_budget(config: FamilyMonitorConfig) -> AraimConfig:
    """A risk of the monitor for the plane and for the vertical, and half of its false alarms each; all faults of up to
    two events are modes."""
    half = 0.5 * config.false_alarm
    return AraimConfig(
        vertical_risk=ROAD_RISK, horizontal_risk=ROAD_RISK, vertical_false_alarm=half, horizontal_false_alarm=half,
        unmonitored_below=EVERY_MODE, satellite_prior=config.satellite_prior,
        constellation_prior=config.constellation_prior, at_once=2,
    )  # fmt: skip
