"""Plug-in stages: tests, exclusions, levels and alerts that a configuration adds to the epoch.

The stages of this package are always on and stand in the table of :mod:`.epoch`. ``stages: [name]`` in a configuration
adds others, which :func:`register_stages` registers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.plugins import find
from lanebound.integrity.core.presets import require_new, require_registered
from lanebound.integrity.core.records import Records
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.rtk_reckoning.stages import STATELESS, OutsideStage, Point, Stage, require_stage
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL, OBSERVED_VEHICLE

__all__ = ["EXTRA_STAGES", "ExtraStages", "Point", "register_stages", "stages_named", "withdraw_stages"]


@dataclass(frozen=True)
class ExtraStages:
    """Plug-in stages of one name.

    Attributes
    ----------
    name, about : in configurations; what they find
    needs : measurements that they read, fields of OBSERVED_SIGNAL or OBSERVED_VEHICLE
        (:mod:`lanebound.integrity.sensors.observed_kernel`)
    stages : by the point of the epoch where each runs
    initial : (1,) record of their own state for a vehicle that begins
    """

    name: str
    about: str
    needs: tuple[str, ...]
    stages: Mapping[Point, OutsideStage]
    initial: Records


EXTRA_STAGES: dict[str, ExtraStages] = {}


def stages_named(name: str) -> ExtraStages:
    """Registered stages, or ConfigError. ``package.module:name`` imports the module first."""
    return find(name, EXTRA_STAGES, "stages")


def register_stages(
    name: str,
    about: str,
    needs: tuple[str, ...],
    stages: Mapping[Point, Stage],
    initial: Records | None = None,
    reason: AlertReason = AlertReason.INTEGRITY_TEST_FAILED,
) -> ExtraStages:
    """Add stages, which configurations may then name.

    Parameters
    ----------
    name, about, needs : as of :class:`ExtraStages`
    stages : functions ``stage(first, last, epoch, own)``; ``own.code`` is the code of ``reason``
    initial : (1,) record of their own state for a vehicle that begins
    reason : of the alerts that they raise; ``AlertReason.register`` makes one of its own

    Raises
    ------
    InputError
        The name is taken or no identifier, there is no such measurement, there is no stage, or points, stages, state
        or reason have another form.
    """
    require_new("stages", name, EXTRA_STAGES)
    measured = (*OBSERVED_SIGNAL.fields, *OBSERVED_VEHICLE.fields)  # type: ignore[misc]
    unknown = [need for need in needs if need not in measured]
    if unknown:
        raise InputError(f"needs must be among {', '.join(measured)}, got {unknown[0]!r}: correct it")
    if not stages:
        raise InputError(f"stages of {name!r} must hold one at least, got none: give a function for a Point")
    for point, stage in stages.items():
        if not isinstance(point, Point):
            raise InputError(f"points of stages {name!r} must be members of Point, got {point!r}: write Point.BOUNDED")
        require_stage(f"stages {name!r}", stage, initial)
    if not isinstance(reason, AlertReason):
        raise InputError(f"reason of {name!r} must be an AlertReason, got {reason!r}: use AlertReason.register")
    if reason.code == AlertReason.NONE.code:
        raise InputError(f"reason of {name!r} must not be NONE: an alert of that code would be none, register one")
    own = {point: OutsideStage(f"stage {name}", reason.code, stage, point) for point, stage in stages.items()}
    EXTRA_STAGES[name] = ExtraStages(name, about, needs, own, STATELESS if initial is None else initial)
    return EXTRA_STAGES[name]


def withdraw_stages(name: str) -> None:
    """Remove registered stages.

    Raises
    ------
    InputError
        There are none of this name.
    """
    require_registered("stages", name, EXTRA_STAGES)
    del EXTRA_STAGES[name]
