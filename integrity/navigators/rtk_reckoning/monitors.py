"""Integrity monitors from outside: what each reads, and its stages in an epoch.

The monitors of this package are always on and stand in the table of :mod:`.epoch`. ``monitors: [name]`` in a
configuration adds others, which :func:`register_monitor` registers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import find
from lanebound.integrity.core.presets import require_registered
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.rtk_reckoning.stages import STATELESS, OutsideStage, Point, Stage
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL, OBSERVED_VEHICLE

__all__ = ["MONITORS", "Monitor", "Point", "monitor_named", "register_monitor", "withdraw_monitor"]


@dataclass(frozen=True)
class Monitor:
    """An integrity monitor.

    Attributes
    ----------
    name, about : in configurations; what it finds
    needs : measurements that it reads, fields of OBSERVED_SIGNAL or OBSERVED_VEHICLE
        (:mod:`lanebound.integrity.sensors.observed_kernel`)
    stages : its verdict, exclusion and levels, by the point of the epoch where each runs
    initial : (1,) record of its own state for a vehicle that begins
    """

    name: str
    about: str
    needs: tuple[str, ...]
    stages: Mapping[Point, OutsideStage]
    initial: Records


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
    if name in MONITORS:
        raise InputError(f"name of a monitor must not be taken, got {name!r}: choose another")
    measured = (*OBSERVED_SIGNAL.fields, *OBSERVED_VEHICLE.fields)  # type: ignore[misc]
    unknown = [need for need in needs if need not in measured]
    if unknown:
        raise InputError(f"needs must be among {', '.join(measured)}, got {unknown[0]!r}: correct it")
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
