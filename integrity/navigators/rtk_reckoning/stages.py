"""The stages of an epoch as one callable: compiled chains, and between them stages of modes and monitors from outside.

A stage of this package is ``stage(first, last, epoch)``. A stage from outside is ``stage(first, last, epoch, own)``,
compiled or plain Python, where ``own`` (:class:`~.records_kernel.Own`) holds its code and its own state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.bundle_kernel import Bundle
from lanebound.integrity.core.chain_kernel import Chain
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.navigators.rtk_reckoning.records_kernel import Epoch, EpochInputs, Own

__all__ = ["STATELESS", "OutsideStage", "SeparateStage", "Stage", "StageList"]

Array = NDArray[np.float64]
Stage = Callable[..., None]
STATELESS = np.zeros(1, record(nothing="not used"))
"""State of a mode or monitor that has none."""


class SeparateStage:
    """A stage that is called from Python, by itself: ``stage(first, last, epoch, states)``."""

    def __call__(self, first: int, last: int, epoch: Epoch, states: Mapping[str, Any]) -> None:
        """Run it for the vehicles ``first`` to ``last - 1``; states (B,) by name."""
        raise NotImplementedError


@dataclass(frozen=True)
class OutsideStage(SeparateStage):
    """A stage of a mode or monitor from outside: its name, code of Mode or AlertReason, and the function.

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
        levels, fixed = epoch.out.levels[first:last], epoch.work.fixed_levels[first:last]
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


class StageList:
    """Stages called in their order: ``stages(first, last, lasting, inputs, states)``.

    ``lasting`` is the bundle of the fields of an Epoch that last, ``inputs`` holds the others; states (B,) of records
    by name.
    """

    def __init__(self, stages: Sequence[Stage | SeparateStage]) -> None:
        self._stages = tuple(stages)
        self._parts: list[Any] = []
        for outside, group in groupby(stages, key=lambda stage: isinstance(stage, SeparateStage)):
            members = list(group)
            self._parts += members if outside else [Chain(Epoch, *members)]

    def __call__(self, first: int, last: int, lasting: Bundle, inputs: EpochInputs, states: Mapping[str, Any]) -> None:
        for part in self._parts:
            if isinstance(part, SeparateStage):
                part(first, last, Epoch._make((*lasting.values, *inputs)), states)
            else:
                part(first, last, lasting, inputs)

    def compile_ahead(self, make: Callable[[], Epoch]) -> None:
        """Begin to compile in a second process if nothing is cached; ``make`` returns data of the expected types."""
        for part in self._parts:
            if isinstance(part, Chain):
                part.compile_ahead(make)

    def __reduce__(self) -> tuple[Any, ...]:
        return StageList, (self._stages,)
