"""A monitor of the family at work: weights, rejection, solution, test and level of many epochs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.monitoring.family.bank import BankMemory, extended
from lanebound.integrity.monitoring.family.composite import CompositeMemory, composite
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, LevelKind, TestKind
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit, solve_codes
from lanebound.integrity.monitoring.family.fixed import fixed_carriers
from lanebound.integrity.monitoring.family.levels import LEVELS, LevelWork, fixed_level_false_alarm
from lanebound.integrity.monitoring.family.memory import KalmanMemory, Memory, Remembered, isotropic_kalman
from lanebound.integrity.monitoring.family.odds import trusted_codes
from lanebound.integrity.monitoring.family.outcome import MonitorOutcome, MonitorVerdicts
from lanebound.integrity.monitoring.family.rejection import REJECTIONS, ROBUST, global_threshold, local_threshold
from lanebound.integrity.monitoring.family.relative import relative_position, relative_range
from lanebound.integrity.monitoring.family.separations import advanced_levels
from lanebound.integrity.monitoring.family.vertical import vertical_level
from lanebound.integrity.monitoring.family.weighting import weighted_codes
from lanebound.integrity.positioning.least_squares import Solvability

__all__ = ["BY_ALL_RISKS", "GOES_ON", "MEMORY", "new_memory", "watch"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MEMORY: dict[LevelKind, Callable[[LevelWork], Remembered]] = {
    LevelKind.ISOTROPIC_KALMAN: isotropic_kalman,
    LevelKind.COMPOSITE: composite,
    LevelKind.RELATIVE_POSITION: relative_position,
    LevelKind.RELATIVE_RANGE: relative_range,
    LevelKind.EXTENDED: extended,
    LevelKind.FIXED_CARRIERS: fixed_carriers,
}
# have a position where the codes of an epoch have no solution
COASTS = set(MEMORY) - {LevelKind.COMPOSITE}
GOES_ON: dict[LevelKind, type[Memory]] = {
    LevelKind.ISOTROPIC_KALMAN: KalmanMemory,
    LevelKind.COMPOSITE: CompositeMemory,
    LevelKind.EXTENDED: BankMemory,
}
"""Levels whose memory can be kept from call to call."""
BY_ALL_RISKS = {LevelKind.SEPARATION_ODDS, LevelKind.ROAD}
"""Levels whose codes or alarm follow from all risks asked for; :func:`watch` tells more."""
AT_ONCE = 4096  # epochs of a snapshot monitor that are solved together; keeps arrays in the cache


def new_memory(config: FamilyMonitorConfig, batch: int, columns: int, risks: int) -> Memory | None:
    """Memories of vehicles with ``columns`` satellites that have just been switched on; None for a snapshot monitor."""
    kind = GOES_ON.get(config.level)
    return None if kind is None else kind.new(batch, columns, risks)


def watch(
    epochs: CodeEpochs, config: FamilyMonitorConfig, risks: ArrayLike = 1e-3, memory: Memory | None = None
) -> MonitorVerdicts:
    """Verdicts of a monitor on epochs at one or more risks.

    Each level depends on its own risk only. There are two exceptions: the codes that odds leave out, and the position
    without them, are those of the smallest risk; ``road`` raises its alarm only where no risk has a level.

    Parameters
    ----------
    memory : with it each epoch is the next one of another vehicle, row by row, and the memory goes on (it is changed);
        without it epochs follow each other, and methods with memory begin anew with each drive.

    Raises
    ------
    InputError
        The record is malformed, lacks what the kind needs, or a risk is outside (0, 1).
    """
    wanted = require_in_range(
        "risks", np.atleast_1d(np.asarray(risks, dtype=np.float64)), 0.0, 1.0, low_open=True, high_open=True
    )
    epochs.checked()
    if config.level in MEMORY or epochs.count <= AT_ONCE:
        return _watch(epochs, config, wanted, memory)
    parts = [
        _watch(epochs.take(slice(first, first + AT_ONCE)), config, wanted) for first in range(0, epochs.count, AT_ONCE)
    ]
    return MonitorVerdicts(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in MonitorVerdicts.__dataclass_fields__)
    )


def _watch(
    epochs: CodeEpochs, config: FamilyMonitorConfig, risks: Array, memory: Memory | None = None
) -> MonitorVerdicts:
    weighted = weighted_codes(epochs, config)
    trusted = trusted_codes(weighted, config, risks)
    left = REJECTIONS[config.rejection](trusted, config)
    fit = solve_codes(left)
    alarm, false_alarm = _test(left, fit, config, risks, trusted)
    work = LevelWork(left, fit, config, risks, alarm, memory)
    position, solved, used, excluded = fit.x_m, fit.solved, left.used, trusted.used & ~left.used
    begun = np.ones(fit.df.size, bool)
    if config.level is LevelKind.ARAIM:  # one search for levels and tests
        level, vpl, failed = advanced_levels(work.epochs, fit, config, risks)
        alarm = failed if config.test is TestKind.SEPARATION else alarm
    elif config.level in MEMORY:
        found, vpl = MEMORY[config.level](work), vertical_level(work)
        position, level, alarm, begun = found.position_enu_m, found.hpl_m, found.alarm, found.begun
        used = used if found.used is None else found.used
        excluded = excluded if found.excluded is None else found.excluded
    else:
        level, vpl = LEVELS[config.level](work), vertical_level(work)
    if config.level in COASTS:
        solved = np.asarray(solved | np.isfinite(level).any(-1))
    outcome = _outcome(fit, solved, np.asarray(excluded.any(-1)), alarm, level)
    waits = ~begun & np.isinf(level).all(-1) & (outcome != MonitorOutcome.ALARM.code)
    outcome = np.where(waits, MonitorOutcome.NOT_BEGUN.code, outcome)
    none = (outcome > MonitorOutcome.EXCLUDED.code)[:, None]
    return MonitorVerdicts(
        np.where(solved[:, None], position, 0.0), np.where(none, np.inf, level), np.where(none, np.inf, vpl), outcome,
        excluded, used, false_alarm,
    )  # fmt: skip


def _test(
    left: CodeEpochs, fit: CodeFit, config: FamilyMonitorConfig, risks: Array, declared: CodeEpochs
) -> tuple[Bools, Array]:
    """Alarms (E,), and the probability of a false one (E,) at each epoch.

    Robust weights raise deviations where residuals are large. Separations are tested with the raised deviations, which
    the level adds, and with the ``declared`` ones, for which ``false_alarm`` holds.
    """
    if config.level is LevelKind.ROAD:
        limit, chance = fixed_level_false_alarm(fit, config.hal_m, risks)
        return np.asarray((fit.df > 0) & (fit.wsse >= limit.max(-1))), chance[:, int(limit.max(0).argmax())]
    tested = fit.solved & (fit.df > 0)
    chance = np.where(tested, config.false_alarm, 0.0)
    if config.test is TestKind.GLOBAL:
        return np.asarray(tested & (fit.wsse > global_threshold(fit.df, config.false_alarm))), chance
    if config.test is TestKind.SEPARATION:  # |d_i,q| / sigma_di,q is the same on both axes: |w_i|
        limit = local_threshold(fit.used.sum(-1), config.false_alarm)
        worst = np.abs(fit.normalised).max(-1)
        if config.rejection in ROBUST:
            own = solve_codes(declared.with_codes(used=left.used))
            worst = np.maximum(worst, np.abs(own.normalised).max(-1))
        return np.asarray(tested & (worst > limit)), chance
    return np.zeros(fit.df.size, bool), np.zeros(fit.df.size)


def _outcome(fit: CodeFit, solved: Bools, excluded: Bools, alarm: Bools, level: Array) -> NDArray[np.int64]:
    code = np.where(excluded, MonitorOutcome.EXCLUDED.code, MonitorOutcome.USABLE.code)
    code = np.where(np.isinf(level).all(-1), MonitorOutcome.NO_REDUNDANCY.code, code)
    code = np.where(alarm, MonitorOutcome.ALARM.code, code)
    few = fit.status == Solvability.TOO_FEW.code
    code = np.where(~solved, np.where(few, MonitorOutcome.TOO_FEW.code, MonitorOutcome.SINGULAR.code), code)
    return np.asarray(code, dtype=np.int64)
