"""Carrier smoothing of codes by the recursion of Hatch (1982), one satellite at a time.

With ``d = code - phase`` the smoothed code is ``phase + mean(d)``, where the mean runs over the epochs since the
carrier was locked and fades with the time constant of the filter::

    n = min(n + 1, N),   m += (d - m) / n,   smoothed = phase + m.

The shares that the mean leaves of the variance of a code follow the same recursion exactly: of white noise
``W = (1 - g)^2 W + g^2`` with ``g = 1/n``, and of a Gauss-Markov error of correlation r over the epoch, with the
covariance A of mean and error::

    V = (1 - g)^2 V + 2 g (1 - g) r A + g^2,   A = (1 - g) r A + g.

V grows with r, so that the longest correlation time bounds all shorter ones. At rest nothing but the satellites moves,
r is close to 1 and a mean of multipath gains next to nothing, whatever its length.

A slip that the receiver does not notice moves d; one that exceeds ``gate`` restarts the mean. On one frequency the
ionosphere moves code and phase apart: the mean lags by twice its rate times the mean age ``T = (1 - g) (T + dt)`` of
the differences, which is counted in epochs (``age``).
"""

from __future__ import annotations

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["HATCH", "slips", "smooth", "weaken"]

HATCH = record(
    count="epochs in the mean, 0: none",
    mean="of code less phase [m]",
    white="share of the variance of white noise that the mean leaves [-]",
    lasting="share of the variance of a Gauss-Markov error that it leaves [-]",
    cross="covariance of the mean and the present error, over the variance [-]",
    age="mean age of the differences in the mean [epochs]",
    free="phase of the first band less that of the second in the last epoch, 0: none [m]",
)
"""Carrier smoothing of one satellite's code."""


@jit(borrows=True)
def smooth(code: float, phase: float, locked: bool, most: float, gate: float, decay: float, hatch: Any) -> float:
    """The smoothed code [m]; ``hatch`` advances. Without a carrier the code itself, and the mean begins anew.

    most : N, epochs in a time constant; gate : largest change of the difference [m]; decay : r, correlation of
    multipath over the epoch [-]
    """
    if not locked:
        hatch.count, hatch.white, hatch.lasting, hatch.cross, hatch.age = 0.0, 1.0, 1.0, 1.0, 0.0
        return code
    difference = code - phase
    if hatch.count > 0.0 and abs(difference - hatch.mean) > gate:
        hatch.count = 0.0
    if hatch.count == 0.0:
        hatch.mean = difference
    hatch.count = min(hatch.count + 1.0, most)
    hatch.mean += (difference - hatch.mean) / hatch.count
    weaken(1.0 / hatch.count, decay, hatch)
    return float(phase + hatch.mean)


@jit(borrows=True)
def weaken(gain: float, decay: float, hatch: Any) -> None:
    """Advance the shares of the variance that the mean leaves."""
    left = 1.0 - gain
    hatch.white = left * left * hatch.white + gain * gain
    hatch.lasting = left * left * hatch.lasting + 2.0 * gain * left * decay * hatch.cross + gain * gain
    hatch.cross = left * decay * hatch.cross + gain
    hatch.age = left * (hatch.age + 1.0)


@jit(borrows=True)
def slips(free: float, gate: float, hatch: Any) -> bool:
    """Whether the difference of both carriers, which knows no motion, jumps by more than ``gate`` [m] in an epoch.

    free : 0 without both carriers; ``hatch.free`` becomes that of this epoch
    """
    jumped = bool(free != 0.0 and hatch.free != 0.0 and abs(free - hatch.free) > gate)
    hatch.free = free
    return jumped
