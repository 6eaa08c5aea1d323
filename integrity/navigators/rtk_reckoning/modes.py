"""Table of the positioning modes that bridge the time since an RTK position.

A configuration names the modes to use in their order of preference, ``modes: [doppler, imu_odometer]``. The stage of
a mode moves the vehicles that it is usable for and that no mode before it has moved, and adds to the growth of their
errors, from which their protection levels follow. :func:`register_mode` adds a plug-in mode.
"""

from __future__ import annotations

from dataclasses import dataclass

from lanebound.integrity.core.plugins import find
from lanebound.integrity.core.presets import require_new, require_registered
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.rtk_reckoning.modes_kernel import advance_doppler, advance_imu_odometer
from lanebound.integrity.navigators.rtk_reckoning.stages import STATELESS, ModeStage, OutsideStage, Stage, require_stage
from lanebound.integrity.positioning.modes import Mode

__all__ = ["MODES", "PositioningMode", "mode_named", "register_mode", "withdraw_mode"]


@dataclass(frozen=True)
class PositioningMode:
    """A positioning mode: its code with name and label, its stage, and its own state at the start, if it has one."""

    mode: Mode
    stage: Stage | OutsideStage
    initial: Records | None = None


MODES = {
    Mode.DOPPLER.key: PositioningMode(Mode.DOPPLER, advance_doppler),
    Mode.IMU_ODOMETER.key: PositioningMode(Mode.IMU_ODOMETER, advance_imu_odometer),
}


def mode_named(name: str) -> PositioningMode:
    """A mode of the table, or ConfigError. ``package.module:name`` imports the module first."""
    return find(name, MODES, "modes")


def register_mode(name: str, label: str, stage: Stage, initial: Records | None = None) -> Mode:
    """Add a positioning mode, which configurations may then name.

    Parameters
    ----------
    name : in configurations and in observation entries, for instance ``inertial``
    label : in tables and figures
    stage : ``stage(first, last, epoch, own)``; for each vehicle that it is usable for and whose ``w.mode`` is UNDECIDED
        it moves position and growth and sets ``w.mode = own.code``
    initial : (1,) record of its own state for a vehicle that begins

    Raises
    ------
    InputError
        The name is taken or no identifier, or stage or state have another form.
    """
    require_new("a mode", name, MODES)
    require_stage(f"mode {name!r}", stage, initial)
    mode = Mode.register(name, label)
    state = STATELESS if initial is None else initial
    MODES[name] = PositioningMode(mode, ModeStage(f"mode {name}", int(mode), stage), state)
    return mode


def withdraw_mode(name: str) -> None:
    """Remove the mode that was registered last.

    Raises
    ------
    InputError
        There is none of this name, it is a mode of the package, or another mode was registered after it.
    """
    require_registered("mode", name, MODES)
    Mode.withdraw(MODES[name].mode)
    del MODES[name]
