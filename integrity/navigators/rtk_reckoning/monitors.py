"""Table of the integrity monitors: what each reads, and its stages in an epoch.

The monitors of this package are always on. ``monitors: [name]`` in a configuration adds others, which
:func:`register_monitor` registers from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import find
from lanebound.integrity.core.presets import require_registered
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.rtk_reckoning.doubt_stage_kernel import follow_histories, judge_histories
from lanebound.integrity.navigators.rtk_reckoning.drift_stage_kernel import watch_drift
from lanebound.integrity.navigators.rtk_reckoning.fixed_kernel import find_fixed_position
from lanebound.integrity.navigators.rtk_reckoning.monitors_kernel import (
    judge_fix,
    separate_doppler,
    watch_speeds,
    widen_levels,
)
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Measured
from lanebound.integrity.navigators.rtk_reckoning.stages import STATELESS, OutsideStage, Stage
from lanebound.integrity.navigators.rtk_reckoning.velocity_kernel import find_velocity

__all__ = ["BUILT_IN", "MONITORS", "Monitor", "Point", "monitor_named", "register_monitor", "withdraw_monitor"]


class Point(Enum):
    """Where in an epoch a stage of a monitor runs, in this order."""

    MEASURED = "before anything is estimated: satellites may be excluded"
    VELOCITY = "the Doppler velocity is found and tested"
    FIX = "the RTK position is found and tested"
    ESTIMATED = "before the position moves: Doppler velocity or RTK position may be refused"
    MOVED = "after a positioning mode has moved the position"
    JUDGED = "after the levels of dead reckoning: the RTK position is accepted or refused"
    BOUNDED = "after all protection levels: they may be raised, and alerts too"


@dataclass(frozen=True)
class Monitor:
    """An integrity monitor.

    Attributes
    ----------
    name, about : in configurations; what it finds
    needs : measurements that it reads, fields of :class:`~.records_kernel.Measured`
    stages : its verdict, exclusion and levels, by the point of the epoch where each runs
    initial : (1,) record of its own state for a vehicle that begins; None: it has none, or a part of State
    """

    name: str
    about: str
    needs: tuple[str, ...]
    stages: Mapping[Point, Stage | OutsideStage]
    initial: Records | None = None


BUILT_IN = {
    monitor.name: monitor
    for monitor in (
        Monitor(
            "doppler_fde",
            "faults of range rates, by solution separation; excludes the satellite",
            ("range_rate", "cn0", "tracked"),
            {Point.VELOCITY: find_velocity},
        ),
        Monitor(
            "phase_separation",
            "faults of carrier phases, by solution separation; excludes the satellite, bounds the RTK position",
            ("phase", "cn0", "tracked"),
            {Point.FIX: find_fixed_position},
        ),
        Monitor(
            "doppler_separation",
            "what a fault of one satellite can have done to the position since the last RTK position",
            ("range_rate",),
            {Point.MOVED: separate_doppler},
        ),
        Monitor(
            "odometer_watch",
            "slip, jumps and frozen values of the odometer, by the inertial sensors and Doppler",
            ("speed", "delta_v", "turn"),
            {Point.MOVED: watch_speeds},
        ),
        Monitor(
            "drift",
            "RTK positions that drift away from the path by gyro and odometer, over windows of seconds",
            ("phase", "speed", "turn"),
            {Point.JUDGED: watch_drift},
        ),
        Monitor(
            "jump",
            "RTK positions that contradict dead reckoning, the backup solution or the drift watch",
            ("phase",),
            {Point.JUDGED: judge_fix, Point.BOUNDED: widen_levels},
        ),
        Monitor(
            "heading",
            "Doppler courses and a gyro that contradict each other; bounds the paths by either",
            ("range_rate", "turn", "speed"),
            {Point.MOVED: follow_histories, Point.JUDGED: judge_histories},
        ),
    )
}
MONITORS: dict[str, Monitor] = {}


def monitor_named(name: str) -> Monitor:
    """A registered monitor, or ConfigError. ``package.module:name`` imports the module first."""
    return find(name, MONITORS, "monitors")


def register_monitor(
    name: str,
    about: str,
    needs: tuple[str, ...],
    stages: Mapping[Point, Stage],
    initial: Records | None = None,
    reason: AlertReason = AlertReason.INTEGRITY_TEST_FAILED,
) -> Monitor:
    """Add a monitor, which configurations may then name.

    Parameters
    ----------
    name, about, needs : as of :class:`Monitor`
    stages : functions ``stage(first, last, epoch, own)``; ``own.code`` is the code of ``reason``
    initial : (1,) record of its own state for a vehicle that begins
    reason : of the alerts that it raises; ``AlertReason.register`` makes one of its own

    Raises
    ------
    InputError
        The name is taken, there is no such measurement, or it has no stage.
    """
    if name in BUILT_IN or name in MONITORS:
        raise InputError(f"name of a monitor must not be taken, got {name!r}: choose another")
    unknown = [need for need in needs if need not in Measured._fields]
    if unknown:
        raise InputError(f"needs must be among {', '.join(Measured._fields)}, got {unknown[0]!r}: correct it")
    if not stages:
        raise InputError(f"stages of monitor {name!r} must hold one at least, got none: give a function for a Point")
    if reason.code == AlertReason.NONE.code:
        raise InputError(
            f"reason of monitor {name!r} must not be NONE: an alert of that code would be none, register one"
        )
    own = {
        point: OutsideStage(f"monitor {name}", reason.code, stage, point is Point.BOUNDED)
        for point, stage in stages.items()
    }
    MONITORS[name] = Monitor(name, about, needs, own, STATELESS if initial is None else initial)
    return MONITORS[name]


def withdraw_monitor(name: str) -> None:
    """Remove a registered monitor.

    Raises
    ------
    InputError
        There is none of this name.
    """
    require_registered("monitor", name, MONITORS)
    del MONITORS[name]
