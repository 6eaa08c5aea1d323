"""One epoch of the default navigator, from what is measured to the solution."""

from __future__ import annotations

from lanebound.integrity.core.accel import jit
from lanebound.integrity.navigators.rtk_reckoning.attitude_kernel import admit_doppler, find_attitude
from lanebound.integrity.navigators.rtk_reckoning.doubt_stage_kernel import follow_histories, judge_histories
from lanebound.integrity.navigators.rtk_reckoning.extension_kernel import begin
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import find_fixed_position
from lanebound.integrity.navigators.rtk_reckoning.levels_kernel import find_reckoned_levels
from lanebound.integrity.navigators.rtk_reckoning.lock_kernel import follow_carriers
from lanebound.integrity.navigators.rtk_reckoning.modes_kernel import (
    advance_doppler,
    advance_imu_odometer,
    advance_nothing,
)
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import (
    judge_fix,
    separate_doppler,
    watch_speeds,
    widen_levels,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch
from lanebound.integrity.navigators.rtk_reckoning.report_kernel import report, take_fix
from lanebound.integrity.navigators.rtk_reckoning.resolve_stage_kernel import resolve_integers
from lanebound.integrity.navigators.rtk_reckoning.velocity_kernel import find_velocity

__all__ = [
    "admit_doppler",
    "advance_doppler",
    "advance_imu_odometer",
    "advance_nothing",
    "begin",
    "find_attitude",
    "find_fixed_position",
    "find_reckoned_levels",
    "find_velocity",
    "follow_carriers",
    "follow_histories",
    "judge_fix",
    "judge_histories",
    "locate",
    "report",
    "resolve_integers",
    "separate_doppler",
    "take_fix",
    "watch_speeds",
    "widen_levels",
]


@jit
def locate(first: int, last: int, epoch: Epoch) -> None:
    """Locate the vehicles ``first`` to ``last - 1``.

    The stages of the table in :mod:`.epoch`, for configurations to which nothing is added.
    """
    begin(first, last, epoch)
    find_velocity(first, last, epoch)
    find_attitude(first, last, epoch)
    admit_doppler(first, last, epoch)
    follow_carriers(first, last, epoch)
    resolve_integers(first, last, epoch)
    find_fixed_position(first, last, epoch)
    advance_doppler(first, last, epoch)
    advance_imu_odometer(first, last, epoch)
    advance_nothing(first, last, epoch)
    separate_doppler(first, last, epoch)
    watch_speeds(first, last, epoch)
    follow_histories(first, last, epoch)
    find_reckoned_levels(first, last, epoch)
    judge_fix(first, last, epoch)
    judge_histories(first, last, epoch)
    take_fix(first, last, epoch)
    widen_levels(first, last, epoch)
    report(first, last, epoch)
