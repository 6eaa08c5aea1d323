"""Carrier smoothing of codes by the recursion of Hatch (1982), one satellite at a time.

With ``d = code - phase`` the smoothed code is ``phase + mean(d)``, where the mean runs over the epochs since the
carrier was locked and fades with the time constant of the filter::

    n = min(n + 1, N),   m += (d - m) / n,   smoothed = phase + m.

A slip that the receiver does not notice moves d; one that exceeds ``gate`` restarts the mean. On one frequency the
ionosphere moves code and phase apart, so that the mean lags by twice its change in a time constant.
"""

from __future__ import annotations

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["HATCH", "slips", "smooth"]

HATCH = record(
    count="epochs in the mean, 0: none",
    mean="of code less phase [m]",
    free="phase of the first band less that of the second in the last epoch, 0: none [m]",
)
"""Carrier smoothing of one satellite's code."""


@jit(borrows=True)
def smooth(code: float, phase: float, locked: bool, most: float, gate: float, hatch: Any) -> float:
    """The smoothed code [m]; ``hatch`` advances. Without a carrier the code itself, and the mean begins anew.

    most : N, epochs in a time constant; gate : largest change of the difference [m]
    """
    if not locked:
        hatch.count = 0.0
        return code
    difference = code - phase
    if hatch.count > 0.0 and abs(difference - hatch.mean) > gate:
        hatch.count = 0.0
    if hatch.count == 0.0:
        hatch.mean = difference
    hatch.count = min(hatch.count + 1.0, most)
    hatch.mean += (difference - hatch.mean) / hatch.count
    return float(phase + hatch.mean)


@jit(borrows=True)
def slips(free: float, gate: float, hatch: Any) -> bool:
    """Whether the difference of both carriers, which knows no motion, jumps by more than ``gate`` [m] in an epoch.

    free : 0 without both carriers; ``hatch.free`` becomes that of this epoch
    """
    jumped = bool(free != 0.0 and hatch.free != 0.0 and abs(free - hatch.free) > gate)
    hatch.free = free
    return jumped
