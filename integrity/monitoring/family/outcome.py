"""What a monitor of the family says about an epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.advice import Advice

__all__ = ["MonitorOutcome", "MonitorVerdicts"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


class MonitorOutcome(Advice):
    """Whether the position may be used; ``code`` is what arrays carry."""

    USABLE = 0, "position may be used within its level"
    EXCLUDED = 1, "codes were excluded; position may be used within its level"
    ALARM = 2, "fault detected and not excluded; do not use the position"
    NO_REDUNDANCY = 3, "too few codes to test; wait for more satellites"
    TOO_FEW = 4, "fewer codes than unknowns: wait for more satellites"
    SINGULAR = 5, "the geometry does not determine the position: wait until the satellites spread out"
    NOT_BEGUN = 6, "the method needs epochs before this one: wait"


@dataclass(frozen=True)
class MonitorVerdicts:
    """Verdicts on E epochs at R risks.

    Attributes
    ----------
    position_enu_m : (E, 3) position; 0 where there is none.
    hpl_m : (E, R) horizontal level, inf where none.
    vpl_m : (E, R) vertical level, inf where the kind has none.
    outcome : (E,) codes of MonitorOutcome.
    excluded : (E, m) bool, codes, or carriers, that a test or a robust weight left out.
    used : (E, m) bool, codes, or carriers, of the position; neither excluded nor left out by a map or by their odds.
    false_alarm : (E,) probability of a false alarm at this epoch by the test that was made, 0 without a test.
    """

    position_enu_m: Array
    hpl_m: Array
    vpl_m: Array
    outcome: Ints
    excluded: Bools
    used: Bools
    false_alarm: Array

    @property
    def usable(self) -> Bools:
        """Where the position may be used.  (E,)."""
        return np.asarray(self.outcome <= MonitorOutcome.EXCLUDED.code)

    @property
    def alarm(self) -> Bools:
        """Where a fault was detected and not excluded.  (E,)."""
        return np.asarray(self.outcome == MonitorOutcome.ALARM.code)
