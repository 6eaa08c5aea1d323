"""RRAIM: a code position of an earlier epoch with a good level, carried on by time-differenced carriers.

The anchor is an epoch whose codes pass their test. What carriers have changed by since then is added up satellite by
satellite, as long as its carrier is held, and it is the sum that is solved and tested at every epoch: a small error of
each step adds up to one that is seen (GEAS). In the position form the level is that of the anchor, the quantile of the
carriers' noise, and the largest change that a faulty carrier could hide from the test of the sum. In the range form the
codes of the anchor are carried on one by one, and the epoch is solved, tested and bounded anew by separation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.fit import CodeFit, solve_codes
from lanebound.integrity.monitoring.family.levels import LevelWork, noncentralities, normal_factor
from lanebound.integrity.monitoring.family.memory import Remembered
from lanebound.integrity.monitoring.family.rejection import (
    global_threshold,
    local_tests,
    local_threshold,
)
from lanebound.integrity.monitoring.family.separations import root_level
from lanebound.integrity.positioning.code_solution import solve_ranges

__all__ = ["relative_position", "relative_range"]


Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

ANCHOR_RISK = 1e-5  # at which levels are compared, whatever risks are asked for
LEAST_SHARE = 0.5  # of the codes of an epoch whose carriers are held since the anchor


class _Changes:
    """Changes of carriers from epoch to epoch, and their sums since an anchor."""

    def __init__(self, work: LevelWork) -> None:
        e, config = work.epochs, work.config
        if e.carrier_step_m is None or e.carrier_kept is None or e.carrier_sigma_m is None:
            raise InputError("carrier_step_m must be known for RRAIM, got None: the epochs must hold carriers")
        sigma = np.where(e.carrier_kept, e.carrier_sigma_m, 1.0)
        change = np.where(e.carrier_kept, e.carrier_step_m, 0.0)
        self.steps = local_tests(replace(e, y_m=change, sigma_m=sigma, used=e.carrier_kept), config)
        fit = solve_codes(self.steps)
        passed = fit.solved & (fit.df > 0) & (fit.wsse <= global_threshold(fit.df, config.false_alarm))
        self.passed = passed & ~e.starts()
        self.config, self.move_m, self.time_s = config, fit.x_m, e.time_s
        self.anchor(0, np.zeros(e.y_m.shape[1], bool))
        self.since_s = -np.inf

    def anchor(self, k: int, held: Bools) -> None:
        """Begin anew at epoch k with the carriers ``held``."""
        self.since_s, self.held = self.time_s[k], held.copy()
        self.moved_m, self.sum_m, self.variance_m2 = np.zeros(3), np.zeros(held.size), np.zeros(held.size)

    def add(self, k: int) -> bool:
        """Add epoch k; whether the anchor may still be carried on.

        Sums are those of what remains beside the displacement found, so that lines of sight may turn.
        """
        e = self.steps
        self.held &= e.used[k] & self.passed[k]
        self.moved_m = self.moved_m + self.move_m[k]
        self.sum_m = self.sum_m + np.where(self.held, e.y_m[k] + e.los_enu[k] @ self.move_m[k], 0.0)
        self.variance_m2 = self.variance_m2 + np.where(self.held, np.square(e.sigma_m[k]), 0.0)
        return bool(self.held.any()) and self.time_s[k] - self.since_s <= self.config.coast_s

    def solve(self, k: int) -> CodeFit:
        """The sums of epoch k, with their one displacement beside the one found step by step."""
        variance = np.where(self.held, self.variance_m2, 1.0)
        return solve_ranges(self.steps.los_enu[k : k + 1], self.sum_m[None], variance[None], self.held[None],
                            self.steps.system)  # fmt: skip


def _own_levels(work: LevelWork, share: float) -> tuple[Array, Array]:
    """Levels of the codes of each epoch at a share of the risks (E, R), and at that of the comparison (E,); inf where
    the codes have failed their test or none is made."""
    bad = work.alarm | ~work.fit.solved | (work.fit.df <= 0)
    own = root_level(work.epochs, work.fit, work.config, share * np.append(work.risks, ANCHOR_RISK))
    own = np.where(bad[:, None], np.inf, own)
    return own[:, :-1], own[:, -1]


def relative_position(work: LevelWork) -> Remembered:
    """Position form: ``HPL = HPL_0 + K s_t + max slope sqrt(lambda)``.

    Half of the risk is that of the anchor, a quarter the noise of carriers, a quarter P_MD of a faulty carrier.
    """
    changes, config = _Changes(work), work.config
    (own, least), (base, base_least) = _own_levels(work, 1.0), _own_levels(work, 0.5)
    quarter = 0.25 * np.append(work.risks, ANCHOR_RISK)
    z, position, level = normal_factor(quarter), work.fit.x_m.copy(), own.copy()
    anchor, coasts, begun = -1, np.zeros(least.size, bool), np.zeros(least.size, bool)
    for k in range(least.size):
        coasting, sums = np.full(z.size, np.inf), None
        if changes.add(k) and anchor >= 0:
            sums = changes.solve(k)
            if sums.df[0] > 0 and sums.wsse[0] <= global_threshold(sums.df, config.false_alarm)[0]:
                hidden = sums.slopes().max() * np.sqrt(noncentralities(sums.df, config.false_alarm, quarter)[0])
                coasting = np.append(base[anchor], base_least[anchor]) + z * sums.major_m[0] + hidden
        coasts[k] = sums is not None and coasting[-1] < least[k]
        if coasts[k] and sums is not None:
            position[k], level[k] = work.fit.x_m[anchor] + changes.moved_m + sums.x_m[0], coasting[:-1]
        elif np.isfinite(least[k]):
            anchor = k
            changes.anchor(k, np.ones(work.fit.used.shape[1], bool))
        begun[k] = anchor >= 0 and work.epochs.drive[anchor] == work.epochs.drive[k]
    return Remembered(position, level, work.alarm & ~coasts, begun)


def relative_range(work: LevelWork) -> Remembered:
    """Range form: codes of the anchor plus changes of carriers, solved, tested and bounded by separation at each
    epoch."""
    changes, e, config = _Changes(work), work.epochs, work.config
    own, least = _own_levels(work, 1.0)
    y, sigma, used = e.y_m.copy(), e.sigma_m.copy(), e.used.copy()
    anchor, carried, begun = -1, np.zeros(e.count, bool), np.zeros(e.count, bool)
    for k in range(e.count):
        held = changes.add(k) and changes.held.sum() >= LEAST_SHARE * work.fit.used[k].sum()
        if anchor >= 0 and held and not least[k] <= least[anchor]:
            carried[k] = True
            at = work.fit.x_m[anchor]
            first = e.y_m[anchor] + e.los_enu[anchor] @ at
            y[k] = first + changes.sum_m - e.los_enu[k] @ (at + changes.moved_m)
            sigma[k], used[k] = np.sqrt(np.square(e.sigma_m[anchor]) + changes.variance_m2), changes.held
        elif np.isfinite(least[k]):
            anchor = k
            changes.anchor(k, work.fit.used[k])
        begun[k] = anchor >= 0 and e.drive[anchor] == e.drive[k]
    moved = replace(e, y_m=np.where(used, y, 0.0), sigma_m=np.where(used, sigma, 1.0), used=used)
    again = solve_codes(moved)
    limit = local_threshold(again.used.sum(-1), config.false_alarm)
    good = carried & again.solved & (again.df > 0) & (np.abs(again.normalised).max(-1) <= limit)
    found = root_level(moved, again, config, np.append(work.risks, ANCHOR_RISK))
    coasts = good & (found[:, -1] < least)
    level = np.where(coasts[:, None], found[:, :-1], own)
    return Remembered(np.where(coasts[:, None], again.x_m, work.fit.x_m), level, work.alarm & ~coasts, begun)
