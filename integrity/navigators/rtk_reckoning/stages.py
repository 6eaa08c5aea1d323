"""Where plug-in modes, services and stages attach to an epoch, and how their stages are called.

A stage of this package is ``stage(first, last, epoch)``. A plug-in stage is ``stage(first, last, epoch, own)``,
compiled or plain Python, where ``own`` (:class:`~.records_kernel.Own`) holds its code and its own state.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch, Own
from lanebound.integrity.positioning.codes_kernel import UNDECIDED

__all__ = ["HEEDED", "STATELESS", "ModeStage", "OutsideStage", "Point", "SeparateStage", "Stage", "require_stage"]

Array = NDArray[np.float64]
Stage = Callable[..., None]
STATELESS = np.zeros(1, record(nothing="not used"))
"""State of a mode or monitor that has none."""


class Point(Enum):
    """Where in an epoch plug-in stages run, in this order."""

    MEASURED = "before anything is estimated: satellites may be excluded"
    VELOCITY = "the Doppler velocity is found and tested"
    FIX = "the RTK position is found and tested"
    ESTIMATED = "before the position moves: Doppler velocity or RTK position may be refused"
    MOVED = "after a positioning mode has moved the position"
    OFFERED = "the levels of dead reckoning are known: another position may be offered in place of RTK's"
    JUDGED = "the position of RTK, or the one offered, is accepted or refused"
    TAKEN = "an accepted position has been taken"
    BOUNDED = "after all protection levels: they may be raised, and alerts too"
    REPORTED = "the solution is filled"


class SeparateStage:
    """A stage that is called from Python, by itself: ``stage(first, last, epoch, states)``."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        """Run it for the vehicles ``first`` to ``last - 1``; states (B,) by name."""
        raise NotImplementedError


HEEDED: Mapping[str, tuple[tuple[Point, ...], Callable[[Epoch], NDArray[Any]]]] = {
    "exclude_satellite": ((Point.MEASURED,), lambda epoch: epoch.signals["tracked"]),
    "refuse_doppler": ((Point.ESTIMATED,), lambda epoch: epoch.work["doppler_moves"]),
    "refuse_fix": ((Point.ESTIMATED,), lambda epoch: epoch.work["fixed"]["usable"]),
    "raise_alert": (tuple(Point)[:-1], lambda epoch: epoch.work["cause"]),
}
"""Of the functions of :mod:`.extension_kernel`: the points at which the epoch heeds them, and what they write."""


@dataclass(frozen=True)
class OutsideStage(SeparateStage):
    """A stage of a plug-in mode or stage: its name, code of Mode or AlertReason, and the function.

    ``point`` is where it runs; None for a mode.
    """

    name: str
    code: int
    function: Stage
    point: Point | None = None

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Records]) -> None:
        """Run it, and refuse a change that would be unsafe or lost.

        Raises
        ------
        InputError
            A protection level is lower than before, or NaN, or raised where levels are not final; or a satellite is
            excluded, a velocity or position refused, or an alert raised where nothing heeds it.
        """
        levels, fixed = epoch.levels[first:last], epoch.fixed_levels[first:last]
        before, fixed_before = levels.copy(), fixed.copy()
        lost = {name: field(epoch)[first:last] for name, (points, field) in HEEDED.items() if self.point not in points}
        kept = {name: values.copy() for name, values in lost.items()}
        self.function(first, last, epoch, Own(self.code, states[self.name]))
        self._refuse(~(levels >= before), before, levels, "change levels by raise_level")
        self._refuse(~(fixed >= fixed_before), fixed_before, fixed, "levels of the RTK position may only grow")
        if self.point is not Point.BOUNDED:
            self._refuse(levels != before, before, levels, "raise levels at Point.BOUNDED, when they are final")
        for name, values in lost.items():
            if not np.array_equal(values, kept[name]):
                raise InputError(
                    f"{name} must be called at Point.{HEEDED[name][0][-1].name}, got a call in {self.name!r} at "
                    f"{self.point}: it has no effect there"
                )

    def _refuse(self, wrong: NDArray[np.bool_], before: Array, after: Array, remedy: str) -> None:
        """Raise InputError for the first wrong level (n, R, 2)."""
        if wrong.any():
            v, case, axis = np.argwhere(wrong)[0]
            raise InputError(
                f"a protection level after {self.name!r} must be that before, {before[v, case, axis]:.3f} m, or more "
                f"at Point.BOUNDED, got {after[v, case, axis]:.3f} m: {remedy}"
            )


class ModeStage(OutsideStage):
    """The stage of a plug-in mode."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Records]) -> None:
        """Run it, and refuse what :class:`OutsideStage` refuses, and another code than its own.

        Raises
        ------
        InputError
            The stage takes a vehicle that an earlier mode has moved, or writes another code.
        """
        mode = epoch.work["mode"][first:last]
        before = mode.copy()
        super().__call__(first, last, epoch, states)
        wrong = (mode != before) & ((before != UNDECIDED) | (mode != self.code))
        if wrong.any():
            v = int(wrong.argmax())
            raise InputError(
                f"w.mode after {self.name!r} must be own.code = {self.code} where it was UNDECIDED, else as before, "
                f"got {mode[v]} in place of {before[v]}: correct the stage"
            )


def require_stage(what: str, stage: Any, initial: Any) -> None:
    """Refuse a plug-in stage, or the state of a vehicle that begins, of another form than the epoch calls.

    Raises
    ------
    InputError
        ``stage`` is no function of four arguments, or ``initial`` is no record (1,).
    """
    try:
        inspect.signature(getattr(stage, "py_func", stage)).bind(0, 0, None, None)
    except TypeError as wrong:
        raise InputError(
            f"stage of {what} must be a function stage(first, last, epoch, own), got {stage!r}: {wrong}"
        ) from wrong
    if initial is not None and (getattr(initial, "shape", None) != (1,) or initial.dtype.names is None):
        raise InputError(f"initial of {what} must be a record (1,), got {initial!r}: make it by one_record")
