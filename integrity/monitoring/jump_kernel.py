"""RTK against the position that was expected of it, and quarantine for who contradicts himself.

Each epoch the position first goes on from the last RTK fix by Doppler or odometer, with the protection level it would
have had without RTK. When both levels hold, the new RTK position lies within their sum of it, on either axis. A wrong
fix, wrong reference coordinates or a spoofer that moves all satellites together break this and nothing else: their
residuals are perfect. What creeps breaks no single epoch: beside the position runs a witness, who has not listened to
RTK for up to ten seconds (``rtk.witness_s``) and then begins anew where RTK is. Whoever contradicts him counts as one
who jumped when the witness began, and the position goes back to the witness's. What is done then:

1. The first contradiction refuses RTK and gives up the integers, so that a wrong fix heals by itself.
2. When integers resolved anew contradict as well, or are nearer to the first ones than to what was expected, one of the
   two histories is wrong and nobody can say which. RTK is not used until a quarantine is over: a long one where RTK
   jumped from one epoch to the next, a short one where it came back from an outage, for wheels, gyros and reflections
   fail more often than all signals do. Doppler, of the same signals, neither moves the position nor calibrates the
   heading meanwhile.
3. So it is where Doppler and odometer contradict each other while RTK goes on: one of them lies, and RTK may lie with
   Doppler.
4. In all of this the position goes on by what is left, under an alert, and the levels cover both histories: that of
   reckoning, which grows, and RTK's, the difference ``D`` away.
5. After the quarantine RTK is believed again, wherever it is: a spoofer who waits so long is not told from a repair.

What is there from the first fix on, moves Doppler along with it, or creeps no further within ten seconds than the
levels of RTK and of the witness are wide, is not seen.

``doubt`` (DOUBT_SIZE,): STAGE; LEFT_S of the quarantine [s]; D_E, D_N [m] RTK's position less the one reckoned.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = [
    "DOUBT_SIZE",
    "along_across",
    "bounded",
    "contradicts",
    "in_doubt",
    "judge_jump",
    "pass_time",
    "suspects_signals",
    "widen",
]

Array = NDArray[np.float64]

STAGE, LEFT_S, D_E, D_N = range(4)
DOUBT_SIZE = 4
# stages: no doubt; contradicted once while RTK lasted, or as it came back; in quarantine; after it
TRUSTED, JUMPED, RETURNED, WAITING, PARDONED = range(5)
ACCEPTED, REFUSED, QUARANTINED = range(3)  # verdicts; REFUSED: the integers are to be given up


@jit
def along_across(east: float, north: float, sin_h: float, cos_h: float) -> tuple[float, float]:
    """Lengths along and across the track of a vector in E and N."""
    return abs(sin_h * east + cos_h * north), abs(cos_h * east - sin_h * north)


@jit
def contradicts(east: float, north: float, sin_h: float, cos_h: float, expected: Array, found: Array) -> bool:
    """Whether two positions (east, north) [m] apart cannot both be within their levels (2,) AT, CT [m]."""
    at, ct = along_across(east, north, sin_h, cos_h)
    return bool(at > expected[0] + found[0] or ct > expected[1] + found[1])


@jit
def bounded(level: Array) -> bool:
    """Whether there is a level on both axes, (2,)."""
    return bool(level[0] < np.inf and level[1] < np.inf)


@jit
def in_doubt(doubt: Array) -> bool:
    """Whether RTK has contradicted and has not been accepted since."""
    return bool(doubt[STAGE] != TRUSTED)


@jit
def suspects_signals(doubt: Array) -> bool:
    """Whether Doppler is not to be used either."""
    return bool(doubt[STAGE] == WAITING or doubt[STAGE] == JUMPED)


@jit
def pass_time(dt: float, doubt: Array) -> None:
    """An epoch of ``dt`` [s] begins; a quarantine that is over ends in pardon."""
    if doubt[STAGE] == WAITING:
        doubt[LEFT_S] -= dt
        if not doubt[LEFT_S] > 0.5 * dt:
            doubt[LEFT_S], doubt[STAGE] = 0.0, PARDONED


@jit
def judge_jump(
    east: float, north: float, sin_h: float, cos_h: float, expected: Array, found: Array, lasting: bool, conflict: bool,
    quarantine_s: tuple[float, float], doubt: Array,
) -> int:  # fmt: skip
    """Whether the RTK position is ACCEPTED, (east, north) [m] from where it was expected; keeps the doubt.

    Parameters
    ----------
    expected, found : (2,) levels AT, CT of either [m], infinite where there is none
    lasting : the epoch before had an RTK position as well
    conflict : Doppler and odometer contradict each other, and have for a while
    quarantine_s : after a jump, and after an outage
    """
    if doubt[STAGE] == WAITING:
        doubt[D_E], doubt[D_N] = east, north
        return QUARANTINED
    if doubt[STAGE] == PARDONED:
        doubt[:] = 0.0
        return ACCEPTED
    jumped = doubt[STAGE] == JUMPED
    together = conflict and (lasting or jumped)
    proven = bounded(expected) or not jumped  # a jump is not forgotten where nothing speaks for it
    if doubt[STAGE] != TRUSTED:  # nor where it has only been overtaken by levels that grow
        proven = proven and math.hypot(east, north) < math.hypot(east - doubt[D_E], north - doubt[D_N])
    if proven and not (together or contradicts(east, north, sin_h, cos_h, expected, found)):
        doubt[:] = 0.0
        return ACCEPTED
    doubt[D_E], doubt[D_N] = east, north
    if doubt[STAGE] == TRUSTED and not together:
        doubt[STAGE] = JUMPED if lasting else RETURNED
        return REFUSED
    doubt[LEFT_S] = quarantine_s[1] if doubt[STAGE] == RETURNED else quarantine_s[0]
    if doubt[LEFT_S] > 0.0:
        doubt[STAGE] = WAITING
        return QUARANTINED
    doubt[:] = 0.0
    return ACCEPTED


@jit
def widen(sin_h: float, cos_h: float, found: Array, doubt: Array, pl: Array) -> None:
    """Widen levels of reckoning pl (R, 2) in place so that RTK's history is covered too, of levels ``found`` (R, 2)."""
    at, ct = along_across(doubt[D_E], doubt[D_N], sin_h, cos_h)
    for r in range(pl.shape[0]):
        pl[r, 0] += at + found[r, 0]
        pl[r, 1] += ct + found[r, 1]
