"""Where plug-in modes, services and stages attach to an epoch, and how their stages are called.

A stage of this package is ``stage(first, last, epoch)``. A plug-in stage is ``stage(first, last, epoch, own)``,
compiled or plain Python, where ``own`` (:class:`~.records_kernel.Own`) holds its code and its own state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch, Own

__all__ = ["STATELESS", "OutsideStage", "Point", "SeparateStage", "Stage"]

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


@dataclass(frozen=True)
class OutsideStage(SeparateStage):
    """A stage of a plug-in mode or stage: its name, code of Mode or AlertReason, and the function.

    ``bounds`` marks a stage that runs after all protection levels and may raise them.
    """

    name: str
    code: int
    function: Stage
    bounds: bool = False

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Records]) -> None:
        """Run it, and refuse a change of protection levels that would be unsafe or lost.

        Raises
        ------
        InputError
            A protection level is lower than before, or NaN, or raised where levels are not final.
        """
        levels, fixed = epoch.levels[first:last], epoch.fixed_levels[first:last]
        before, fixed_before = levels.copy(), fixed.copy()
        self.function(first, last, epoch, Own(self.code, states[self.name]))
        self._refuse(~(levels >= before), before, levels, "change levels by raise_level")
        self._refuse(~(fixed >= fixed_before), fixed_before, fixed, "levels of the RTK position may only grow")
        if not self.bounds:
            self._refuse(levels != before, before, levels, "raise levels at Point.BOUNDED, when they are final")

    def _refuse(self, wrong: NDArray[np.bool_], before: Array, after: Array, remedy: str) -> None:
        """Raise InputError for the first wrong level (n, R, 2)."""
        if wrong.any():
            v, case, axis = np.argwhere(wrong)[0]
            raise InputError(
                f"a protection level after {self.name!r} must be that before, {before[v, case, axis]:.3f} m, or more "
                f"at Point.BOUNDED, got {after[v, case, axis]:.3f} m: {remedy}"
            )
