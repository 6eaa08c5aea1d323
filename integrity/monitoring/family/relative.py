"""RRAIM: a code position of an earlier epoch with a good level, carried on by time-differenced carriers.

The anchor moves to an epoch whose own code level is the lowest reached. In the position form the level is that of the
anchor, the quantile of the carriers' noise since then, and the largest step that a slip could hide from their test.
In the range form the codes of the anchor are carried on one by one, and the epoch is solved and bounded anew with those
that were held without a break.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit, solve_codes
from lanebound.integrity.monitoring.family.levels import LevelWork, noncentralities, normal_factor
from lanebound.integrity.monitoring.family.memory import Remembered
from lanebound.integrity.monitoring.family.rejection import global_threshold, local_tests
from lanebound.integrity.monitoring.family.separations import root_level

__all__ = ["relative_position", "relative_range"]

Bools = NDArray[np.bool_]


def _carrier_steps(work: LevelWork) -> tuple[CodeEpochs, CodeFit, Bools]:
    """Epochs of the changes of carriers with slips excluded, their solution, and where it may be used.  (E,)."""
    e, config = work.epochs, work.config
    if e.carrier_step_m is None or e.carrier_kept is None or e.carrier_sigma_m is None:
        raise InputError("carrier_step_m must be known for RRAIM, got None: the epochs must hold carriers")
    sigma = np.where(e.carrier_kept, e.carrier_sigma_m, 1.0)
    steps = local_tests(replace(e, y_m=e.carrier_step_m, sigma_m=sigma, used=e.carrier_kept), config)
    fit = solve_codes(steps)
    passed = fit.solved & (fit.df > 0) & (fit.wsse <= global_threshold(fit.df, config.false_alarm)) & ~e.starts()
    return steps, fit, passed


def relative_position(work: LevelWork) -> Remembered:
    """Position form: ``x_t = x_0 + sum of steps``, ``HPL = HPL_0 + K s_t + max slope sqrt(lambda)``."""
    _, fit, passed = _carrier_steps(work)
    own = root_level(work.epochs, work.fit, work.config, work.risks)
    tested = np.where(passed, fit.df, 0)
    least = np.where(tested[:, None] > 0, noncentralities(tested, work.config.false_alarm, work.risks), 0.0)
    hidden = np.where(passed, fit.slopes().max(-1), 0.0)[:, None] * np.sqrt(least)
    z, time = normal_factor(work.risks), work.epochs.time_s
    position, level = work.fit.x_m.copy(), own.copy()
    x, base, variance, slip, since = np.zeros(3), np.full(z.size, np.inf), 0.0, np.zeros(z.size), -np.inf
    for k in range(time.size):
        variance, x = variance + float(fit.major_m[k]) ** 2, x + fit.x_m[k]
        slip = np.maximum(slip, hidden[k])
        coasting = base + z * np.sqrt(variance) + slip
        ends = not passed[k] or time[k] - since > work.config.coast_s
        if ends or not np.isfinite(coasting).any() or (own[k] <= coasting).all():
            x, base, variance, slip, since = work.fit.x_m[k].copy(), own[k], 0.0, np.zeros(z.size), time[k]
        else:
            position[k], level[k] = x, coasting
    return Remembered(position, level, np.zeros(time.size, bool))


def relative_range(work: LevelWork) -> Remembered:
    """Range form: codes of the anchor plus changes of carriers, solved and bounded by separation at every epoch."""
    steps, _, passed = _carrier_steps(work)
    e, own = work.epochs, root_level(work.epochs, work.fit, work.config, work.risks)
    y, sigma, used = e.y_m.copy(), e.sigma_m.copy(), e.used.copy()
    middle = own.shape[1] // 2
    base, kept, carried = np.inf, np.zeros(e.y_m.shape[1], bool), np.zeros((2, e.y_m.shape[1]))
    x, since, anchored = np.zeros(3), -np.inf, np.zeros(e.count, bool)
    for k in range(e.count):
        kept = kept & steps.used[k]
        carried[0] += np.where(kept, steps.y_m[k], 0.0)
        carried[1] = np.hypot(carried[1], steps.sigma_m[k])
        ends = not passed[k] or e.time_s[k] - since > work.config.coast_s or kept.sum() < work.fit.used[k].sum() // 2
        if ends or own[k, middle] <= base:
            base, x, since, kept = float(own[k, middle]), work.fit.x_m[k], e.time_s[k], work.fit.used[k]
            carried = np.stack([e.y_m[k] + e.los_enu[k] @ x, e.sigma_m[k]])
        else:
            anchored[k] = True
            y[k], sigma[k], used[k] = carried[0] - e.los_enu[k] @ x, carried[1], kept
    moved = replace(e, y_m=np.where(used, y, 0.0), sigma_m=np.where(used, sigma, 1.0), used=used)
    again = solve_codes(moved)
    level = np.where(anchored[:, None], root_level(moved, again, work.config, work.risks), own)
    worse = (level > own)[:, middle]
    level[worse] = own[worse]
    position = np.where((anchored & ~worse)[:, None], again.x_m, work.fit.x_m)
    return Remembered(position, level, np.zeros(e.count, bool))
